"""Filters whose innovations are watched: deviations that hold, outliers that do not act, a way back, bounds and angles."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.stats import chi2

from observers.bounds import projected
from observers.component import Component
from observers.instance import Instance
from observers.least_squares import least_squares
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral
from observers.riccati import riccati
from observers.status import CODE
from observers.ukf import ukf
from reference_models.chemostat import CHEMOSTAT
from reference_models.duffing import DUFFING
from reference_models.plant import plant
from reference_models.quadruple_tank import QUADRUPLE_TANK

TS = 0.1
A = np.array([[0.0, 1.0], [-2.0, -0.3]])
LINEAR = Model(
    name="linear",
    states=[Variable("p"), Variable("v")],
    outputs=[Variable("y")],
    ode=lambda x, u, p, t: [x.v, -2 * x.p - 0.3 * x.v],
    output=lambda x, u, p, t: [x.p],
)
NOISE = {"measurement_noise": {"y": 0.1}, "initial_std": {"p": 1.0, "v": 1.0}}
MOVING = {"process_noise": {"p": 0.02, "v": 0.1}}
RUNS, SAMPLES = 100, 40


def ends(component: Component, seed: int, q: np.ndarray, outliers: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Errors over their deviations, and errors, at the end of RUNS runs on the linear model, (RUNS, 2)."""
    rng, bad, F = np.random.default_rng(seed), np.random.default_rng(seed + 1), expm(A * TS)
    steps = 20
    fine = expm(A * TS / steps)
    ratios, errors = [], []
    for _ in range(RUNS):
        run, x = Instance(component), rng.normal(size=2)
        for k in range(SAMPLES):
            far = 2.0 * bad.choice([-1.0, 1.0]) * (bad.random() < outliers) * (k >= 4)  # once it has settled
            run.set("y", x[0] + 0.1 * rng.normal() + far)
            run.step(k * TS, TS)
            if not q.any():
                x = F @ x
                continue
            for _ in range(steps):
                x = fine @ x + q * math.sqrt(TS / steps) * rng.normal(size=2)
        error = np.array([run.get(f"estimate.{name}") for name in "pv"]) - x
        errors.append(error)
        ratios.append(error / [run.get(f"diagnostics.std.{name}") for name in "pv"])
    return np.array(ratios), np.array(errors)


CALIBRATED: dict[str, tuple[Callable[[], Component], np.ndarray]] = {
    "ukf": (lambda: ukf(LINEAR, sample_time=TS, **NOISE, **MOVING), np.array([0.02, 0.1])),
    "riccati": (lambda: riccati(LINEAR, sample_time=TS, **NOISE, **MOVING), np.array([0.02, 0.1])),
    "least_squares": (lambda: least_squares(LINEAR, sample_time=TS, T=1.5, **NOISE), np.zeros(2)),
}


@pytest.mark.parametrize("kind", CALIBRATED)
def test_the_deviations_cover_the_errors_as_a_normal_distribution_does(kind: str) -> None:
    """Each error over its deviation is standard normal: the sum of squares of RUNS runs is chi-square, the band is of 99.8 %."""
    make, q = CALIBRATED[kind]
    ratios, _ = ends(make(), 3, q)
    for column in ratios.T:
        assert chi2.ppf(1e-3, RUNS) < np.sum(column**2) < chi2.ppf(1 - 1e-3, RUNS), np.mean(column**2)
    assert 0.9 <= np.mean(np.abs(ratios) < 2) <= 0.99


@pytest.mark.parametrize("kind", CALIBRATED)
def test_outliers_in_three_samples_of_a_hundred_cost_next_to_nothing(kind: str) -> None:
    """Of 20 deviations of the noise; they act on the least of estimates."""
    make, q = CALIBRATED[kind]
    component = make()
    clean, hit = (np.sqrt(np.mean(ends(component, 5, q, part)[1] ** 2)) for part in (0.0, 0.03))
    assert hit < 1.15 * clean


