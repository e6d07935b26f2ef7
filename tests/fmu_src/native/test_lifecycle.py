"""What the shell keeps, forgets and refuses, on a component that has two of everything: the second is told from the first."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import fmi2CallbackFunctions, fmi2LastSuccessfulTime, fmi2Terminated

from components import COMPONENTS
from fmu_src import export
from observers.instance import Instance
from once import once
from slave import Slave
from toys import double_toy

Make = Callable[..., Slave]


def derivative(fmu: Slave, name: str, value: float) -> None:
    fmu.fmu.setRealInputDerivatives([fmu.variables[name].valueReference], [1], [value])


def disturbed(fmu: Slave) -> None:
    """Everything that an instance holds is another than after fmi2Instantiate."""
    fmu.set("a", 101.0)
    fmu.set("flag", 0)
    fmu.set("b", 0.3)
    fmu.set("early_kick", 40.0)
    fmu.set("late_kick", 50.0)
    fmu.initialize({"gain": -1.0, "weight": 5, "enabled": 0, "sample_time": 0.05}, t0=3.0, stop=9.0)
    derivative(fmu, "a", -2000.0)
    fmu.step(3.0, 0.05)
    fmu.set("a", -40.0)
    fmu.step(3.05, 0.05)
    derivative(fmu, "a", 7.0)


def drive(fmu: Slave) -> list[dict[str, float]]:
    """Rows of all outputs over ten steps, counters among them, from wherever the instance is."""
    rows = [fmu.outputs()]
    for k in range(10):
        fmu.set("a", 102.0 if k == 0 else -20.0 if k == 1 else 0.1 * k)
        fmu.set("flag", k % 3 == 0)
        fmu.step(0.05 * k, 0.05)
        rows.append(fmu.outputs())
    return rows


def test_the_python_face_and_the_fmu_are_the_same_with_two_of_everything(slave: Make) -> None:
    fmu, face = slave("double_toy").initialize(t0=1.0), Instance(COMPONENTS["double_toy"](), t0=1.0)
    rows = [(0.1 * k + 0.3, k % 2, 0.05 * k - 0.21) for k in range(20)]
    for k, (a, flag, b) in enumerate(rows):
        for name, value in (("a", a), ("flag", flag), ("b", b), ("weight", k % 4)):
            fmu.set(name, value)
            face.set(name, value)
        derivative(fmu, "b", 0.5)
        assert fmu.outputs() == {p.name: v for p, v in zip(face.component.outputs, face.outputs(), strict=True)}
        if k % 5 == 4:
            continue
        t = face.time
        fmu.step(t, 0.05)
        face.step(t, 0.05, np.array([0.0, 0.0, 0.5]))


@pytest.mark.parametrize("left", ["instantiated", "in initialization mode", "stepped", "terminated"])
def test_after_a_reset_nothing_of_before_acts(slave: Make, left: str) -> None:
    fmu, fresh = slave("double_toy"), slave("double_toy")
    if left == "instantiated":
        fmu.set("a", 3.0)
        fmu.set("weight", 7)
        derivative(fmu, "b", 5.0)
        fmu.fmu.setupExperiment(startTime=2.0, stopTime=2.5)
    elif left == "in initialization mode":
        fmu.fmu.setupExperiment(startTime=2.0, stopTime=2.5)
        fmu.fmu.enterInitializationMode()
        fmu.set("late_kick", 2.1)
        assert fmu.get("s") == 0.25
        derivative(fmu, "b", 5.0)
    else:
        disturbed(fmu)
        if left == "terminated":
            fmu.fmu.terminate()
    fmu.fmu.reset()
    assert fmu.state() == fresh.state()
    assert "fmi2SetupExperiment must be called before" in fmu.refuses(fmu.fmu.enterInitializationMode)
    fmu.messages.clear()
    fresh.messages.clear()
    fmu.initialize(), fresh.initialize()
    assert drive(fmu) == drive(fresh)
    assert fmu.messages == fresh.messages
    assert [text for _, category, text in fmu.messages if category == "logStatusWarning"] == [
        "double_toy: high_a rose to 1 at t = 0.05."
    ]


def test_counters_warn_with_their_name_value_and_time(slave: Make) -> None:
    fmu = slave("double_toy").initialize({"sample_time": 0.02})
    fmu.messages.clear()
    told = []
    for k, (a, b) in enumerate([(0.1, 101.0), (101.0, -101.0), (-101.0, 101.0), (102.0, 102.0), (0.1, 0.1)]):
        fmu.set("a", a)
        fmu.set("b", b)
        fmu.step(0.02 * k, 0.02)
        told.append([text for _, _, text in fmu.messages])
        assert all(message[:2] == (1, "logStatusWarning") for message in fmu.messages)
        fmu.messages.clear()
    assert told == [
        ["double_toy: high_b rose to 1 at t = 0.02."],
        ["double_toy: high_a rose to 1 at t = 0.04."],
        ["double_toy: high_b rose to 2 at t = 0.06."],
        ["double_toy: high_a rose to 2 at t = 0.08.", "double_toy: high_b rose to 3 at t = 0.08."],
        [],
    ]


def test_a_count_that_an_earlier_state_takes_back_warns_when_it_rises_again(slave: Make) -> None:
    fmu = slave("double_toy").initialize({"sample_time": 0.02})
    early = fmu.fmu.getFMUState()
    fmu.set("b", 101.0)
    fmu.step(0.0, 0.02)
    late = fmu.fmu.getFMUState()
    fmu.messages.clear()
    fmu.fmu.setFMUState(early)
    fmu.set("b", 101.0)
    fmu.step(0.0, 0.02)
    assert [text for _, _, text in fmu.messages] == ["double_toy: high_b rose to 1 at t = 0.02."]
    fmu.messages.clear()
    fmu.fmu.setFMUState(late)
    fmu.set("b", 0.5)
    fmu.step(0.02, 0.02)
    assert fmu.messages == [] and fmu.get("high_b") == 1
    for handle in (early, late):
        fmu.fmu.freeFMUState(handle)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("a", 200.0, "double_toy: s ran away at t = 0.04, where s is 8.25."),
        ("b", 2000.0, "double_toy: w ran away at t = 0.1, where w is 10."),
    ],
)
def test_a_failure_is_named_with_its_time_and_measure(slave: Make, name: str, value: float, words: str) -> None:
    fmu = slave("double_toy").initialize()
    fmu.set(name, value)
    before = fmu.state()
    assert fmu.refuses(lambda: fmu.step(0.0, 0.1)) == words
    assert fmu.state() == before
    fmu.set(name, 0.1)
    fmu.step(0.0, 0.1)


def test_a_failure_of_the_start_values_is_named_and_they_can_be_mended(slave: Make) -> None:
    fmu = slave("double_toy")
    fmu.set("start.s", 9.5)
    fmu.fmu.setupExperiment(startTime=3.0)
    fmu.fmu.enterInitializationMode()
    words = "double_toy: s ran away at t = 3, where s is 9.5, for the start values."
    assert fmu.refuses(fmu.fmu.exitInitializationMode) == words
    assert fmu.refuses(lambda: fmu.get("s")) == words
    fmu.set("start.s", 1.0)
    fmu.fmu.exitInitializationMode()
    assert fmu.get("s") == 1.0


@pytest.mark.parametrize("name", ["a", "b"])
def test_the_input_that_is_not_finite_is_the_one_named(slave: Make, name: str) -> None:
    fmu = slave("double_toy").initialize()
    fmu.set(name, -math.inf if name == "b" else math.nan)
    value = "-inf" if name == "b" else "nan"
    message = fmu.refuses(lambda: fmu.step(0.0, 0.1))
    assert message.endswith(f"after the step from t = 0 to 0.1, where the input {name} is {value}.")


def test_the_output_that_is_not_finite_is_the_one_named(slave: Make) -> None:
    fmu = slave("double_toy").initialize(t0=1.0)
    fmu.set("b", 0.0)
    assert fmu.refuses(lambda: fmu.get("s")) == "double_toy: the output inverse is inf at t = 1."
    fmu.set("b", math.inf)
    fmu.set("a", math.inf)
    reference = [fmu.variables[name].valueReference for name in ("s", "force", "inverse")]
    fmu.messages.clear()
    assert fmu.fmu.getReal(reference) == [0.25, math.inf, 0.0]
    assert fmu.messages == [
        (1, "logStatusWarning", "double_toy: the output force is inf at t = 1, where the input a is inf.")
    ]
    fmu.messages.clear()
    assert fmu.get("s") == 0.25 and fmu.messages == []


# Values that are refused: (function, variables, values, message).
BAD_VALUES = {
    "second of two": ("setReal", ("a", "gain"), [1.0, 4.5], "fmi2SetReal: gain = 4.5 lies outside [-3, 4]."),
    "below": ("setReal", ("bias", "gain"), [0.5, -3.5], "fmi2SetReal: gain = -3.5 lies outside [-3, 4]."),
    "infinite": ("setReal", ("gain", "bias"), [1.0, -math.inf], "fmi2SetReal: bias = -inf must be finite."),
    "integer above": ("setInteger", ("weight",), [10], "fmi2SetInteger: weight = 10 lies outside [-2, 9]."),
    "integer below": ("setInteger", ("weight",), [-3], "fmi2SetInteger: weight = -3 lies outside [-2, 9]."),
    "output": ("setReal", ("a", "force"), [1.0, 2.0], "fmi2SetReal: force is an output, it cannot be set (to 2)."),
    "integer output": ("setInteger", ("total",), [3], "fmi2SetInteger: total is an output, it cannot be set (to 3)."),
    "constant": ("setReal", ("first",), [3.0], "fmi2SetReal: first is a constant, it cannot be set (to 3)."),
    "fixed": (
        "setReal",
        ("gain", "late_kick"),
        [1.0, 0.5],
        "fmi2SetReal: late_kick is a fixed parameter, 0.5 cannot be set after initialization.",
    ),
    "type": (
        "setReal",
        ("b", "enabled"),
        [1.0, 1.0],
        "fmi2SetReal: enabled (value reference 10) is not of type Real but Boolean.",
    ),
    "type of a Boolean": (
        "setBoolean",
        ("weight",),
        [1],
        "fmi2SetBoolean: weight (value reference 9) is not of type Boolean but Integer.",
    ),
    "type of an Integer": (
        "setInteger",
        ("flag",),
        [1],
        "fmi2SetInteger: flag (value reference 1) is not of type Integer but Boolean.",
    ),
}


@pytest.mark.parametrize("what", BAD_VALUES)
def test_a_value_that_is_refused_is_named_and_none_of_its_call_is_set(slave: Make, what: str) -> None:
    function, names, values, words = BAD_VALUES[what]
    fmu = slave("double_toy").initialize()
    before = fmu.state()
    references = [fmu.variables[name].valueReference for name in names]
    assert fmu.refuses(lambda: getattr(fmu.fmu, function)(references, values)) == words
    assert fmu.state() == before


def test_the_limits_themselves_are_legal(slave: Make) -> None:
    fmu = slave("double_toy").initialize()
    for name, low, high in (("gain", -3.0, 4.0), ("bias", -1.0, 1.0), ("weight", -2, 9), ("enabled", 0, 1)):
        for value in (low, high):
            fmu.set(name, value)
            assert fmu.get(name) == value


def test_values_of_every_type_are_read_as_they_were_set(slave: Make) -> None:
    fmu = slave("double_toy")
    fmu.fmu.setBoolean([fmu.variables["flag"].valueReference], [7])  # any number that is not 0
    assert fmu.get("flag") == 1 and fmu.get("second") == -3 and fmu.get("first") == 0.125
    fmu.initialize({"weight": -2, "flag": 0})
    assert fmu.get("sampled_flag") == 0 and fmu.get("weight") == -2
    fmu.set("flag", 1)
    fmu.step(0.0, 0.1)
    assert fmu.get("sampled_flag") == 1 and fmu.get("total") == -2
    assert fmu.fmu.getBoolean([fmu.variables[name].valueReference for name in ("enabled", "flag", "sampled_flag")]) == [
        1,
        1,
        1,
    ]
    fmu.set("enabled", 0)
    assert fmu.get("enabled") == 0


def test_derivatives_belong_to_the_inputs_they_were_set_for(slave: Make) -> None:
    fmu = slave("double_toy").initialize({"early_kick": 50.0, "late_kick": 50.0})
    fmu.set("a", 1.0)
    fmu.set("b", 0.0 + 1e-9)
    fmu.fmu.setRealInputDerivatives([fmu.variables[name].valueReference for name in ("b", "a")], [1, 1], [3.0, -2.0])
    fmu.step(0.0, 0.1)
    assert fmu.get("s") == pytest.approx(0.25 + 0.1 - 2 * 0.1**2 / 2, abs=1e-15)
    assert fmu.get("w") == pytest.approx(1e-9 * 0.1**2 / 2 + 3.0 * 0.1**3 / 3, abs=1e-15)  # w' = t b
    for references, orders, words in (
        ([0, 1], [1, 1], "the value reference 1 is no Real input's."),  # a Boolean
        ([2, 3], [1, 1], "the value reference 3 is no Real input's."),
        ([0, 2], [1, 2], "derivative of order 2 of b; only order 1 is supported."),
    ):
        before = fmu.state()
        message = fmu.refuses(lambda r=references, o=orders: fmu.fmu.setRealInputDerivatives(r, o, [1.0, 1.0]))
        assert message == f"fmi2SetRealInputDerivatives: {words}"
        assert fmu.state() == before


def test_inputs_set_before_the_run_and_their_derivatives_act_in_its_first_step(slave: Make) -> None:
    fmu = slave("double_toy")
    fmu.set("a", 2.0)
    derivative(fmu, "a", 1.0)
    fmu.initialize({"early_kick": 50.0, "late_kick": 50.0})
    fmu.step(0.0, 0.1)
    assert fmu.get("s") == pytest.approx(0.25 + 0.2 + 0.1**2 / 2, abs=1e-15)


# In which states of FMI 2.0.4, figure 11 and table 4.2.4, a co-simulation slave answers what. I: instantiated, M: initialization
# mode, S: step complete, T: terminated.
CALLS: dict[str, tuple[str, Callable[[Slave], object]]] = {
    "fmi2SetupExperiment": ("I", lambda s: s.fmu.setupExperiment()),
    "fmi2EnterInitializationMode": ("I", lambda s: s.fmu.enterInitializationMode()),
    "fmi2ExitInitializationMode": ("M", lambda s: s.fmu.exitInitializationMode()),
    "fmi2DoStep": ("S", lambda s: s.step(0.0, 0.1)),
    "fmi2Terminate": ("S", lambda s: s.fmu.terminate()),
    "fmi2GetReal": ("IMST", lambda s: s.fmu.getReal([0])),
    "fmi2GetInteger": ("IMST", lambda s: s.fmu.getInteger([9])),
    "fmi2GetBoolean": ("IMST", lambda s: s.fmu.getBoolean([1])),
    "fmi2GetString": ("IMST", lambda s: s.fmu.getString([])),
    "fmi2SetReal": ("IMS", lambda s: s.fmu.setReal([0], [1.0])),
    "fmi2SetInteger": ("IMS", lambda s: s.fmu.setInteger([9], [1])),
    "fmi2SetBoolean": ("IMS", lambda s: s.fmu.setBoolean([1], [1])),
    "fmi2SetString": ("IMS", lambda s: s.fmu.setString([], [])),
    "fmi2SetRealInputDerivatives": ("IMS", lambda s: s.fmu.setRealInputDerivatives([0], [1], [0.0])),
    "fmi2GetRealStatus": ("ST", lambda s: s.fmu.getRealStatus(fmi2LastSuccessfulTime)),
    "fmi2GetBooleanStatus": ("ST", lambda s: s.fmu.getBooleanStatus(fmi2Terminated)),
    "fmi2SetDebugLogging": ("IMST", lambda s: s.fmu.setDebugLogging(True, ["logAll"])),
    "fmi2GetFMUstate": ("IMST", lambda s: s.state()),
    "fmi2Reset": ("IMST", lambda s: s.fmu.reset()),
}
STATES = {"I": "instantiated", "M": "in initialization mode", "S": "initialized", "T": "terminated"}


def in_state(fmu: Slave, state: str) -> Slave:
    fmu.fmu.setupExperiment()
    if state in "MST":
        fmu.fmu.enterInitializationMode()
    if state in "ST":
        fmu.fmu.exitInitializationMode()
    if state == "T":
        fmu.fmu.terminate()
    return fmu


@pytest.mark.parametrize("state", STATES)
def test_each_call_is_answered_in_its_states_and_refused_by_name_in_the_others(slave: Make, state: str) -> None:
    for function, (legal, call) in CALLS.items():
        fmu = in_state(slave("double_toy"), state)
        before = fmu.state()
        if state in legal:
            call(fmu)
            continue
        message = fmu.refuses(lambda call=call, fmu=fmu: call(fmu))
        assert message == f"{function} must not be called while the instance is {STATES[state]}."
        assert fmu.state() == before


@pytest.mark.parametrize("state", STATES)
def test_a_state_saved_anywhere_is_taken_up_anywhere(slave: Make, state: str) -> None:
    """Also what it may do next: what is set after it acts where it may, and the end of its run is its own."""
    fmu, other = slave("double_toy"), slave("double_toy")
    fmu.set("weight", 4)
    fmu.fmu.setupExperiment(startTime=1.0, stopTime=1.1)
    if state in "MST":
        fmu.fmu.enterInitializationMode()
    if state in "ST":
        fmu.fmu.exitInitializationMode()
        fmu.set("b", 0.7)
        fmu.step(1.0, 0.05)
    if state == "T":
        fmu.fmu.terminate()
    saved = fmu.state()
    disturbed(other)
    handle = other.fmu.deSerializeFMUstate(saved)
    other.fmu.setFMUState(handle)
    other.fmu.freeFMUState(handle)
    assert other.state() == saved and other.get("weight") == 4
    if state == "T":
        assert "terminated" in other.refuses(lambda: other.step(1.05, 0.05))
        assert other.outputs() == fmu.outputs()
        return
    for one in (fmu, other):
        if state in "IM":
            one.set("start.s", -1.0)
            one.fmu.enterInitializationMode() if state == "I" else None
            one.fmu.exitInitializationMode()
            assert one.get("s") == -1.0
            one.step(1.0, 0.05)
        assert one.fmu.getRealStatus(fmi2LastSuccessfulTime) == pytest.approx(1.05, abs=1e-15)
        one.step(1.05, 0.05)
        assert "goes beyond the stop time 1.1" in one.refuses(lambda one=one: one.step(1.1, 0.05))
    assert other.state() == fmu.state() and other.outputs() == fmu.outputs()


@pytest.fixture
def twin(shared: Path) -> Iterator[Slave]:
    """An FMU whose state is as long as double_toy's, of another GUID: only a description differs."""
    folder = once(shared / "twin", lambda folder: export(replace(double_toy(), description="Its twin"), folder))
    unpacked = once(shared / "twin_unpacked", lambda out: fmpy.extract(str(folder / "double_toy.fmu"), str(out)))
    made = Slave(unpacked)
    yield made
    made.fmu.freeInstance()
    assert not made.blocks


