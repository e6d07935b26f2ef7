"""The FMU's shell: the Python face's time semantics bit for bit, nothing lost in refused calls, states that resume."""

from __future__ import annotations

import ctypes
import math
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import fmi2CallbackFunctions, fmi2CallbackLoggerTYPE, fmi2LastSuccessfulTime, fmi2Terminated

from components import COMPONENTS
from observers.instance import Instance
from slave import Slave
from tools import ROOT, TESTS

Make = Callable[..., Slave]

NOISY = {
    "sensor.sample_time": 0.1,
    "sensor.noise_bound": 0.02,
    "sensor.noise_std": 0.01,
    "sensor.seed": 7,
    "parameter.theta_jump_time[1]": 0.456,
    "parameter.theta_jump_value[1]": 1.5,
    "parameter.theta_jump_time[2]": 1.0,
    "parameter.theta_jump_value[2]": -0.3,
}


def grid(kind: str, seed: int = 1, steps: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """Times and step sizes (10 to 100 ms, the same for all) of an importer that multiplies, accumulates or rounds."""
    ticks = np.concatenate([[0], np.cumsum(np.random.default_rng(seed).integers(1, 11, steps))])
    exact = ticks * 0.01
    sizes = np.diff(ticks) * 0.01
    if kind == "multiplied":
        return exact[:-1], sizes
    if kind == "accumulated":
        return np.concatenate([[0.0], np.cumsum(sizes)[:-1]]), sizes
    nanoseconds = np.rint(exact * 1e9)
    return nanoseconds[:-1] / 1e9, np.diff(nanoseconds) / 1e9


def run(instance: Slave, kind: str, drive: Callable[[float], dict[str, float]]) -> list[dict[str, float]]:
    rows = []
    exact = grid("multiplied")[0]
    for now, t, h in zip(exact, *grid(kind), strict=True):
        for name, value in drive(now).items():
            instance.set(name, value)
        rows.append(instance.outputs())
        instance.step(t, h)
    return [*rows, instance.outputs()]


def signals(t: float) -> dict[str, float]:
    y = math.nan if 3.0 < t < 3.5 or 7.0 < t < 7.5 else math.sin(t)
    return {
        "y": y,
        "rate": 0.1 * math.cos(3 * t),
        "tuning.gain": 0.25 if t > 5 else 0.5,
        "tuning.mode": 2 if t > 7 else 1,
    }


CASES = {
    "duffing": (NOISY, lambda t: {"u": math.sin(t), "parameter.damping": 0.25 if t < 4 else 0.5}),
    "sampled_toy": ({"start.level": 2.0, "tuning.scale": 3}, signals),
    "feedthrough_toy": ({"gain": 3.0}, lambda t: {"position": math.sin(t)}),
}


@pytest.mark.parametrize("kind", ["multiplied", "accumulated", "rounded"])
@pytest.mark.parametrize("name", CASES)
def test_fmu_equals_python_face_bit_for_bit_whatever_the_importers_times(slave: Make, name: str, kind: str) -> None:
    start, drive = CASES[name]
    rows = run(slave(name).initialize(start), kind, drive)
    face = Instance(COMPONENTS[name](), parameters=start)
    for row, now, t, h in zip(rows[:-1], grid("multiplied")[0], *grid("multiplied"), strict=True):
        for variable, value in drive(now).items():
            face.set(variable, value)
        assert row == {port.name: v for port, v in zip(face.component.outputs, face.outputs(), strict=True)}
        face.step(t, h)
    assert len({row[face.component.outputs[0].name] for row in rows}) > 100


def test_start_time_other_than_zero_shifts_the_sample_instants(slave: Make) -> None:
    fmu = slave("sampled_toy").initialize(t0=5.03)
    face = Instance(COMPONENTS["sampled_toy"](), t0=5.03)
    for k in range(40):
        fmu.set("y", float(k))
        face.set("y", float(k))
        fmu.step(5.03 + k * 0.05, 0.05)
        face.step(5.03 + k * 0.05, 0.05)
        assert fmu.get("estimate.level") == face.get("estimate.level")
        assert fmu.get("filtered.level") == face.get("filtered.level")


@pytest.mark.parametrize("sample_time", [1e-12, 9.9e-7])
def test_an_impossible_sample_time_is_refused_by_both_faces(slave: Make, sample_time: float) -> None:
    fmu = slave("duffing")
    fmu.set("sensor.sample_time", sample_time)
    fmu.fmu.setupExperiment()
    fmu.fmu.enterInitializationMode()
    words = f"duffing: sensor.sample_time = {sample_time:g} must be 0 or finite and at least 1e-06 s"
    assert words in fmu.refuses(fmu.fmu.exitInitializationMode)
    with pytest.raises(ValueError) as refused:
        Instance(COMPONENTS["duffing"](), {"sensor.sample_time": sample_time})
    assert words in str(refused.value)
    fmu.set("sensor.sample_time", 1e-6)
    fmu.fmu.exitInitializationMode()


@pytest.mark.parametrize("sample_time", [1e-6, 1e7])
def test_sample_times_far_from_the_step_size_neither_hang_nor_freeze(slave: Make, sample_time: float) -> None:
    start = NOISY | {"sensor.sample_time": sample_time}
    fmu, face = slave("duffing").initialize(start), Instance(COMPONENTS["duffing"](), start)
    for k in range(5):
        fmu.step(k * 1e-3, 1e-3)
        face.step(k * 1e-3, 1e-3)
    assert fmu.fmu.getRealStatus(fmi2LastSuccessfulTime) == face.time == pytest.approx(5e-3, abs=1e-15)
    assert face.ticks == (1 if sample_time > 1 else 5000)
    assert fmu.get("y") == face.get("y") and fmu.get("x.x1") == face.get("x.x1") != 2.0
    assert "current time" in fmu.refuses(lambda: fmu.step(0.0, 1e-3))


@pytest.mark.parametrize("t0", [-7.3, 1e6, 1.7e9])
@pytest.mark.parametrize("steps", [1, 3])
def test_any_start_time_that_doubles_resolve_has_every_sample(slave: Make, t0: float, steps: int) -> None:
    """At 1.7e9 s (a time of day in Unix seconds) sums of the same times differ by more than a nanosecond."""
    fmu, face = slave("sampled_toy").initialize(t0=t0), Instance(COMPONENTS["sampled_toy"](), t0=t0)
    h, t = 0.1 / steps, t0
    for k in range(60 * steps):
        for one in (fmu, face):
            one.set("y", float(k // steps))
        fmu.step(t0 + k * h, h)
        face.step(t, h)
        t += h
        assert fmu.get("filtered.level") == face.get("filtered.level")
    assert face.ticks == 60


def test_a_time_too_large_for_the_sample_time_is_refused(slave: Make) -> None:
    fmu, face = slave("sampled_toy").initialize(t0=1e15), Instance(COMPONENTS["sampled_toy"](), t0=1e15)
    words = "times are exact to 0.89 s only, too coarse for the sample time 0.1"
    assert words in fmu.refuses(lambda: fmu.step(1e15, 0.1))
    with pytest.raises(ValueError, match=words):
        face.step(1e15, 0.1)


def test_outputs_in_initialization_mode_follow_the_parameters_set_last(slave: Make) -> None:
    fmu = slave("sampled_toy")
    fmu.fmu.setupExperiment()
    fmu.set("start.level", 3.0)
    fmu.fmu.enterInitializationMode()
    assert fmu.get("estimate.level") == 3.0
    fmu.set("start.level", -4.0)
    assert fmu.get("estimate.level") == -4.0
    fmu.fmu.exitInitializationMode()
    assert fmu.get("estimate.level") == -4.0


def test_direct_feedthrough_answers_without_a_step(slave: Make) -> None:
    fmu = slave("feedthrough_toy").initialize()
    fmu.set("position", 1.5)
    assert fmu.get("force") == -3.0
    fmu.set("gain", 4.0)
    assert fmu.get("force") == -6.0


def test_input_derivatives_extrapolate_within_one_step_only(slave: Make) -> None:
    fmu = slave("sampled_toy").initialize({"tuning.gain": 0.0, "kick_time": 100.0})
    rate = fmu.variables["rate"].valueReference
    fmu.set("rate", 1.0)
    fmu.fmu.setRealInputDerivatives([rate], [1], [2.0])
    fmu.step(0.0, 0.1)  # the integral of 1 + 2 t; the midpoint of each substep is exact for it
    assert fmu.get("estimate.level") == pytest.approx(1 + 0.1 + 0.1**2, abs=1e-15)
    y = fmu.variables["y"].valueReference
    fmu.fmu.setRealInputDerivatives([y], [1], [1.0])
    fmu.step(0.1, 0.1)  # the derivative of the rate is gone, its value stays
    assert fmu.get("estimate.level") == pytest.approx(1 + 0.1 + 0.1**2 + 0.1, abs=1e-15)


def test_a_sample_instant_within_a_step_sees_the_input_of_that_instant(slave: Make) -> None:
    fmu = slave("sampled_toy").initialize({"tuning.mode": 2, "rate": 0.0})
    fmu.step(0.0, 0.05)
    fmu.set("y", 7.0)
    fmu.fmu.setRealInputDerivatives([fmu.variables["y"].valueReference], [1], [10.0])
    fmu.step(0.05, 0.1)
    assert fmu.get("filtered.level") == pytest.approx(7.5, abs=1e-15)


def test_a_rising_counter_is_one_warning_and_the_step_is_fine(slave: Make) -> None:
    fmu = slave("sampled_toy").initialize()
    fmu.messages.clear()
    fmu.set("y", math.inf)
    before = fmu.fmu.getFMUState()
    fmu.step(0.0, 0.1)
    text = "sampled_toy: diagnostics.rejected_samples rose to 1 at t = 0.1."
    assert fmu.messages == [(1, "logStatusWarning", text)]
    fmu.fmu.setFMUState(before)
    fmu.fmu.freeFMUState(before)
    fmu.step(0.0, 0.1)
    assert fmu.messages == [(1, "logStatusWarning", text)] * 2
    fmu.set("y", 0.0)
    fmu.step(0.1, 0.1)
    assert len(fmu.messages) == 2
    assert fmu.get("diagnostics.rejected_samples") == 1


# What is refused: (call, words of the message). Each leaves the instance as it was.
REFUSED: dict[str, tuple[Callable[[Slave], object], list[str]]] = {
    "step longer than the sample time": (lambda s: s.step(0.5, 0.11), ["h = 0.11", "sample time 0.1"]),
    "backward time": (lambda s: s.step(0.4, 0.1), ["t = 0.4", "current time is 0.5"]),
    "forward time": (lambda s: s.step(0.6, 0.1), ["t = 0.6", "current time is 0.5"]),
    "time that is no number": (lambda s: s.step(math.nan, 0.1), ["t = nan", "0.5"]),
    "step of zero": (lambda s: s.step(0.5, 0.0), ["h = 0 must be positive"]),
    "negative step": (lambda s: s.step(0.5, -0.1), ["h = -0.1"]),
    "infinite step": (lambda s: s.step(0.5, math.inf), ["h = inf"]),
    "fixed parameter after initialization": (lambda s: s.set("start.level", 2.0), ["start.level", "fixed", "2"]),
    "parameter above its maximum": (lambda s: s.set("tuning.gain", 1.5), ["tuning.gain = 1.5", "[0, 1]"]),
    "parameter below its minimum": (lambda s: s.set("tuning.gain", -0.5), ["tuning.gain = -0.5", "[0, 1]"]),
    "parameter that is no number": (lambda s: s.set("tuning.gain", math.nan), ["tuning.gain = nan", "[0, 1]"]),
    "integer out of range": (lambda s: s.set("tuning.scale", 6), ["tuning.scale = 6", "[1, 5]"]),
    "item that the enumeration lacks": (lambda s: s.set("tuning.mode", 3), ["tuning.mode = 3", "[1, 2]"]),
    "output set": (lambda s: s.set("estimate.level", 1.0), ["estimate.level", "an output"]),
    "constant set": (lambda s: s.set("certificate", 1.0), ["certificate", "a constant"]),
    "unknown reference set": (lambda s: s.fmu.setReal([99], [1.0]), ["99", "13"]),
    "unknown reference read": (lambda s: s.fmu.getReal([14]), ["14", "13"]),
    "unknown reference of another type": (lambda s: s.fmu.getString([99]), ["99", "13"]),
    "Real read as Integer": (lambda s: s.fmu.getInteger([0]), ["y", "not of type Integer but Real"]),
    "Integer set as Real": (lambda s: s.fmu.setReal([6], [1.0]), ["tuning.scale", "not of type Real but Integer"]),
    "Real read as Boolean": (lambda s: s.fmu.getBoolean([0]), ["y", "Real"]),
    "Real set as String": (lambda s: s.fmu.setString([0], ["1"]), ["y", "Real"]),
    "derivative of second order": (lambda s: s.fmu.setRealInputDerivatives([0], [2], [1.0]), ["order 2", "y"]),
    "derivative of a parameter": (lambda s: s.fmu.setRealInputDerivatives([2], [1], [1.0]), ["2 is no Real input"]),
    "output derivative": (lambda s: s.fmu.getRealOutputDerivatives([8], [1]), ["maxOutputDerivativeOrder=0"]),
    "cancel": (lambda s: s.fmu.cancelStep(), ["no step is in progress"]),
    "initialization mode again": (
        lambda s: s.fmu.enterInitializationMode(),
        ["fmi2EnterInitializationMode", "initialized"],
    ),
    "exit of a mode that is over": (lambda s: s.fmu.exitInitializationMode(), ["fmi2ExitInitializationMode"]),
    "set-up after initialization": (lambda s: s.fmu.setupExperiment(), ["fmi2SetupExperiment", "initialized"]),
    "unknown log category": (lambda s: s.fmu.setDebugLogging(True, ["logStatusError", "logNoise"]), ["logNoise"]),
    "state of another FMU": (lambda s: s.fmu.setFMUstate(ctypes.create_string_buffer(512)), ["does not belong", "{"]),
    "no state": (lambda s: s.fmu.setFMUstate(None), ["null pointer"]),
    "serialised state too short": (lambda s: s.fmu.deSerializeFMUstate(s.state()[:-1]), ["bytes"]),
    "serialised state damaged": (lambda s: s.fmu.deSerializeFMUstate(s.state()[:-1] + b"\x7f"), ["checksum"]),
}


@pytest.mark.parametrize("what", REFUSED)
def test_refused_with_one_message_and_the_instance_unchanged(slave: Make, what: str) -> None:
    call, words = REFUSED[what]
    fmu = slave("sampled_toy").initialize({"start.level": 0.7})
    for k in range(5):
        fmu.set("y", 0.1 * k)
        fmu.step(k * 0.1, 0.1)
    before, outputs = fmu.state(), fmu.outputs()
    message = fmu.refuses(lambda: call(fmu))
    assert all(word in message for word in words), message
    assert fmu.state() == before
    assert fmu.outputs() == outputs
    fmu.step(0.5, 0.1)


def test_a_refused_set_leaves_the_earlier_entries_of_the_call_alone(slave: Make) -> None:
    fmu = slave("sampled_toy").initialize()
    before = fmu.state()
    references = [fmu.variables[name].valueReference for name in ("y", "tuning.gain", "estimate.level")]
    fmu.refuses(lambda: fmu.fmu.setReal(references, [5.0, 0.1, 1.0]))
    assert fmu.state() == before


def test_a_step_beyond_the_stop_time_is_refused(slave: Make) -> None:
    fmu = slave("sampled_toy").initialize(stop=0.25)
    fmu.step(0.0, 0.1)
    fmu.step(0.1, 0.1)
    message = fmu.refuses(lambda: fmu.step(0.2, 0.1))
    assert "0.3" in message and "stop time 0.25" in message
    fmu.step(0.2, 0.05)


def test_a_state_that_leaves_the_finite_numbers_is_refused_and_the_last_one_kept(slave: Make) -> None:
    fmu = slave("growing_toy").initialize()
    values, states = [fmu.get("z")], [fmu.state()]
    with pytest.raises(FMICallException):
        for k in range(100):
            fmu.step(k * 0.1, 0.1)
            values.append(fmu.get("z"))
            states.append(fmu.state())
    status, category, text = fmu.messages[-1]
    assert (status, category) == (3, "logStatusError")
    assert "not finite" in text and "growing_toy" in text
    assert math.isfinite(values[-1]) and fmu.get("z") == values[-1]
    assert fmu.state() == states[-1]
    assert fmu.fmu.getRealStatus(fmi2LastSuccessfulTime) == pytest.approx((len(values) - 1) * 0.1, abs=1e-15)


def test_an_input_that_makes_the_state_not_finite_is_named_by_both_faces(slave: Make) -> None:
    fmu, face = slave("duffing").initialize(), Instance(COMPONENTS["duffing"]())
    before = fmu.state()
    fmu.set("u", math.nan)
    face.set("u", math.nan)
    words = "the state is not finite after the step from t = 0 to 0.1, where the input u is nan"
    assert words in fmu.refuses(lambda: fmu.step(0.0, 0.1))
    with pytest.raises(ValueError, match=words):
        face.step(0.0, 0.1)
    fmu.set("u", 0.0)
    assert fmu.state() == before
    fmu.step(0.0, 0.1)


def test_start_values_without_a_finite_state_are_refused(slave: Make) -> None:
    fmu = slave("growing_toy")
    fmu.set("start.z", 1e308)
    fmu.fmu.setupExperiment()
    fmu.fmu.enterInitializationMode()
    assert "no finite state" in fmu.refuses(fmu.fmu.exitInitializationMode)
    fmu.set("start.z", 1.0)
    fmu.fmu.exitInitializationMode()


def test_illegal_call_orders_are_named(slave: Make) -> None:
    fmu = slave("sampled_toy")
    assert "fmi2DoStep" in fmu.refuses(lambda: fmu.step(0.0, 0.1))
    assert "fmi2SetupExperiment" in fmu.refuses(fmu.fmu.enterInitializationMode)
    assert "estimate.level" in fmu.refuses(lambda: fmu.get("estimate.level"))
    assert fmu.get("tuning.gain") == 0.5
    assert "start time" in fmu.refuses(lambda: fmu.fmu.setupExperiment(startTime=1.0, stopTime=0.0))
    fmu.fmu.setupExperiment()
    assert "fmi2Terminate" in fmu.refuses(fmu.fmu.terminate)
    fmu.fmu.enterInitializationMode()
    assert "initialization mode" in fmu.refuses(lambda: fmu.step(0.0, 0.1))
    fmu.fmu.exitInitializationMode()
    fmu.step(0.0, 0.1)
    level = fmu.get("estimate.level")
    fmu.fmu.terminate()
    assert "terminated" in fmu.refuses(lambda: fmu.step(0.1, 0.1))
    assert "terminated" in fmu.refuses(lambda: fmu.set("y", 1.0))
    assert fmu.get("estimate.level") == level


def test_status_queries_of_a_synchronous_slave(slave: Make) -> None:
    fmu = slave("sampled_toy").initialize()
    fmu.step(0.0, 0.1)
    assert fmu.fmu.getRealStatus(fmi2LastSuccessfulTime) == 0.1
    assert not fmu.fmu.getBooleanStatus(fmi2Terminated)
    for ask in (fmu.fmu.getStatus, fmu.fmu.getIntegerStatus, fmu.fmu.getStringStatus):
        with pytest.raises(FMICallException) as caught:
            ask(0)
        assert caught.value.status == 2  # fmi2Discard: there is no such status


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"guid": "{00000000-0000-0000-0000-000000000000}"}, ["{00000000", "belongs to {"]),
        ({"guid": "%n%s"}, ["GUID is ?n?s"]),  # text from outside must not act as a format
        ({"name": ""}, ["instance name"]),
    ],
)
def test_instantiation_is_refused_aloud_even_with_logging_off(
    unpacked: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch, change: dict[str, str], words: list[str]
) -> None:
    seen: list[str] = []
    real = fmi2CallbackLoggerTYPE
    monkeypatch.setattr("slave.fmi2CallbackLoggerTYPE", lambda _: real(lambda *call: seen.append(call[4].decode())))
    with pytest.raises(Exception, match="instantiate"):
        Slave(unpacked("sampled_toy"), logging=False, **change)
    assert len(seen) == 1
    assert all(word in seen[0] for word in words), seen[0]


