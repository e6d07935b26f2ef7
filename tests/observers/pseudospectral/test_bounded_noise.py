"""Bounded noise, section 3.4: the tube and Problem 3 against a plain window, the truth, and their own counters."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from build_fmus import FMUS
from cosim.master import run
from cosim.results import Result
from moving_window import NONLINEAR
from observers.instance import Instance
from observers.model import Model, ModelError, Variable
from observers.pseudospectral import bounded_noise, pseudospectral
from observers.status import CODE
from reference_models.duffing import DUFFING_KNOWN
from reference_models.plant import plant

SEEDS = range(10)
LONG = dict(sample_time=0.1, N=13, L=50, segments=5, guess={"x1": 0.0, "x2": 0.0})


@pytest.fixture(scope="module")
def ten_runs(catalogue_system: Callable[[str], Path]) -> Callable[[str], list[Result]]:
    """The paper's Example 4 with ten seeds of the noise, by the kind of observer."""

    @cache
    def runs(kind: str) -> list[Result]:
        system = catalogue_system(f"gong_example_4_{kind}")
        return [run(system, overrides={"plant.sensor.seed": seed}) for seed in SEEDS]

    return runs


def true_output(result: Result) -> np.ndarray:
    return (result["plant.x.x1"] + 0.5 * result["plant.x.x2"])[:-1]


def settled_rms(result: Result) -> float:
    """Of the output error at the sample instants after 15 s."""
    found = (result["observer.filtered.x1"] + 0.5 * result["observer.filtered.x2"])[1:]
    return float(np.sqrt(np.mean((found - true_output(result))[result.time[:-1] >= 15] ** 2)))


@pytest.mark.long
def test_example_4_with_the_tube_takes_nine_tenths_of_the_noise_away_and_is_never_worse_than_without(ten_runs) -> None:
    """Noise of 0.577 rms."""
    plain, tube = ([settled_rms(result) for result in ten_runs(kind)] for kind in ("plain", "tube"))
    assert np.median(tube) <= 0.06, tube
    assert all(with_it <= without for with_it, without in zip(tube, plain, strict=True)), (tube, plain)
    assert np.median(plain) <= 0.16 and np.sum(np.array(plain) <= 0.16) >= 9, plain


@pytest.mark.long
def test_example_4s_bounds_hold_the_true_output_but_for_a_thousandth_of_the_steps(ten_runs) -> None:
    """Bounds of a sample, in force as long as it is in the window; the margin is what that takes."""
    outside, samples = 0, 0
    for result in ten_runs("tube"):
        true = true_output(result)
        low, high = (result[f"observer.diagnostics.{which}"][1:] for which in ("lower", "upper"))
        assert np.all(low < high)
        outside += int(np.sum((true < low) | (true > high)))
        samples += len(true)
    assert samples == 6000 and outside < 0.001 * samples


@pytest.mark.long
def test_example_4s_counters_are_consistent_and_bounds_never_wider_than_the_noise(ten_runs) -> None:
    for result in ten_runs("tube"):
        refined, fallbacks = (result[f"observer.diagnostics.{n}"] for n in ("refined_bounds", "bound_fallbacks"))
        made = np.diff(refined) + np.diff(fallbacks)
        assert np.all(np.diff(refined) >= 0) and np.all(np.diff(fallbacks) >= 0)
        assert made.max() <= 2  # a sample's own, and once more if all have to start again
        assert refined[-1] > 500 and fallbacks[-1] < 30
        low, high = (result[f"observer.diagnostics.{which}"][1:] for which in ("lower", "upper"))
        y = result["plant.y"][:-1]
        assert np.all(low >= y - 1 - 1e-12) and np.all(high <= y + 1 + 1e-12)
        assert np.median((high - low)[150:]) < 1  # of 2 without Problem 3
        assert np.isfinite(result.values).all()