def scaled(factor: float) -> Component:
    return riccati(LINEAR, sample_time=TS, N=0.1 * factor, R=0.05 * factor, Q0=factor**2)


def test_design_matrices_fix_the_gain_and_the_innovations_the_scale_of_the_deviations() -> None:
    rng = np.random.default_rng(1)
    runs = [Instance(scaled(factor)) for factor in (1.0, 5.0)]
    truth = Instance(plant(LINEAR), {"start.p": 1.0})
    for k in range(200):
        y = truth.get("y") + 0.1 * rng.normal()
        truth.step(k * TS, TS)
        for run in runs:
            run.set("y", y)
            run.step(k * TS, TS)
    for name in ("estimate.p", "estimate.v", "diagnostics.std.p", "diagnostics.std.v"):
        assert_allclose(runs[0].get(name), runs[1].get(name), rtol=1e-13)


def test_with_least_squares_paper_scaling_the_deviations_are_of_the_noise_found() -> None:
    rng, found = np.random.default_rng(2), []
    for gamma in (1.0, 100.0):
        run = Instance(least_squares(LINEAR, sample_time=TS, T=2.0, gamma=gamma, p0=1 / gamma))
        for k in range(300):
            run.set("y", 0.1 * rng.normal())
            run.step(k * TS, TS)
        found.append(run.get("diagnostics.std.p"))
    assert_allclose(found[0], found[1], rtol=0.5)  # of different noise
    assert 0.01 < found[0] < 0.1


KINDS: dict[str, Callable[[], Component]] = {
    "ukf": lambda: ukf(DUFFING, sample_time=TS, process_noise={"theta": 0.03}, measurement_noise={"y": 1e-3}),
    "riccati": lambda: riccati(DUFFING, sample_time=TS, N=np.diag([0.01, 0.01, 0.1]), R=1e-3),
    "riccati, large R": lambda: riccati(DUFFING, sample_time=TS, N=np.diag([0.1, 0.1, 0.1]), R=0.1),
    "least_squares": lambda: least_squares(DUFFING, sample_time=TS, T=2.0, linearise=True),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [20.0, 1e3, 1e6])
@pytest.mark.parametrize("count", [1, 15])
def test_no_absurd_samples_lock_it_out(kind: str, size: float, count: int) -> None:
    run, truth = Instance(KINDS[kind]()), Instance(plant(DUFFING))
    late, flagged = [], False
    for k in range(500):
        absurd = 200 <= k < 200 + count
        run.set("y", truth.get("y") + size * absurd)
        truth.step(k * TS, TS)
        run.step(k * TS, TS)
        assert np.isfinite(run.outputs()).all()
        error = max(abs(run.get(f"estimate.{name}") - truth.get(f"x.{name}")) for name in ("x1", "x2"))
        # A deviation beyond its limit is graver than an outlier, and hides it.
        flagged |= run.get("diagnostics.status") in (CODE.outlier, CODE.uncertain, CODE.inconsistent)
        assert error < 0.05 or k < 60 or k >= 200 or kind.startswith("least"), (k, error)
        if k >= 400:
            late.append(error)
    assert flagged and np.median(late) < 0.05, (np.median(late), run.get("diagnostics.restarts"))


@pytest.mark.parametrize("make", [ukf, riccati])
def test_estimates_stay_within_the_bounds(make: Callable[..., Component]) -> None:
    """Tanks that run nearly empty: the square root of a level below zero is none."""
    run = Instance(
        make(QUADRUPLE_TANK, sample_time=2.0, measurement_noise={v.name: 0.1 for v in QUADRUPLE_TANK.outputs})
    )
    rng = np.random.default_rng(0)
    for k in range(60):
        for v in QUADRUPLE_TANK.outputs:
            run.set(v.name, max(8.0 - 0.2 * k, 0.05) + 0.1 * rng.normal())
        for v in QUADRUPLE_TANK.inputs:
            run.set(v.name, 0.5)
        run.step(2.0 * k, 2.0)
        for v in (*QUADRUPLE_TANK.states, *QUADRUPLE_TANK.unknown_parameters):
            assert v.min <= run.get(f"estimate.{v.name}") <= v.max, (k, v.name)
        assert np.isfinite(run.outputs()).all()
    assert run.get("diagnostics.solver_failures") == 0