def test_null_pointers_are_answered_not_followed(slave: Make, unpacked: Callable[[str], Path]) -> None:
    fmu = slave("sampled_toy").initialize()
    library, handle = fmu.fmu.dll, ctypes.c_void_p(fmu.fmu.component)
    library.fmi2Instantiate.restype = ctypes.c_void_p
    guid = fmu.fmu.guid.encode()
    assert library.fmi2Instantiate(b"x", 1, guid, b"", None, 0, 0) is None
    assert library.fmi2DoStep(None, ctypes.c_double(0), ctypes.c_double(0.1), 0) == 3
    assert library.fmi2GetReal(handle, None, ctypes.c_size_t(1), None) == 3
    assert library.fmi2SetReal(handle, None, ctypes.c_size_t(1), None) == 3
    assert library.fmi2GetFMUstate(handle, None) == 3
    assert library.fmi2FreeFMUstate(handle, None) == 0
    library.fmi2FreeInstance(None)


def test_without_memory_callbacks_the_c_library_serves(slave: Make) -> None:
    fmu = slave("sampled_toy")
    library = fmu.fmu.dll
    library.fmi2Instantiate.restype = ctypes.c_void_p
    callbacks = fmi2CallbackFunctions()
    made = library.fmi2Instantiate(b"x", 1, fmu.fmu.guid.encode(), b"", ctypes.byref(callbacks), 0, 0)
    assert made
    library.fmi2FreeInstance(ctypes.c_void_p(made))