def noisy(samples: int, bound: float = 1.0, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Measured and true outputs of Example 4's plant."""
    sensor = {"sensor.noise_bound": bound, "sensor.sample_time": 0.1, "sensor.seed": seed}
    p = Instance(plant(DUFFING_KNOWN), {"start.x1": 1.0, "start.x2": 2.0, **sensor})
    rows = []
    for k in range(samples):
        rows.append((p.get("y"), p.get("x.x1") + 0.5 * p.get("x.x2")))
        p.step(0.1 * k, 0.1)
    y, true = np.array(rows).T
    return y, true


def followed(component, y, parameters=None):
    """Output estimates, bounds and statuses at every sample, and the instance."""
    observer, rows = Instance(component, parameters or {}), []
    for k, value in enumerate(y):
        observer.set("y", value)
        observer.step(0.1 * k, 0.1)
        rows.append(
            [
                observer.get("filtered.x1") + 0.5 * observer.get("filtered.x2"),
                observer.get("diagnostics.lower"),
                observer.get("diagnostics.upper"),
                observer.get("diagnostics.status"),
            ]
        )
    return np.array(rows), observer


def test_with_a_huge_margin_the_tube_is_the_noises_bound_around_every_sample() -> None:
    y, _ = noisy(80)
    rows, observer = followed(pseudospectral(DUFFING_KNOWN, **LONG, noise_bound=1.0), y, {"tuning.bound_margin": 1e9})
    np.testing.assert_allclose(rows[:, 1], y - 1, rtol=0, atol=1e-12)
    np.testing.assert_allclose(rows[:, 2], y + 1, rtol=0, atol=1e-12)
    assert observer.get("diagnostics.constraint_violation") < 1e-6


def test_the_estimated_output_lies_in_the_tube_and_the_tube_around_the_true_one() -> None:
    """The short form of Example 4's claims: noise of 0.577 rms, a tube 2 wide without Problem 3."""
    y, true = noisy(120)
    rows, observer = followed(pseudospectral(DUFFING_KNOWN, **LONG, noise_bound=1.0), y)
    solved = np.isin(rows[:, 3], [CODE.estimating, CODE.uncertain])
    assert solved.sum() > 60
    inside = (rows[:, 0] >= rows[:, 1] - 1e-5) & (rows[:, 0] <= rows[:, 2] + 1e-5)
    assert inside[solved].all()
    assert observer.get("diagnostics.constraint_violation") < 1e-6
    assert np.all((rows[:, 1] <= true) & (true <= rows[:, 2]))
    assert np.median((rows[:, 2] - rows[:, 1])[60:]) < 0.5
    assert np.sqrt(np.mean((rows[:, 0] - true)[60:] ** 2)) < 0.15


def test_a_noise_bound_that_is_too_small_is_said_and_survived() -> None:
    """Half the noise's: the samples contradict each other."""
    y, _ = noisy(150)
    rows, observer = followed(pseudospectral(DUFFING_KNOWN, **LONG, noise_bound=0.5), y)
    assert np.isfinite(observer.outputs()).all()
    assert np.sum(rows[:, 3] == CODE.inconsistent) > 30
    assert observer.get("diagnostics.bound_fallbacks") > 10


def test_samples_that_are_missing_bound_nothing() -> None:
    y, true = noisy(200)
    y[np.random.default_rng(5).random(200) < 0.2] = np.nan
    y[100:110] = np.nan
    rows, observer = followed(pseudospectral(DUFFING_KNOWN, **LONG, noise_bound=1.0), y)
    assert np.isfinite(observer.outputs()).all()
    assert observer.get("diagnostics.rejected_samples") == np.isnan(y).sum()
    assert np.all(rows[np.isnan(y), 3] >= CODE.sample_rejected)  # or what is graver
    present = ~np.isnan(y)
    assert np.all((rows[:, 1] <= true) & (true <= rows[:, 2]) | ~present)
    assert np.sqrt(np.mean((rows[:, 0] - true)[100:] ** 2)) < 0.25


TWO_OUTPUTS = Model(
    name="two_outputs",
    states=[Variable("x1", start=1.0), Variable("x2", start=0.5)],
    outputs=[Variable("y1"), Variable("y2", nominal=2.0)],
    ode=lambda x, u, p, t: [x.x2, -ca.sin(x.x1) - 0.05 * x.x2],
    output=lambda x, u, p, t: [x.x1, x.x2 + 0.2 * x.x1**2],
)


@pytest.mark.parametrize(("segments", "N"), [(1, 14), (4, 7)])
def test_two_outputs_have_a_tube_each(segments: int, N: int) -> None:
    bounds = {"y1": 0.3, "y2": 0.6}
    costs = {}
    for given in (None, bounds):
        observer = Instance(
            pseudospectral(TWO_OUTPUTS, sample_time=0.1, N=N, L=20, segments=segments, noise_bound=given)
        )
        p, rng, errors = Instance(plant(TWO_OUTPUTS)), np.random.default_rng(3), []
        for k in range(120):
            true = np.array([p.get("y1"), p.get("y2")])
            for i, (name, bound) in enumerate(bounds.items()):
                observer.set(name, true[i] + rng.choice([-1, 1]) * bound * rng.uniform(0.5, 1))
            p.step(0.1 * k, 0.1)
            observer.step(0.1 * k, 0.1)
            errors.append(observer.get("filtered.x1") - true[0])
            if given and k > 3:
                for i in (0, 1):
                    low, high = (observer.get(f"diagnostics.{which}[{i + 1}]") for which in ("lower", "upper"))
                    assert low <= true[i] <= high and high - low <= 2 * bounds[f"y{i + 1}"] + 1e-12
        costs[given is not None] = np.sqrt(np.mean(np.square(errors[40:])))
        assert observer.get("diagnostics.solver_failures") == 0
    assert observer.get("diagnostics.refined_bounds") > 200  # of two a sample
    assert costs[True] < costs[False]


def test_one_number_bounds_every_output_and_is_a_tuning_parameter_of_each() -> None:
    made = {port.name: port for port in pseudospectral(NONLINEAR, sample_time=0.1, noise_bound=0.2).parameters}
    assert made["tuning.noise_bound[1]"].start == made["tuning.noise_bound[2]"].start == 0.2


@pytest.mark.parametrize(
    ("bound", "message"),
    [
        (0.0, r"noise_bound of 'y1' = 0 must be positive"),
        (-1.0, r"noise_bound of 'y1' = -1 must be positive"),
        (float("nan"), r"noise_bound of 'y1' = nan must be positive"),
        ({"y1": 1.0}, r"noise_bound of 'y2'; the outputs are y1, y2"),
        ({"y1": 1.0, "y2": 1.0, "x1": 1.0}, r"noise_bound of 'x1'; the outputs are y1, y2"),
    ],
)
def test_noise_bounds_that_are_none_are_refused(bound: object, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        pseudospectral(TWO_OUTPUTS, sample_time=0.1, noise_bound=bound)  # type: ignore[arg-type]


def test_the_fmu_with_a_tube_is_the_python_face(catalogue_slave: Callable) -> None:
    name = "duffing_known_pseudospectral_tube"
    fmu, face = catalogue_slave(name).initialize(), Instance(FMUS[name][0]())
    y, _ = noisy(90)
    y[70] = np.nan
    names = [port.name for port in face.component.outputs]
    for k, value in enumerate(y):
        for one in (fmu, face):
            one.set("y", value)
            one.step(0.1 * k, 0.1)
        np.testing.assert_allclose([fmu.get(n) for n in names], face.outputs(), rtol=0, atol=1e-8)


def test_the_tube_has_a_bound_for_each_output_and_a_margin_of_five_thousandths() -> None:
    made = bounded_noise.ports_of(NONLINEAR, {"y1": 0.1, "y2": 0.3})
    assert {port.name: (port.start, port.min) for port in made.tuning} == {
        "tuning.noise_bound[1]": (0.1, 0.0),
        "tuning.noise_bound[2]": (0.3, 0.0),
        "tuning.bound_margin": (5e-3, 0.0),
    }