@pytest.mark.parametrize("make", [ukf, riccati, pseudospectral])
def test_the_estimate_before_the_first_sample_is_the_guess_however_near_a_bound(make: Callable[..., Component]) -> None:
    """The sigma points of a guess near a bound are cut there, and have another mean than the guess."""
    guess = {v.name: v.min + 0.1 * v.nominal for v in QUADRUPLE_TANK.states}
    run = Instance(make(QUADRUPLE_TANK, sample_time=2.0, guess=guess))
    assert {name: run.get(f"estimate.{name}") for name in guess} == guess
    for v in QUADRUPLE_TANK.outputs:
        run.set(v.name, math.nan)
    run.step(0.0, 2.0)
    assert {name: run.get(f"filtered.{name}") for name in guess} == guess


ANGLE = Model(
    name="heading",
    states=[Variable("phi", unit="rad"), Variable("w", unit="rad/s", start=0.5)],
    outputs=[Variable("y", unit="rad", wrap=2 * math.pi)],
    ode=lambda x, u, p, t: [x.w, 0],
    output=lambda x, u, p, t: [x.phi],
)


@pytest.mark.parametrize("kind", ["ukf", "riccati", "least_squares"])
def test_a_compass_in_half_a_turn_either_way_is_followed_through_many_turns(kind: str) -> None:
    noise = {"measurement_noise": {"y": 0.02}}
    moving = {"process_noise": {"phi": 0.01, "w": 0.05}}
    component = {
        "ukf": lambda: ukf(ANGLE, sample_time=TS, **noise, **moving),
        "riccati": lambda: riccati(ANGLE, sample_time=TS, **noise, **moving),
        "least_squares": lambda: least_squares(ANGLE, sample_time=TS, T=1.0, **noise),
    }[kind]()
    run, rng = Instance(component), np.random.default_rng(0)
    for k in range(300):
        angle = 0.3 + 1.7 * k * TS + 0.02 * rng.normal()
        run.set("y", math.atan2(math.sin(angle), math.cos(angle)))
        run.step(k * TS, TS)
        off = run.get("estimate.phi") - (0.3 + 1.7 * (k + 1) * TS)
        assert k < 60 or abs(off - 2 * math.pi * round(off / (2 * math.pi))) < 0.1
    assert run.get("estimate.phi") > 40 and run.get("diagnostics.trusted") == 1


@pytest.mark.parametrize(("L", "arrival", "quiet"), [(8, False, 20), (30, False, 31), (8, True, 60)])
def test_trust_returns_once_the_tests_have_been_quiet_for_long_enough(L: int, arrival: bool, quiet: int) -> None:
    """As trust.md says: for a window, 20 samples at least, with an arrival cost 60."""
    noises = NOISE if arrival else {"measurement_noise": NOISE["measurement_noise"]}
    component = pseudospectral(LINEAR, sample_time=TS, N=6 if L < 10 else 16, L=L, arrival_cost=arrival, **noises)
    rng, run, x, F, said = np.random.default_rng(4), Instance(component), np.array([1.0, 0.0]), expm(A * TS), []
    for k in range(200):
        run.set("y", x[0] + 0.1 * rng.normal() + (1.5 if 60 <= k < 66 else 0.0))
        run.step(k * TS, TS)
        said.append(run.get("diagnostics.status"))
        x = F @ x
    last = max(k for k, status in enumerate(said) if status == CODE.inconsistent)
    assert 60 <= last < 110
    assert set(said[last + 1 : last + quiet]) == {CODE.settling}
    assert said[last + quiet] in (CODE.estimating, CODE.outlier)