def test_memory_that_is_refused_is_an_answer(slave: Make) -> None:
    fmu = slave("sampled_toy").initialize()
    fmu.callbacks.allocateMemory = type(fmu.callbacks.allocateMemory)(lambda count, size: None)
    library = fmu.fmu.dll
    library.fmi2Instantiate.restype = ctypes.c_void_p
    assert library.fmi2Instantiate(b"x", 1, fmu.fmu.guid.encode(), b"", ctypes.byref(fmu.callbacks), 0, 0) is None
    assert "refused" in fmu.messages[-1][2]


def test_logging_is_silent_until_on_and_by_category(slave: Make) -> None:
    fmu = slave("sampled_toy", logging=False).initialize()
    with pytest.raises(FMICallException):
        fmu.step(5.0, 0.1)
    assert fmu.messages == []
    fmu.fmu.setDebugLogging(True, ["logEvents"])
    with pytest.raises(FMICallException):
        fmu.step(5.0, 0.1)
    fmu.fmu.terminate()
    assert [category for _, category, _ in fmu.messages] == ["logEvents"]
    fmu.fmu.setDebugLogging(True, ["logAll"])
    with pytest.raises(FMICallException):
        fmu.step(5.0, 0.1)
    assert [category for _, category, _ in fmu.messages] == ["logEvents", "logStatusError"]


