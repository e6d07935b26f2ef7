"""A part of a step of the window on a linear model, with process noise and without: against the matrix exponential."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from moving_window import A, B, linear
from observers.pseudospectral import structure
from observers.pseudospectral.window import gauss_newton, process_noise, trajectory
from observers.pseudospectral.window.gauss_newton import Solve
from observers.pseudospectral.window.problem import known_terms

TS, L, SEGMENTS, DAMPING = 0.1, 4, 2, 0.3
M = L // SEGMENTS
STD = np.array([0.2, 0.5, 0.8])  # of the noise on the rates of x1 and x2, and of the jumps of d
WEIGHT = 4.0


def window(noisy: bool) -> Solve:
    """A settable damping, and the unknown d, are rates that the window solves for."""
    model = linear(damping=DAMPING, disturbed=True)
    which = ((0, 1), (0,)) if noisy else ((), ())
    problem = structure.problem(model, model.equations, 8, L, SEGMENTS, TS, "samples", which)
    return Solve(problem, structure.constraints(model, problem, False))


def along(s: np.ndarray, noise: np.ndarray, u: np.ndarray, times: np.ndarray, segment: int) -> np.ndarray:
    """The states at `times` since the start of a segment, and the d of it, by the matrix exponential: (times, 4)."""
    x, d = s[:3], s[3]
    for j in range(segment + 1):
        w1, w2, jump = noise[3 * j : 3 * j + 3] * STD if len(noise) else np.zeros(3)
        found = []
        for time in times if j == segment else [M * TS]:
            here = np.append(x, 1.0)
            for i in range(M):
                rate = B * u[j * M + i] + [w1, w2 + d, 0.0]
                h = min(max(time - i * TS, 0.0), TS)
                here = expm(np.block([[A, rate[:, None]], [np.zeros((1, 4))]]) * h) @ here
            found.append(here[:3])
        x, d, own = found[-1], d + jump, d
    return np.column_stack([found, np.full(len(found), own)])


def outputs(s: np.ndarray, noise: np.ndarray, u: np.ndarray) -> np.ndarray:
    samples = [along(s, noise, u, np.arange(j > 0, M + 1) * TS, j) for j in range(SEGMENTS)]
    x = np.vstack(samples)
    return np.column_stack([x[:, 0], x[:, 0] + 0.5 * x[:, 2] + 0.2 * np.append(u, u[-1])]).ravel()


@pytest.mark.parametrize("noisy", [True, False], ids=["process noise", "exact"])
@pytest.mark.parametrize("length", [1.0, 0.5, 0.25])
def test_a_part_of_a_step_leaves_the_rates_of_the_trajectory_that_it_leads_to(length: float, noisy: bool) -> None:
    """A linear model's rates are right after one step from anywhere, and the cost and the size are those of the whole step."""
    solve, rng = window(noisy), np.random.default_rng(0)
    problem = solve.problem
    newton = (process_noise if noisy else gauss_newton).newton_step(solve)
    u, y = np.repeat(rng.normal(size=SEGMENTS), M), rng.normal(size=2 * (L + 1))
    given = {
        "data": known_terms(problem)(0.0, u, np.append(u, u[-1]), DAMPING),
        "p": DAMPING,
        "y": y,
        "w": np.full(y.size, WEIGHT),
        "lam": 0.0,
        "active": np.ones(SEGMENTS),
        "at": trajectory.sample_rows(problem)(L),
        "noise_std": np.tile(STD, SEGMENTS),
    }
    fixed = [given[name] for name in solve.given]
    V, s, noise = (rng.normal(size=newton.numel_in(i)) for i in (0, 2, 3))
    V_now, _, s_now, noise_now, *_ = (part.full().ravel() for part in newton(V, [], s, noise, length, *fixed))
    V_whole, _, s_whole, noise_whole, size, cost, *_ = (
        part.full().ravel() for part in newton(V, [], s, noise, 1.0, *fixed)
    )
    np.testing.assert_allclose(s_now, s + length * (s_whole - s), rtol=0, atol=1e-15)
    np.testing.assert_allclose(noise_now, noise + length * (noise_whole - noise), rtol=0, atol=1e-15)
    nodes = problem.segment.node_times[1:]
    rates = [along(s_now, noise_now, u, nodes, j) @ [0, -DAMPING, 0, 1] for j in range(SEGMENTS)]
    np.testing.assert_allclose(V_now, np.concatenate(rates), rtol=0, atol=7e-14)
    squares = WEIGHT * np.sum((outputs(s_whole, noise_whole, u) - y) ** 2)
    np.testing.assert_allclose(cost, squares, rtol=1e-13)
    # |step|^2 in units of the nominal values, of the noise's deviations, and of the rates that half a segment makes of a nominal value.
    moved = [s_whole - s, noise_whole - noise, (V_whole - V) * M * TS / 2]
    np.testing.assert_allclose(size, sum(part @ part for part in moved), rtol=1e-13)
