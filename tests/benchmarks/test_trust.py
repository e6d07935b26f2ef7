"""The board counts what it says: streams, verdicts, and its command in a shortened form."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from advice.streams.corruptions import CLEAN, CORRUPTIONS, Corruption
from advice.streams.hindsight import explained
from advice.streams.native import sampled
from advice.streams.streams import Streams
from advice.streams.verdicts import Tried, judge, limits, run
from benchmarks.streams.catalogue import DUFFING_SCENARIO, ENTRIES
from benchmarks.streams.literature import MODELS
from observers.instance import Instance

OBSERVER = "duffing_ukf"


@pytest.fixture(scope="module")
def streams() -> Streams:
    return Streams(DUFFING_SCENARIO())


@pytest.fixture(scope="module")
def tried() -> Tried:
    component = ENTRIES[OBSERVER].make()
    return Tried(component, {}, sampled(component, DUFFING_SCENARIO().sample_time))


def test_there_are_twenty_corruptions_and_each_changes_the_stream(streams: Streams) -> None:
    clean = streams.stream(CLEAN, 0)
    assert len({c.name for c in CORRUPTIONS}) == 20
    for corruption in CORRUPTIONS:
        stream = streams.stream(corruption, 0)
        assert not np.array_equal(stream.measured["y"], clean.measured["y"], equal_nan=True), corruption.name


@pytest.mark.parametrize("corruption", [c for c in CORRUPTIONS if c.plant == ""], ids=lambda c: c.name)
def test_a_corrupted_sensor_is_clean_before_and_after(streams: Streams, corruption: Corruption) -> None:
    clean, stream = streams.stream(CLEAN, 1), streams.stream(corruption, 1)
    outside = np.ones(300, bool)
    outside[DUFFING_SCENARIO().during] = False
    np.testing.assert_array_equal(stream.measured["y"][outside], clean.measured["y"][outside])
    np.testing.assert_array_equal(stream.truth["x.x1"], clean.truth["x.x1"])


def test_a_compiled_observer_estimates_what_an_instance_does(streams: Streams, tried: Tried) -> None:
    stream = streams.stream(CLEAN, 0)
    record, instance = run(tried, stream), Instance(tried.component)
    for k in range(50):
        instance.set("y", stream.measured["y"][k])
        instance.step(instance.time, 0.1)
        error = instance.get("estimate.x1") - stream.truth["x.x1"][k + 1]
        assert record.errors[k, 0] == pytest.approx(error, abs=1e-14)


def test_an_observer_that_is_right_is_never_wrong_and_one_that_is_lied_to_is(streams: Streams, tried: Tried) -> None:
    limit, clean = limits(tried, streams, [0])
    assert clean.largest.max() < 0.2
    assert judge(tried, streams.stream(CLEAN, 0), limit).wrong == 0
    swapped = judge(tried, streams.stream(next(c for c in CORRUPTIONS if c.name == "sign"), 0), limit)
    assert swapped.wrong >= 50
    assert swapped.recovery is not None and swapped.recovery > 0


@pytest.mark.parametrize(("name", "expected"), [("clean", True), ("sign", True), ("noise", False), ("clipped", False)])
def test_hindsight_explains_what_another_motion_does_and_nothing_else(
    streams: Streams, name: str, expected: bool
) -> None:
    """The Duffing system upside down is one too; noise of five times the deviation is no motion."""
    stream = streams.stream(next(c for c in (CLEAN, *CORRUPTIONS) if c.name == name), 0)
    side = -1.0 if name == "sign" else 1.0
    guesses = {v: side * stream.truth[f"x.{v}"][1:] for v in ("x1", "x2", "theta")}
    asked = np.zeros(300, bool)
    asked[[145, 160]] = True  # 20 samples within what is corrupted
    np.testing.assert_array_equal(explained(stream, guesses, asked)[asked], expected)


@pytest.mark.parametrize("case", MODELS, ids=lambda case: case.model.name)
def test_the_literatures_models_stay_finite_and_within_their_bounds(case) -> None:
    stream = Streams(case.scenario()).stream(CLEAN, 0)
    for v in (*case.model.states, *case.model.unknown_parameters):
        truth = stream.truth[f"x.{v.name}"]
        assert np.isfinite(truth).all()
        assert v.min <= truth.min() and truth.max() <= v.max


def test_the_command_prints_a_line_for_each_observer_and_corruption() -> None:
    command = [sys.executable, "-m", "benchmarks.trust", "--observer", OBSERVER, "--corruption", "nan", "--seeds", "1"]
    printed = subprocess.run([*command, "--each"], capture_output=True, text=True, check=True).stdout
    lines = [line.split()[0] for line in printed.splitlines()]
    assert lines == ["observer", OBSERVER, "nan"]


def test_an_unknown_corruption_is_one_message() -> None:
    command = [sys.executable, "-m", "benchmarks.trust", "--corruption", "wrong"]
    found = subprocess.run(command, capture_output=True, text=True)
    assert found.returncode == 2
    assert "corruption 'wrong' is unknown; known: outlier" in found.stderr


@pytest.mark.long
@pytest.mark.parametrize("method", ["ukf", "riccati", "pseudospectral"])
def test_a_start_that_went_wrong_does_not_keep_the_noise_too_large(method: str) -> None:
    """The reactor that ignites, everything at its default: at first each filter is thrown off, and learns a noise of a thousand times."""
    entry = ENTRIES[f"igniting_reactor_{method}"]
    scenario, component = entry.scenario(), entry.make()
    tried = Tried(component, entry.parameters, sampled(component, scenario.sample_time))
    _, clean = limits(tried, Streams(scenario), range(3))
    assert clean.alarms < 0.02