def test_a_constant_offset_and_a_slow_drift_are_found() -> None:
    """A sensor of the position of an oscillator that swings about 0."""
    for change in (lambda k: 0.5, lambda k: 0.01 * (k - 100)):
        run = Instance(ukf(LINEAR, sample_time=TS, **NOISE, process_noise={"p": 1e-3, "v": 1e-3}))
        truth = Instance(plant(LINEAR), {"start.p": 3.0, "sensor.noise_std": 0.1, "sensor.sample_time": TS})
        said = []
        for k in range(200):
            run.set("y", truth.get("y") + (change(k) if k >= 100 else 0.0))
            truth.step(k * TS, TS)
            run.step(k * TS, TS)
            said.append(run.get("diagnostics.trusted"))
        assert np.mean(said[20:100]) > 0.95 and np.mean(said[150:200]) < 0.2


@pytest.mark.parametrize("make", [ukf, riccati])
def test_innovations_of_a_wide_first_covariance_do_not_make_a_noise_that_nobody_gave_too_small(
    make: Callable[..., Component],
) -> None:
    """Next to the first covariance the first innovations are small; a scale taken from them is one that all later samples contradict."""
    component = make(LINEAR, sample_time=TS, initial_std={"p": 10.0, "v": 10.0}, process_noise={"p": 0.0, "v": 0.3})
    F = expm(A * TS)
    for seed in (1, 6, 10):
        rng, run, trusted = np.random.default_rng(seed), Instance(component), []
        x = rng.normal(size=2)
        for k in range(200):
            run.set("y", x[0] + 0.1 * rng.normal())
            run.step(k * TS, TS)
            trusted.append(run.get("diagnostics.trusted"))
            x = F @ x + [0.0, 0.3 * math.sqrt(TS) * rng.normal()]
        assert np.mean(trusted[60:]) > 0.98, seed


def test_bounds_do_not_hide_a_number_that_is_none() -> None:
    variables = [Variable("a", min=0.0, max=1.0), Variable("b")]
    x = ca.SX.sym("x", 2)
    function = ca.Function("f", [x], [projected(variables, x)])
    for given, expected in (([-1.0, -1.0], [0.0, -1.0]), ([2.0, 9.0], [1.0, 9.0]), ([0.25, 0.0], [0.25, 0.0])):
        assert_allclose(function(given).full().ravel(), expected, rtol=0, atol=0)
    assert math.isnan(float(function([math.nan, 0.0])[0]))


@pytest.mark.parametrize("make", [ukf, riccati])
def test_a_parameter_that_jumps_is_found_again_where_nobody_gave_a_noise(make: Callable[..., Component]) -> None:
    """A chemostat whose largest growth rate falls by a tenth at sample 100: each innovation that follows is small, and of one side."""
    (biomass,) = CHEMOSTAT.outputs
    model = replace(CHEMOSTAT, outputs=[replace(biomass, nominal=2.0)])
    component, found = make(model, sample_time=900.0, max_step=900.0), []
    for seed in range(10):
        rng, run = np.random.default_rng(seed), Instance(component)
        truth = Instance(plant(model, max_step=90.0), {"start.X": rng.uniform(2, 4), "start.S": rng.uniform(1, 3)})
        for k in range(150):
            if k % 20 == 0:
                dilution = rng.uniform(0.1, 0.3) / 3600
            if k == 100:
                truth.set("parameter.mu", 0.36 / 3600)
            for each in (run, truth):
                each.set("dilution", dilution)
            run.set("y", truth.get("y") + 0.05 * rng.normal())
            run.step(900.0 * k, 900.0)
            truth.step(900.0 * k, 900.0)
        found.append(run.get("estimate.mu") * 3600)
    errors = np.abs(np.array(found) - 0.36)
    assert np.median(errors) < 0.01
