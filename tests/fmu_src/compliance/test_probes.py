"""What the probes do with an FMU: the steps that they take, the values that they set, where they stop, what they say.

The sound FMU's x' = gain u - x is stepped by Euler, so that x after k steps of 0.1 from 1 is known: 1.5 - 0.5 0.9^k.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from ctypes import c_uint
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from broken_fmus import told
from fmu_src.compliance.library import lifecycle, states, steps, values
from fmu_src.compliance.library.calls import Broken
from fmu_src.compliance.library.fmu import Fmu
from fmu_src.compliance.library.instance import Progress

Load = Callable[..., Fmu]
Calls = list[tuple[str, list[Any]]]


def recorded(fmu: Fmu) -> Calls:
    """The calls that are made of it from here on: each with its arguments behind the instance, arrays as lists."""
    calls: Calls = []
    function = fmu.function

    def recording(name: str, result: Any = None) -> Any:
        called = function(name) if result is None else function(name, result)

        def call(*arguments: Any) -> Any:
            calls.append((name, [list(a) if hasattr(a, "_length_") else a for a in arguments[1:]]))
            return called(*arguments)

        return call

    fmu.function = recording  # type: ignore[method-assign]
    return calls


def set_to(calls: Calls) -> list[tuple[int, Any]]:
    """(value reference, value) of all that was set, in order."""
    return [(a[0][0], a[2][0]) for name, a in calls if name.startswith("fmi2Set") and len(a) == 3]


def after(steps: int) -> list[float]:
    return [1.5 - 0.5 * 0.9**k for k in range(steps + 1)]


def ended(probe: Any) -> Any:
    """What a probe without findings returns."""
    with pytest.raises(StopIteration) as end:
        next(probe)
    return end.value.value


def test_a_life_is_eight_steps_of_the_default_size(load: Load) -> None:
    fmu = load()
    calls = recorded(fmu)
    rows = ended(lifecycle.life(fmu))
    assert [name for name, _ in calls[-2:]] == ["fmi2Terminate", "fmi2FreeInstance"]
    np.testing.assert_allclose([row["x"] for row in rows], after(8), rtol=0, atol=1e-14)
    assert [row["count"] for row in rows] == list(range(9))
    assert set(rows[0]) == {"x", "count", "y"}


def test_time_is_counted(load: Load) -> None:
    fmu = load()
    calls = recorded(fmu)
    fmu.initialized().run(12)
    points = [a[0] for name, a in calls if name == "fmi2DoStep"]
    assert points == [k * 0.1 for k in range(12)]


def test_the_first_difference_of_each_variable_is_told_and_nan_is_nan() -> None:
    expected = [{"a": 1.0, "b": 2, "c": math.nan}, {"a": 1.5, "b": 3, "c": math.nan}, {"a": 2.0, "b": 4, "c": 0.0}]
    found = [{"a": 1.0, "b": 2, "c": math.nan}, {"a": 1.25, "b": 3, "c": math.nan}, {"a": 0.0, "b": 5, "c": -0.0}]
    lines = [str(one) for one in lifecycle.differences("reset", expected, found, "as ever")]
    assert lines == [
        "reset [2.1.6] a: expected 1.5 after 1 steps, as ever; found 1.25",
        "reset [2.1.6] b: expected 4 after 2 steps, as ever; found 5",
        "reset [2.1.6] c: expected 0.0 after 2 steps, as ever; found -0.0",
    ]
    assert list(lifecycle.differences("reset", expected, expected, "as ever")) == []
    (shorter,) = lifecycle.differences("reset", expected, expected[:2], "as ever")
    assert str(shorter) == "reset [2.1.6] the run: expected 2 steps, as ever; found 1 until the FMU ended it"


@pytest.mark.parametrize(
    ("start", "low", "high", "other"),
    [
        (0.5, -10, 10, 0.625),
        (-4.0, -10, 10, -3.5),
        (10.0, -10, 10, 8.75),
        (1.0, 0.75, 1.125, 1.125),
        (1.0, 0.875, 1.0625, 0.875),
        (1.0, 0.96875, 1.0625, 1.03125),
        (1.0, 0.9375, 1.0, 0.96875),
        (1.0, 1.0, 1.0, 1.0),
        (3, 0, math.inf, 3.375),
    ],
)
def test_another_value_is_near_by_within_the_limits_and_another_if_there_is_one(
    start: float, low: float, high: float, other: float
) -> None:
    assert lifecycle.other_value(start, low, high) == other


def test_what_is_set_and_read_again_are_other_values_and_only_what_can_be_set_then(load: Load) -> None:
    fmu = load()
    calls = recorded(fmu)
    assert list(values.set_get(fmu)) == []
    names = [name for name, _ in calls if name.startswith("fmi2Set") and name != "fmi2SetupExperiment"]
    assert names == ["fmi2SetReal"] * 2 + ["fmi2SetInteger", "fmi2SetString"] + ["fmi2SetReal", "fmi2SetBoolean"] + [
        "fmi2SetReal",
        "fmi2SetReal",
        "fmi2SetInteger",
        "fmi2SetBoolean",
    ]
    before = [(1, 3.0), (2, 1.0), (11, 1), (30, b"label")]
    assert set_to(calls) == [*before, (0, 0.625), (20, False), (0, 0.625), (1, 3.375), (11, 1), (20, False)]


@pytest.mark.parametrize(("largest", "value"), [("", 8), (' max="8"', 8), (' max="7"', 7)])
def test_an_integer_is_set_to_the_next_where_its_limit_allows_it(load: Load, largest: str, value: int) -> None:
    edits = {
        '<Enumeration declaredType="Mode" start="1"/>': f'<Integer start="7"{largest}/>',
    }
    fmu = load(edits=edits)
    calls = recorded(fmu)
    list(values.set_get(fmu))
    assert (11, value) in set_to(calls)[4:]


@pytest.mark.parametrize(("start", "is_found"), [("3.000000002", False), ("3.000000004", True), ("NaN", True)])
def test_a_start_value_is_the_descriptions_to_nine_digits(load: Load, start: str, is_found: bool) -> None:
    fmu = load(edits={'<Real start="3"/>': f'<Real start="{start}"/>'})
    assert told(values.start_values(fmu)) == ([("start-value", "gain", "3.0")] if is_found else [])


def test_start_values_are_those_of_inputs_constants_and_exact_parameters(load: Load) -> None:
    fmu = load(
        edits={
            'max="10" start="0.5"': 'max="10" start="0.25"',
            '<Real start="1"/>': '<Real start="2"/>',
            '<Real start="100"/>': '<Real start="99"/>',
            '<Boolean start="true"/>': '<Boolean start="false"/>',
            '<String start="label"/>': '<String start="other"/>',
            'initial="calculated"><Real unit="m"/>': 'initial="approx"><Real unit="m" start="7"/>',
        }
    )
    found = [(one.subject, one.expected, one.found) for one in values.start_values(fmu)]
    assert found == [
        ("u", "0.25 as start value", "0.5"),
        ("start", "2.0 as start value", "1.0"),
        ("limit", "99.0 as start value", "100.0"),
        ("active", "False as start value", "1"),
        ("label", "other as start value", "label"),
    ]


def test_of_many_variables_at_most_twenty_are_tried_evenly_spread() -> None:
    everything: Any = list(range(100))
    assert values.sample([]) == [] and values.sample(everything[:20]) == everything[:20]
    assert values.sample(everything[:21]) == everything[:21:2] and values.sample(everything) == everything[::5]


def test_the_reference_that_does_not_exist_does_not(load: Load) -> None:
    fmu = load(edits={'name="limit" valueReference="4"': f'name="limit" valueReference="{2**32 - 2}"'})
    calls = recorded(fmu)
    for verb in ("Get", "Set"):
        for kind in ("Real", "Integer", "Boolean", "String"):
            assert list(values.unknown_reference(fmu, f"fmi2{verb}{kind}")) == []
    assert [a[0] for name, a in calls if len(a) == 3 and name[4:7] in ("Get", "Set")] == [[2**32 - 3]] * 8


def test_a_refusal_is_asked_for_with_the_start_value_or_one_of_the_kind(load: Load) -> None:
    fmu = load()
    limit, count = fmu.subject.variables[4:6]
    calls = recorded(fmu)
    for state in ("instantiated", "initialized"):
        assert list(values.refused_set(fmu, "set-constant", limit, state)) == []
        assert list(values.refused_set(fmu, "set-calculated", count, state)) == []
    assert set_to(calls) == [(4, 100.0), (10, 1)] * 2


def test_inputs_without_sense_are_kept_for_two_steps(load: Load) -> None:
    fmu = load()
    calls = recorded(fmu)
    assert list(values.nan_input(fmu, math.inf)) == []
    assert set_to(calls) == [(0, math.inf)]
    assert [name for name, _ in calls if name in ("fmi2DoStep", "fmi2SetReal")] == ["fmi2DoStep", "fmi2SetReal"] + [
        "fmi2DoStep"
    ] * 2


@pytest.mark.parametrize(
    ("probe", "argument", "points"),
    [
        (steps.step_size, -1.0, [(0.0, -0.1)]),
        (steps.communication_point, -2, [(0.0, 0.1), (0.1, 0.1), (0.2, 0.1), (0.1, 0.1)]),
        (steps.communication_point, 10, [(0.0, 0.1), (0.1, 0.1), (0.2, 0.1), (1.3, 0.1)]),
        (steps.stop_time, None, [(0.0, 0.1), (0.1, 0.1), (0.2, 0.1)]),
    ],
)
def test_steps_that_must_be_refused_begin_where_the_rule_says(
    load: Load, probe: Any, argument: float | None, points: list[tuple[float, float]]
) -> None:
    fmu = load()
    calls = recorded(fmu)
    assert list(probe(fmu) if argument is None else probe(fmu, argument)) == []
    taken = [a for name, a in calls if name == "fmi2DoStep"]
    np.testing.assert_allclose([a[:2] for a in taken], points, rtol=0, atol=1e-12)
    assert {a[2] for a in taken} == {1}  # no state from before is set any more


def test_the_stop_time_is_said_and_only_where_there_is_one(load: Load) -> None:
    fmu = load(start=2.0, step=0.25)
    calls = recorded(fmu)
    list(steps.stop_time(fmu))
    fmu.new().setup()
    said = [a for name, a in calls if name == "fmi2SetupExperiment"]
    assert said == [[0, 0.0, 2.0, 1, 2.5], [0, 0.0, 2.0, 0, 0.0]]


def test_varied_steps_are_none_longer_than_the_default_and_follow_each_other(load: Load) -> None:
    fmu = load()
    calls = recorded(fmu)
    assert list(steps.variation(fmu)) == []
    taken = np.array([a[:2] for name, a in calls if name == "fmi2DoStep"])
    np.testing.assert_allclose(taken[1:, 0], np.cumsum(taken[:-1, 1]), rtol=0, atol=1e-12)
    assert taken[0, 0] == 0 and taken[:, 1].max() <= 0.1 and len(set(taken[:, 1])) > 3


def test_a_reset_is_compared_with_a_fresh_life_after_steps_with_other_inputs(load: Load, tmp_path: Path) -> None:
    fresh = tmp_path / "fresh"
    fresh.write_text(json.dumps([{"x": x, "count": k, "y": 1.5} for k, x in enumerate(fmu_after(load))]))
    fmu = load()
    calls = recorded(fmu)
    assert list(lifecycle.reset(fmu, "initialized", fresh)) == []
    assert [name for name, _ in calls].count("fmi2DoStep") == 10
    assert set_to(calls) == [(0, 0.625), (1, 3.375)]
    (found,) = lifecycle.reset(load("reset"), "initialized", fresh)
    assert found.subject == "x" and "after 0 steps, as from a fresh instance (it was initialized)" in found.expected


def fmu_after(load: Load) -> list[float]:
    """x after each step, as the FMU rounds it."""
    return [row["x"] for row in ended(lifecycle.life(load()))]


def test_a_second_instance_steps_between_the_steps_of_the_first(load: Load, tmp_path: Path) -> None:
    alone = tmp_path / "alone"
    alone.write_text(json.dumps([{"x": x, "count": k, "y": 1.5} for k, x in enumerate(fmu_after(load))]))
    fmu = load()
    calls = recorded(fmu)
    assert list(lifecycle.two_instances(fmu, alone)) == []
    assert [name for name, _ in calls].count("fmi2DoStep") == 12 and set_to(calls) == [(0, 0.625)]


def test_a_state_is_serialised_and_resumed_halfway(load: Load, tmp_path: Path) -> None:
    record = ended(states.serialize(load()))
    assert record["progress"]["steps"] == 4 and record["progress"]["time"] == 0.0
    np.testing.assert_allclose([row["x"] for row in record["rows"]], after(8)[4:], rtol=0, atol=1e-14)
    saved = tmp_path / "saved"
    saved.write_text(json.dumps(record))
    fmu = load()
    calls = recorded(fmu)
    assert list(states.resume(fmu, saved)) == []
    assert [a[0] for name, a in calls if name == "fmi2DoStep"] == [k * 0.1 for k in range(4, 8)]


def test_a_legal_call_that_is_refused_ends_the_probe_with_the_fmus_words(load: Load) -> None:
    fmu = load("legal-call")
    with pytest.raises(Broken) as broken:
        fmu.initialized(logging=True)
    assert (
        str(broken.value)
        == "legal-call [4.2.4] fmi2EnterInitializationMode: expected fmi2OK; found fmi2Error: not today after 0 steps"
    )
    instance = load().initialized()
    variable = instance.subject.variables[4]
    with pytest.raises(Broken, match=r"fmi2SetReal of limit = 2\.0: expected fmi2OK; found fmi2Error"):
        instance.set(variable, 2.0)


def test_a_pending_step_is_waited_for_until_it_ends_or_patience_does(load: Load) -> None:
    fmu = load("pending")
    with pytest.raises(
        Broken, match=r"legal-call .* fmi2DoStep: expected an end of fmi2Pending; found fmi2Pending for 0\.05 s"
    ):
        fmu.initialized().run(1)
    function, answers = fmu.function, iter([5, 5, 0])

    def answering(name: str, *more: Any) -> Any:
        if name != "fmi2GetStatus":
            return function(name, *more)

        def status(_: Any, kind: int, answer: Any) -> int:
            assert kind == 0  # fmi2DoStepStatus
            answer._obj.value = next(answers)
            return 0

        return status

    instance = fmu.initialized()
    fmu.function = answering  # type: ignore[method-assign]
    instance.run(1)
    assert next(answers, None) is None and instance.progress == Progress(0.0, 1)


def test_an_instance_that_gives_back_its_memory_has_none_left(load: Load) -> None:
    for defect, kept in (("none", 0), ("memory", 1)):
        instance = load(defect).initialized()
        assert len(instance.blocks) == 1 + kept
        instance.free()
        assert len(instance.blocks) == kept


def test_values_are_read_by_kind_and_an_unknown_one_is_named(load: Load) -> None:
    instance = load().initialized()
    everything = instance.read(instance.subject.variables)
    assert everything == {
        "u": 0.5,
        "gain": 3.0,
        "start": 1.0,
        "x": 1.0,
        "limit": 100.0,
        "y": 1.5,
        "count": 0,
        "mode": 1,
        "active": 1,
        "label": "label",
    }
    assert instance.call("fmi2GetReal", (c_uint * 1)(77), 1, (c_uint * 2)()) == 3
