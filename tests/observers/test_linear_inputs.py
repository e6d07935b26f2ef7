"""Known inputs that a model declares linear between samples move its observers' estimates as a line does, not as a held value.

The truth here is a Kalman filter whose motion from sample to sample is exact for the line: `scipy.linalg.expm` of the model with the inputs
and their slopes as states.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from observers.component import Component
from observers.instance import Instance
from observers.least_squares import least_squares
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral
from observers.riccati import riccati
from observers.ukf import ukf

TS, SAMPLES, NOISE, SPREAD = 0.1, 40, 0.05, {"x1": 0.7, "x2": 1.5}
A, B = np.array([[0.0, 1.0], [-9.0, -0.4]]), np.array([0.0, 5.0])
MODEL = Model(
    name="driven",
    states=[Variable("x1"), Variable("x2")],
    inputs=[Variable("u")],
    parameters=[Variable("stiffness", start=9.0)],
    outputs=[Variable("y")],
    input_between_samples="linear",
    ode=lambda x, u, p, t: [x.x2, -p.stiffness * x.x1 - 0.4 * x.x2 + 5 * u.u],
    output=lambda x, u, p, t: [x.x1],
)
NOISES = {"measurement_noise": {"y": NOISE}, "initial_std": SPREAD, "process_noise": {"x1": 0.0, "x2": 0.0}}
MADE: dict[str, Callable[[Model], Component]] = {
    "ukf": lambda model: ukf(model, sample_time=TS, **NOISES),
    "riccati": lambda model: riccati(model, sample_time=TS, **NOISES),
    "pseudospectral": lambda model: pseudospectral(
        model, sample_time=TS, N=6, L=8, segments=8, arrival_cost=True, **NOISES
    ),
}


def motion(h: float, stiffness: float = 9.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x after h = F x + g0 u(0) + g1 u(h)."""
    whole = np.zeros((4, 4))
    whole[:2, :2], whole[:2, 2] = [[0.0, 1.0], [-stiffness, -0.4]], B
    whole[2, 3] = 1.0  # the input's slope
    phi = expm(whole * h)
    return phi[:2, :2], phi[:2, 2] - phi[:2, 3] / h, phi[:2, 3] / h


def stream(seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Inputs that change much from sample to sample, and measurements."""
    rng = np.random.default_rng(seed)
    u, x, y = rng.uniform(-1, 1, SAMPLES), np.array([0.4, -0.8]), []
    F, g0, g1 = motion(TS)
    for k in range(SAMPLES):
        y.append(x[0] + NOISE * rng.standard_normal())
        if k + 1 < SAMPLES:
            x = F @ x + g0 * u[k] + g1 * u[k + 1]
    return u, np.array(y)


def kalman(u: np.ndarray, y: np.ndarray, stiffness: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Estimates after each sample, (n, 2), and innovations, (n,)."""
    x, P = np.zeros(2), np.diag([v**2 for v in SPREAD.values()])
    filtered, innovations = [], []
    for k in range(len(y)):
        if k:
            F, g0, g1 = motion(TS, 9.0 if stiffness is None else stiffness[k - 1])
            x, P = F @ x + g0 * u[k - 1] + g1 * u[k], F @ P @ F.T
        innovations.append(y[k] - x[0])
        K = P[:, 0] / (P[0, 0] + NOISE**2)
        x, P = x + K * innovations[-1], P - np.outer(K, P[0])
        filtered.append(x)
    return np.array(filtered), np.array(innovations)


def observed(component: Component, u: np.ndarray, y: np.ndarray, change: dict[int, float] | None = None) -> np.ndarray:
    """Filtered states and innovation at each sample, (n, 3)."""
    run = Instance(component)
    rows = []
    for k in range(len(y)):
        run.set("y", y[k])
        run.set("u", u[k])
        if change and k in change:
            run.set("parameter.stiffness", change[k])
        run.step(k * TS, TS)
        rows.append([run.get("filtered.x1"), run.get("filtered.x2"), run.get("diagnostics.innovation")])
    return np.array(rows)


@pytest.mark.parametrize("kind", MADE)
def test_estimates_are_those_of_the_kalman_filter_whose_motion_is_exact_for_the_line(kind: str) -> None:
    u, y = stream()
    found = observed(MADE[kind](MODEL), u, y)
    filtered, innovations = kalman(u, y)
    first = 2 if kind == "pseudospectral" else 0  # before, its window determines nothing
    np.testing.assert_allclose(found[first:, :2], filtered[first:], rtol=0, atol=5e-5)
    np.testing.assert_allclose(found[first:, 2], innovations[first:], rtol=0, atol=5e-5)
    held = observed(MADE[kind](replace(MODEL, input_between_samples="held")), u, y)
    assert np.max(np.abs(held[20:, 2] - innovations[20:])) > 0.02  # what the declaration is for


def test_least_squares_finds_the_state_behind_a_line() -> None:
    """Without noise the innovation of each sample is 0, to what the motion's order leaves."""
    rng = np.random.default_rng(5)
    u, x, y = rng.uniform(-1, 1, 400), np.array([0.4, -0.8]), []
    F, g0, g1 = motion(TS)
    for k in range(400):
        y.append(x[0])
        x = F @ x + g0 * u[k] + g1 * u[min(k + 1, 399)]
    found = observed(least_squares(MODEL, sample_time=TS, T=1.0), u, np.array(y))
    assert np.max(np.abs(found[300:, 2])) < 2e-5


@pytest.mark.parametrize("kind", ["ukf", "riccati"])
def test_a_parameter_acts_from_the_sample_on_at_which_it_is_set(kind: str) -> None:
    u, y = stream()
    stiffness = np.where(np.arange(SAMPLES) < 20, 9.0, 12.0)
    found = observed(MADE[kind](MODEL), u, y, {20: 12.0})
    filtered, innovations = kalman(u, y, stiffness)
    np.testing.assert_allclose(found[:, :2], filtered, rtol=0, atol=5e-5)
    np.testing.assert_allclose(found[:, 2], innovations, rtol=0, atol=5e-5)


@pytest.mark.parametrize("kind", ["ukf", "riccati"])
def test_an_input_that_is_no_number_for_a_sample_ends_nothing_and_is_forgotten(kind: str) -> None:
    u, y = stream()
    gap = np.where(np.arange(SAMPLES) == 12, np.nan, u)
    found, filtered = observed(MADE[kind](MODEL), gap, y), kalman(u, y)[0]
    assert np.isfinite(found).all()
    deviation = np.abs(found[:, :2] - filtered)
    assert np.max(deviation[:12]) < 5e-5
    assert np.max(deviation[-1]) < 0.1


def test_steps_shorter_than_the_sample_time_change_nothing_at_the_samples() -> None:
    u, y = stream()
    component = MADE["ukf"](MODEL)
    run, found = Instance(component), []
    for k in range(SAMPLES):
        run.set("y", y[k])
        run.set("u", u[k])
        for part in range(4):
            run.step(k * TS + part * TS / 4, TS / 4)
        found.append([run.get("filtered.x1"), run.get("filtered.x2")])
    np.testing.assert_allclose(found, observed(component, u, y)[:, :2], rtol=0, atol=1e-12)


def test_a_model_without_known_inputs_or_with_held_ones_is_as_it_was() -> None:
    held = replace(MODEL, input_between_samples="held")
    free = replace(MODEL, inputs=[], ode=lambda x, u, p, t: [x.x2, -p.stiffness * x.x1])
    assert ukf(free, sample_time=TS).n_z == ukf(held, sample_time=TS).n_z < ukf(MODEL, sample_time=TS).n_z / 2