def test_the_state_of_another_fmu_of_equal_size_is_refused(slave: Make, twin: Slave) -> None:
    fmu = slave("double_toy").initialize()
    fmu.step(0.0, 0.1)
    twin.initialize()
    foreign, own = fmu.state(), twin.state()
    assert len(foreign) == len(own)
    message = twin.refuses(lambda: twin.fmu.deSerializeFMUstate(foreign))
    assert message == (
        f"fmi2DeSerializeFMUstate: the state does not belong to double_toy with the GUID {twin.fmu.guid}."
    )
    handle = fmu.fmu.getFMUState()
    assert "the state does not belong to" in twin.refuses(lambda: twin.fmu.setFMUState(handle))
    assert "the state does not belong to" in twin.refuses(lambda: twin.fmu.serializeFMUState(handle))
    fmu.fmu.freeFMUState(handle)
    assert twin.state() == own


def test_a_state_is_written_over_its_own_block_and_freed_once(slave: Make) -> None:
    fmu = slave("double_toy").initialize()
    handle = fmu.fmu.getFMUState()
    blocks = set(fmu.blocks)
    fmu.step(0.0, 0.1)
    later = fmu.state()
    library, instance = fmu.fmu.dll, ctypes.c_void_p(fmu.fmu.component)
    pointer = ctypes.c_void_p(handle.value if hasattr(handle, "value") else handle)
    assert library.fmi2GetFMUstate(instance, ctypes.byref(pointer)) == 0  # no second block for the same state
    assert fmu.blocks == blocks
    fmu.fmu.reset()
    assert library.fmi2SetFMUstate(instance, pointer) == 0
    assert fmu.state() == later
    assert library.fmi2FreeFMUstate(instance, ctypes.byref(pointer)) == 0 and not pointer.value
    assert library.fmi2FreeFMUstate(instance, ctypes.byref(pointer)) == 0
    assert len(fmu.blocks) == len(blocks) - 1


