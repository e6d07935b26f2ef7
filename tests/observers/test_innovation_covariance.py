"""The covariance that filters believe their innovations to have, against the textbook's Kalman filter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from observers.instance import Instance
from observers.least_squares import least_squares
from observers.model import Model, Variable
from observers.riccati import riccati
from observers.ukf import ukf

TS = 0.1
A = np.array([[0.0, 1.0], [-2.0, -0.3]])
C = np.array([[1.0, 0.2], [0.4, -1.0]])
TWO = Model(
    name="two",
    states=[Variable("a"), Variable("b")],
    outputs=[Variable("p", unit="m"), Variable("q", unit="m/s")],
    ode=lambda x, u, p, t: [x.b, -2 * x.a - 0.3 * x.b],
    output=lambda x, u, p, t: [x.a + 0.2 * x.b, 0.4 * x.a - x.b],
)
R, P0, W = np.diag([0.2, 0.5]) ** 2, np.diag([1.0, 2.0]) ** 2, np.diag([0.1, 0.3]) ** 2
KNOWN = {"measurement_noise": {"p": 0.2, "q": 0.5}, "initial_std": {"a": 1.0, "b": 2.0}}
MOVING = {"process_noise": {"a": 0.1, "b": 0.3}}
MADE = {
    "ukf": lambda known: ukf(TWO, sample_time=TS, **MOVING, **known),
    "riccati": lambda known: riccati(TWO, sample_time=TS, **MOVING, **known),
    "least_squares": lambda known: least_squares(TWO, sample_time=TS, T=100.0, **known),
}


def covariances(kind: str, samples: int) -> list[np.ndarray]:
    """S of each sample: P moves by expm(A Ts) and takes the process noise in, of the unscented filter at the sample."""
    F = expm(A * TS)
    M = expm(np.block([[-A, W], [np.zeros((2, 2)), A.T]]) * TS)
    added = {"ukf": W * TS, "riccati": M[2:, 2:].T @ M[:2, 2:], "least_squares": np.zeros((2, 2))}[kind]
    P = P0 + (added if kind == "ukf" else 0)
    found = []
    for _ in range(samples):
        S = C @ P @ C.T + R
        found.append(S)
        K = P @ C.T @ np.linalg.inv(S)
        P = F @ (P - K @ C @ P) @ F.T + added
    return found


def shown(run: Instance) -> np.ndarray:
    std = np.array([run.get("diagnostics.innovation_std.p"), run.get("diagnostics.innovation_std.q")])
    r = run.get("diagnostics.innovation_correlation[2,1]")
    return np.outer(std, std) * np.array([[1, r], [r, 1]])


@pytest.mark.parametrize("kind", ["ukf", "riccati"])
def test_the_innovations_covariance_is_the_kalman_filters(kind: str) -> None:
    run, rng = Instance(MADE[kind](KNOWN)), np.random.default_rng(3)
    for k, expected in enumerate(covariances(kind, 12)):
        for name in "pq":
            run.set(name, rng.normal())
        run.step(k * TS, TS)
        np.testing.assert_allclose(shown(run), expected, rtol=1e-9)


def test_of_least_squares_the_first_one_is_the_guesss_and_the_noises() -> None:
    """Later ones are of a sample that had half a weight at the start: docs/least_squares.md."""
    run = Instance(MADE["least_squares"](KNOWN))
    run.step(0.0, TS)
    np.testing.assert_allclose(shown(run), covariances("least_squares", 1)[0], rtol=1e-12)


@pytest.mark.parametrize("kind", MADE)
def test_it_is_what_the_tuning_says_whatever_scale_the_filter_learned(kind: str) -> None:
    """Samples a hundred times as far off as the noise lets a filter that is not told the noise show larger deviations, not a larger S."""
    loud, quiet = ({**KNOWN, "measurement_noise": None}, {**KNOWN, "measurement_noise": {"p": 0.1, "q": 0.1}})
    runs = [Instance(MADE[kind](known), {"tuning.gate": 1e15}) for known in (loud, quiet)]
    rng = np.random.default_rng(4)
    for k in range(40):
        for name in "pq":
            y = 30 * rng.normal()
            for run in runs:
                run.set(name, y)
        for run in runs:
            run.step(k * TS, TS)
    np.testing.assert_allclose(shown(runs[0]), shown(runs[1]), rtol=1e-12)
    assert runs[0].get("diagnostics.std.a") > 10 * runs[1].get("diagnostics.std.a")