def test_reset_is_a_fresh_instance_bit_for_bit(slave: Make) -> None:
    fmu, fresh = slave("duffing"), slave("duffing")
    first = fresh.state()
    assert fmu.state() == first
    run(fmu.initialize(NOISY), "accumulated", CASES["duffing"][1])
    fmu.fmu.reset()
    assert fmu.state() == first
    assert run(fmu.initialize(NOISY), "multiplied", CASES["duffing"][1]) == run(
        fresh.initialize(NOISY), "multiplied", CASES["duffing"][1]
    )


@pytest.mark.parametrize("name", ["duffing", "sampled_toy"])
def test_a_restored_state_runs_on_bit_for_bit(slave: Make, name: str) -> None:
    start, drive = CASES[name]
    fmu = slave(name).initialize(start)
    points = list(zip(grid("multiplied")[0], *grid("multiplied"), strict=True))

    def go(part: list[tuple[float, float, float]]) -> list[dict[str, float]]:
        rows = []
        for now, t, h in part:
            for variable, value in drive(now).items():
                fmu.set(variable, value)
            fmu.step(t, h)
            rows.append(fmu.outputs())
        return rows

    go(points[:100])
    reference = fmu.variables["u" if name == "duffing" else "rate"].valueReference
    fmu.fmu.setRealInputDerivatives([reference], [1], [0.5])  # part of the state, too
    saved, outputs = fmu.fmu.getFMUState(), fmu.outputs()
    fmu.messages.clear()
    rest, messages = go(points[100:]), list(fmu.messages)
    fmu.fmu.setFMUState(saved)
    assert fmu.outputs() == outputs
    fmu.messages.clear()
    assert go(points[100:]) == rest
    assert fmu.messages == messages
    fmu.fmu.freeFMUState(saved)