def test_a_buffer_of_the_wrong_size_is_refused_with_both_sizes(slave: Make) -> None:
    fmu = slave("double_toy").initialize()
    size = len(fmu.state())
    handle = fmu.fmu.getFMUState()
    buffer = ctypes.create_string_buffer(size + 8)
    pointer = handle if isinstance(handle, ctypes.c_void_p) else ctypes.c_void_p(handle)
    for given in (size - 1, size + 1):
        fmu.messages.clear()
        assert (
            fmu.fmu.dll.fmi2SerializeFMUstate(
                ctypes.c_void_p(fmu.fmu.component), pointer, buffer, ctypes.c_size_t(given)
            )
            == 3
        )
        text = f"fmi2SerializeFMUstate: the buffer holds {given} bytes, the state has {size}."
        assert [text_ for _, _, text_ in fmu.messages] == [text]
    assert fmu.refuses(lambda: fmu.fmu.deSerializeFMUstate(bytes(size + 1))) == (
        f"fmi2DeSerializeFMUstate: {size + 1} bytes, but a state of double_toy has {size}."
    )
    fmu.fmu.freeFMUState(handle)


def test_one_memory_callback_without_the_other_is_refused(slave: Make) -> None:
    fmu = slave("double_toy")
    library, guid = fmu.fmu.dll, fmu.fmu.guid.encode()
    library.fmi2Instantiate.restype = ctypes.c_void_p
    for missing in ("allocateMemory", "freeMemory"):
        callbacks = fmi2CallbackFunctions()
        callbacks.logger = fmu.callbacks.logger
        callbacks.allocateMemory, callbacks.freeMemory = fmu.callbacks.allocateMemory, fmu.callbacks.freeMemory
        setattr(callbacks, missing, type(getattr(callbacks, missing))())
        fmu.messages.clear()
        assert library.fmi2Instantiate(b"x", 1, guid, b"", ctypes.byref(callbacks), 0, 0) is None
        assert [text for _, _, text in fmu.messages] == [
            "fmi2Instantiate: of allocateMemory and freeMemory one is a null pointer."
        ]
    fmu.messages.clear()
    assert library.fmi2Instantiate(b"x", 0, guid, b"", ctypes.byref(fmu.callbacks), 0, 0) is None
    assert [text for _, _, text in fmu.messages] == [
        "fmi2Instantiate: fmuType = 0, but this is a co-simulation FMU (1)."
    ]


