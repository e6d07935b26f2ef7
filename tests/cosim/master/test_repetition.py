"""Runs of FMUs that stay loaded: the same numbers as a run that loads them anew, and detours that leave no trace."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from cosim.errors import ExperimentError
from cosim.master import run
from cosim.master.repeated import Repeated
from cosim.master.repetition import Detour
from cosim.master.slave import RunError
from cosim.system import Element, System

Build = Callable[[str], Path]
STEPS, TS = 40, 0.1
VALID = "observer.measurement_valid.y"
INNOVATION = "observer.diagnostics.innovation"


@pytest.fixture(scope="module")
def repeated() -> Iterator[Repeated]:
    with Repeated() as made:
        yield made


@pytest.fixture
def system(built: Build) -> System:
    return System("moved", {"observer": Element(built("moved_riccati"))}, stop=STEPS * TS, step=TS)


def measured(seed: int = 0) -> dict[str, np.ndarray]:
    return {"observer.y": np.random.default_rng(seed).normal(size=STEPS + 1)}


def test_a_run_after_others_is_bit_for_bit_one_of_its_own(repeated: Repeated, system: System) -> None:
    kept = repeated.load(system, {"observer.guess.v": 0.5}, measured())
    for process_noise, steps in ((0.1, STEPS), (3.0, 15), (0.1, STEPS)):
        found = kept.run({"observer.tuning.process_noise.v": process_noise}, steps)
        values = {"observer.guess.v": 0.5, "observer.tuning.process_noise.v": process_noise}
        expected = run(system, overrides=values, inputs=measured())
        assert found.names == expected.names and len(found.time) == steps + 1
        np.testing.assert_array_equal(found.values, expected.values[: steps + 1])


def test_several_systems_stay_loaded_beside_each_other(repeated: Repeated, system: System) -> None:
    both = [repeated.load(system, {}, measured(seed)) for seed in (1, 2)]
    for _ in range(2):
        for seed, kept in zip((1, 2), both, strict=True):
            expected = run(system, inputs=measured(seed))
            np.testing.assert_array_equal(kept.run({}, STEPS).values, expected.values)


def test_a_detour_ends_where_a_run_with_its_inputs_would_and_leaves_no_trace(
    repeated: Repeated, system: System
) -> None:
    """From every 7th row on nothing is measured for six samples; the run's last, shorter part has no detour."""
    every = 7
    arrived = np.arange(STEPS + 1) % every == every - 1
    kept = repeated.load(system, {}, measured(), Detour(every, {VALID: arrived}))
    np.testing.assert_array_equal(kept.run({}, STEPS).values, run(system, inputs=measured()).values)
    ends = kept.ends(INNOVATION)
    assert len(ends) == STEPS // every
    for count, end in enumerate(ends):
        first = count * every
        valid = np.where((np.arange(STEPS + 1) >= first) & (np.arange(STEPS + 1) < first + every), arrived, 1)
        whole = run(system, inputs={**measured(), VALID: valid})
        assert end == whole[INNOVATION][first + every]


def test_a_value_that_a_variable_does_not_take_is_refused_and_the_next_run_goes_on(
    repeated: Repeated, system: System
) -> None:
    kept = repeated.load(system, {}, measured())
    with pytest.raises(ExperimentError, match=r"'tuning.process_noise.v' = -1.* lies outside"):
        kept.run({"observer.tuning.process_noise.v": -1.0}, STEPS)
    np.testing.assert_array_equal(kept.run({}, STEPS).values, run(system, inputs=measured()).values)


def test_after_the_process_has_ended_nothing_runs(system: System) -> None:
    with Repeated() as repeated:
        kept = repeated.load(system, {}, measured())
        repeated._child.kill()
        with pytest.raises(RunError, match="the process that keeps the FMUs has ended"):
            kept.run({}, STEPS)