RESUME = """
import sys
sys.path[:0] = {paths!r}
from pathlib import Path
from slave import Slave
from test_shell import CASES, grid
name = {name!r}
fmu = Slave(Path({folder!r}))
fmu.fmu.setFMUState(fmu.fmu.deSerializeFMUstate(Path({state!r}).read_bytes()))
for now, t, h in list(zip(grid("multiplied")[0], *grid("multiplied")))[3:]:
    for variable, value in CASES[name][1](now).items():
        fmu.set(variable, value)
    fmu.step(t, h)
print(fmu.state().hex())
"""


@pytest.mark.parametrize("name", ["duffing", "sampled_toy"])
def test_a_serialised_state_resumes_bit_for_bit_in_a_new_process(
    slave: Make, unpacked: Callable[[str], Path], tmp_path: Path, name: str
) -> None:
    start, drive = CASES[name]
    fmu = slave(name).initialize(start)
    for k, (now, t, h) in enumerate(zip(grid("multiplied")[0], *grid("multiplied"), strict=True)):
        if k == 3:  # before the right-hand side jumps
            (tmp_path / "state").write_bytes(fmu.state())
        for variable, value in drive(now).items():
            fmu.set(variable, value)
        fmu.step(t, h)
    script = RESUME.format(
        paths=[str(Path(__file__).parent), str(TESTS), str(ROOT)],
        name=name,
        folder=str(unpacked(name)),
        state=str(tmp_path / "state"),
    )
    output = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert output.strip() == fmu.state().hex()