def test_logging_tells_what_was_chosen_last_and_after_a_reset_what_was_chosen_first(slave: Make) -> None:
    fmu = slave("double_toy", logging=False).initialize()

    def told() -> list[str]:
        """The categories that a refused step, a counter that rises and the end of the run are told in."""
        fmu.messages.clear()
        with pytest.raises(FMICallException):
            fmu.step(5.0, 0.1)
        fmu.set("a", 101.0)
        fmu.step(fmu.fmu.getRealStatus(fmi2LastSuccessfulTime), 0.02)
        fmu.set("a", -100.0)
        fmu.step(fmu.fmu.getRealStatus(fmi2LastSuccessfulTime), 0.02)
        fmu.fmu.reset()
        fmu.initialize({"sample_time": 0.02, "early_kick": 9.0, "late_kick": 9.0})
        return [category for _, category, _ in fmu.messages]

    fmu.fmu.reset()
    fmu.initialize({"sample_time": 0.02, "early_kick": 9.0, "late_kick": 9.0})
    assert told() == []
    fmu.fmu.setDebugLogging(True, ["logStatusError", "logStatusWarning"])
    assert told() == ["logStatusError", "logStatusWarning"]
    assert told() == []  # the reset took the choice back
    fmu.fmu.setDebugLogging(True, ["logStatusError"])
    fmu.fmu.setDebugLogging(True, ["logStatusWarning"])
    assert told() == ["logStatusWarning"]
    fmu.fmu.setDebugLogging(True, [])
    fmu.fmu.setDebugLogging(False, ["logAll"])
    assert told() == []
    loud = slave("double_toy")
    loud.fmu.setDebugLogging(False, [])
    loud.fmu.reset()
    loud.messages.clear()
    loud.initialize()
    assert [category for _, category, _ in loud.messages] == ["logEvents"]


