"""James & Baras' and Chen & Yen's examples through the built FMUs and the master: the reference errors, and the FMUs as binaries."""

import math
from collections.abc import Callable
from pathlib import Path

import fmpy.validation
import numpy as np
import pytest

from build_fmus import FMUS, SYSTEMS
from cosim.results import Result
from observers import chen_yen, james_baras
from observers.certificates import ANYWHERE, NONE
from observers.instance import Instance

OBSERVERS = ["james_baras_5_1_riccati", "james_baras_5_2_riccati", "chen_yen_least_squares"]
REFERENCES = {
    "james_baras_5_1": {1: 1.427, 2: 1.138, 5: 0.457, 10: 0.0429, 20: 1.09e-3},
    "james_baras_5_2": {1: 0.208, 2: 0.0414, 5: 1.62e-3, 10: 1.07e-5},  # published to one digit: 1e-5
    "james_baras_5_2_far": {1: 2.50, 2: 0.908, 5: 0.0447, 10: 3.0e-4},
    "chen_yen_short": {1: 5.77, 2: 7.13, 3: 3.26, 5: 1.05, 10: 0.0335, 20: 7.2e-6},
    "chen_yen_long": {1: 4.85, 2: 5.28, 3: 2.73, 5: 1.12, 10: 3.71e-3, 20: 5.0e-8},
}


def error(result: Result) -> np.ndarray:
    """|e| of the current estimate at the master's times."""
    states = [name.removeprefix("observer.estimate.") for name in result.names if "estimate." in name]
    return np.linalg.norm([result[f"observer.estimate.{s}"] - result[f"plant.x.{s}"] for s in states], axis=0)


@pytest.mark.parametrize("name", REFERENCES)
def test_the_errors_are_the_reference_errors_within_3_percent(example: Callable[..., Result], name: str) -> None:
    result = example(name)
    found = error(result)
    for time, expected in REFERENCES[name].items():
        row = int(np.argmin(np.abs(result.time - time)))
        assert found[row] == pytest.approx(expected, rel=0.03), (time, found[row])


@pytest.mark.parametrize("name", ["james_baras_5_2", "chen_yen_short"])
@pytest.mark.parametrize("parts", [2, 5])
def test_the_communication_step_does_not_change_the_estimates(
    example: Callable[..., Result], name: str, parts: int
) -> None:
    whole, cut = example(name), example(name, step=0.01 / parts)
    for state in ("x1", "x2"):
        gap = np.abs(cut[f"observer.estimate.{state}"][::parts] - whole[f"observer.estimate.{state}"])
        assert gap.max() <= 1e-11 * np.abs(whole[f"plant.x.{state}"]).max()


@pytest.mark.parametrize("name", REFERENCES)
def test_the_python_face_and_the_fmu_agree_over_a_whole_run(example: Callable[..., Result], name: str) -> None:
    result, recipe = example(name), SYSTEMS[name]
    observer = Instance(FMUS[recipe.fmus["observer"]][0](), recipe.parameters.get("observer", {}))
    sources = [(start, end.split(".")[1]) for start, end in recipe.connections if end.startswith("observer.")]
    names = [f"observer.{port.name}" for port in observer.component.outputs]
    for k in range(0, len(result.time) - 1):
        for source, name_in in sources:
            observer.set(name_in, result[source][k])
        observer.step(result.time[k], result.step)
        expected = np.array([result[output][k + 1] for output in names if output in result.names])
        found = [v for v, output in zip(observer.outputs(), names, strict=True) if output in result.names]
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-11)


def test_example_5_2_is_certified_and_example_5_1_is_not(example: Callable[..., Result]) -> None:
    assert set(example("james_baras_5_2_far")["observer.diagnostics.certified"]) == {ANYWHERE}
    assert set(example("james_baras_5_1")["observer.diagnostics.certified"]) == {NONE}


def test_chen_and_yens_own_example_converges_uncertified_at_a_quarter_of_a_second(
    example: Callable[..., Result],
) -> None:
    for name, certified in (("chen_yen_short", False), ("chen_yen_long", True)):
        factors = example(name)["observer.diagnostics.certified_contraction"]
        actual = example(name)["observer.diagnostics.contraction"]
        assert (factors.max() < 1) == certified
        assert np.all(actual <= factors * (1 + 1e-3))


def test_with_noise_of_0_1_every_0_05_s_the_rms_error_is_at_most_0_025(example: Callable[..., Result]) -> None:
    squares = []
    for seed in range(4):
        noisy = {
            "plant.sensor.noise_std": 0.1,
            "plant.sensor.sample_time": 0.05,
            "plant.sensor.seed": seed,
            "observer.sample_time": 0.05,
        }
        result = example("chen_yen_short", step=0.05, overrides=noisy)
        late = result.time >= 10
        squares += [
            np.mean((result[f"observer.estimate.{s}"] - result[f"plant.x.{s}"])[late] ** 2) for s in ("x1", "x2")
        ]
    assert math.sqrt(np.mean(squares)) <= 0.025


@pytest.mark.parametrize("name", [*OBSERVERS, "james_baras_5_1", "james_baras_5_2", "chen_yen"])
def test_fmpy_finds_nothing_wrong(catalogue: Path, name: str) -> None:
    assert fmpy.validation.validate_fmu(str(catalogue / "fmus" / f"{name}.fmu")) == []


@pytest.mark.parametrize("name", OBSERVERS)
def test_a_saved_state_resumes_bit_for_bit_and_nan_is_counted_and_logged(catalogue_slave: Callable, name: str) -> None:
    slave = catalogue_slave(name).initialize()
    rejected = (james_baras if "riccati" in name else chen_yen).CODE

    def advance(first: int, count: int) -> None:
        for k in range(first, first + count):
            slave.set("y", math.nan if k == 60 else math.sin(0.07 * k))
            slave.step(0.01 * k, 0.01)
            if k == 60:
                assert slave.get("diagnostics.status") == rejected.sample_rejected
                assert slave.get("diagnostics.rejected_samples") == 1

    advance(0, 40)
    saved = slave.fmu.getFMUState()
    advance(40, 60)
    once = slave.outputs()
    slave.fmu.setFMUState(saved)
    slave.fmu.freeFMUState(saved)
    advance(40, 60)
    assert slave.outputs() == once
    assert all(math.isfinite(value) for value in once.values())
    assert [text for _, category, text in slave.messages if category == "logStatusWarning" and "rejected" in text]


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [("tuning.p0", -1.0, "-1"), ("tuning.gamma", math.nan, "nan"), ("tuning.T", 0.0, "0")],
)
def test_a_tuning_out_of_range_is_refused_by_name(
    catalogue_slave: Callable, name: str, value: float, word: str
) -> None:
    slave = catalogue_slave("chen_yen_least_squares").initialize()
    before = slave.state()
    message = slave.refuses(lambda: slave.set(name, value))
    assert name in message and word in message
    assert slave.state() == before