def test_eight_instances_in_eight_threads_give_the_sequential_results(slave: Make) -> None:
    def one(fmu: Slave, seed: int) -> list[dict[str, float]]:
        return run(fmu.initialize(NOISY | {"sensor.seed": seed}), "multiplied", CASES["duffing"][1])

    sequential = [one(slave("duffing"), seed) for seed in range(8)]
    instances = [slave("duffing") for _ in range(8)]
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(one, instances, range(8))) == sequential
    assert sequential[0] != sequential[1]


def test_infinite_parameters_are_refused_by_both_faces(slave: Make) -> None:
    fmu = slave("sampled_toy")
    assert "kick_time = inf must be finite" in fmu.refuses(lambda: fmu.set("kick_time", math.inf))
    with pytest.raises(ValueError, match="kick_time = -inf must be finite"):
        Instance(COMPONENTS["sampled_toy"](), {"kick_time": -math.inf})


def test_an_output_that_is_not_finite_is_no_silent_number(slave: Make) -> None:
    """From an input that is not finite it is a warning; from finite ones an error."""
    fmu = slave("feedthrough_toy").initialize()
    reference = [fmu.variables["force"].valueReference]
    fmu.set("position", math.nan)
    fmu.messages.clear()
    assert math.isnan(fmu.fmu.getReal(reference)[0])  # fmpy goes on after fmi2Warning
    words = "feedthrough_toy: the output force is nan at t = 0, where the input position is nan."
    assert fmu.messages == [(1, "logStatusWarning", words)]
    fmu.step(0.0, 0.1)  # the motion itself has nothing to do with it
    fmu.set("position", 1e300)
    fmu.set("gain", 1e300)
    words = "the output force is -inf at t = 0.1"
    assert words in fmu.refuses(lambda: fmu.get("force"))
    before = fmu.state()
    assert "the output force is -inf at t = 0.2" in fmu.refuses(lambda: fmu.step(0.1, 0.1))
    assert fmu.state() == before
    face = Instance(COMPONENTS["feedthrough_toy"](), {"gain": 1e300}, inputs={"position": 1e300})
    with pytest.raises(ValueError, match=r"the output force is -inf at t = 0\.1"):
        face.step(0.0, 0.1)
    assert face.time == 0
    fmu.set("gain", 1.0)
    fmu.step(0.1, 0.1)