def test_events_say_what_happened_and_when(slave: Make) -> None:
    fmu = slave("double_toy").initialize({"sample_time": 0.05}, t0=2.0)
    fmu.step(2.0, 0.05)
    fmu.fmu.terminate()
    fmu.fmu.reset()
    assert [(status, text) for status, category, text in fmu.messages if category == "logEvents"] == [
        (0, "double_toy: initialized at t = 2, sample time 0.05."),
        (0, "double_toy: terminated at t = 2.05."),
        (0, "double_toy: reset."),
    ]


def test_a_status_that_does_not_exist_is_told_as_discarded(slave: Make) -> None:
    fmu = slave("double_toy").initialize()
    fmu.messages.clear()
    for name, kind in (("Integer", 1), ("Real", 1), ("Boolean", 0), ("String", 1)):
        with pytest.raises(FMICallException) as caught:
            getattr(fmu.fmu, f"get{name}Status")(kind)
        assert caught.value.status == 2
        assert fmu.messages[-1] == (
            2,
            "logStatusDiscard",
            f"fmi2Get{name}Status: there is no status of kind {kind}, fmi2DoStep never returns fmi2Pending.",
        )


@pytest.mark.parametrize("t0", [0.0, -7.5])
def test_the_end_of_the_run_is_reached_but_not_passed(slave: Make, t0: float) -> None:
    for excess, good in ((0.0, True), (0.4e-7, True), (2e-7, False)):
        fmu = slave("double_toy").initialize(t0=t0, stop=t0 + 0.1 - excess)
        fmu.step(t0, 0.05)
        if good:
            fmu.step(t0 + 0.05, 0.05)
        else:
            assert "goes beyond the stop time" in fmu.refuses(lambda fmu=fmu: fmu.step(t0 + 0.05, 0.05))
    fmu = slave("double_toy")
    words = f"fmi2SetupExperiment: the stop time {t0 - 1:g} lies before the start time {t0:g}."
    assert fmu.refuses(lambda: fmu.fmu.setupExperiment(startTime=t0, stopTime=t0 - 1)) == words
    fmu.fmu.setupExperiment(startTime=t0, stopTime=t0)
    assert "the start time inf is not finite" in fmu.refuses(lambda: fmu.fmu.setupExperiment(startTime=math.inf))