def test_a_time_too_large_for_the_step_is_refused(slave: Make) -> None:
    fmu, face = slave("duffing").initialize(t0=1e15), Instance(COMPONENTS["duffing"](), t0=1e15)
    words = "times are exact to 0.89 s only, too coarse for the step size 0.1"
    assert words in fmu.refuses(lambda: fmu.step(1e15, 0.1))
    with pytest.raises(ValueError, match=words):
        face.step(1e15, 0.1)


@pytest.mark.parametrize(("start", "h"), [({}, 1e5), ({"sensor.sample_time": 1e-6}, 2.0), ({}, 1e300)])
def test_a_step_of_too_many_substeps_is_refused(slave: Make, start: dict[str, float], h: float) -> None:
    fmu, face = slave("duffing").initialize(start), Instance(COMPONENTS["duffing"](), start)
    message = fmu.refuses(lambda: fmu.step(0.0, h))
    assert h == 1e300 or ("max_step = " in message and "no more than 1000000" in message)
    with pytest.raises(ValueError) as refused:
        face.step(0.0, h)
    assert str(refused.value) == message.rstrip(".")
    fmu.step(0.0, 0.1)


def test_null_pointers_of_status_queries_are_named(slave: Make) -> None:
    fmu = slave("sampled_toy").initialize()
    library, handle = fmu.fmu.dll, ctypes.c_void_p(fmu.fmu.component)
    for function, kind in (("fmi2GetRealStatus", fmi2LastSuccessfulTime), ("fmi2GetBooleanStatus", fmi2Terminated)):
        fmu.messages.clear()
        assert getattr(library, function)(handle, kind, None) == 3
        assert [text for _, _, text in fmu.messages] == [f"{function}: the place for the value is a null pointer."]
    for function in ("fmi2GetStatus", "fmi2GetIntegerStatus", "fmi2GetStringStatus"):
        assert getattr(library, function)(handle, 0, None) == 2


def test_every_other_null_pointer_is_refused_with_one_message(slave: Make) -> None:
    fmu = slave("sampled_toy").initialize()
    library, handle = fmu.fmu.dll, ctypes.c_void_p(fmu.fmu.component)
    content = fmu.state()
    state, one, size = ctypes.c_void_p(), ctypes.c_size_t(1), ctypes.c_size_t(len(content))
    assert library.fmi2GetFMUstate(handle, ctypes.byref(state)) == 0
    reference, space = (ctypes.c_uint * 1)(0), ctypes.create_string_buffer(len(content))
    order, nobody = (ctypes.c_int * 1)(1), (ctypes.c_char_p * 1)(None)
    accesses = [f"fmi2{verb}{kind}" for verb in ("Get", "Set") for kind in ("Real", "Integer", "Boolean", "String")]
    calls: list[tuple[str, tuple[Any, ...]]] = [
        *((name, (None, one, space)) for name in accesses),
        *((name, (reference, one, None)) for name in accesses),
        ("fmi2SetRealInputDerivatives", (None, one, order, space)),
        ("fmi2SetRealInputDerivatives", (reference, one, None, space)),
        ("fmi2SetRealInputDerivatives", (reference, one, order, None)),
        ("fmi2GetFMUstate", (None,)),
        ("fmi2SetFMUstate", (None,)),
        ("fmi2SerializedFMUstateSize", (state, None)),
        ("fmi2SerializedFMUstateSize", (None, ctypes.byref(ctypes.c_size_t()))),
        ("fmi2SerializeFMUstate", (state, None, size)),
        ("fmi2SerializeFMUstate", (None, space, size)),
        ("fmi2DeSerializeFMUstate", (None, size, ctypes.byref(ctypes.c_void_p()))),
        ("fmi2DeSerializeFMUstate", (content, size, None)),
        ("fmi2SetDebugLogging", (1, one, None)),
        ("fmi2SetDebugLogging", (1, one, nobody)),
    ]
    for name, arguments in calls:
        fmu.messages.clear()
        function = library[name]  # unlike the attribute, without the types that fmpy declared
        assert function(handle, *arguments) == 3, (name, arguments)
        told = [(status, category, text.partition(":")[0]) for status, category, text in fmu.messages]
        assert told == [(3, "logStatusError", name)], (name, arguments)
    assert library["fmi2FreeFMUstate"](handle, None) == 0  # the standard: ignored
    assert library.fmi2FreeFMUstate(handle, ctypes.byref(state)) == 0
    assert fmu.state() == content


def test_what_a_step_takes_is_counted_from_where_the_run_is(slave: Make) -> None:
    """A third of a million sample instants a step, three times: each step is legal, however many went before."""
    fmu = slave("duffing").initialize({"sensor.sample_time": 1e-6})
    for k in range(3):
        fmu.step(0.35 * k, 0.35)
    assert fmu.fmu.getRealStatus(fmi2LastSuccessfulTime) == pytest.approx(1.05, abs=1e-15)
