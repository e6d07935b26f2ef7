"""The ends of a window: where (8) leaves the controls free at both ends its solution has layers of 6 ms, thinner than a sample.

The first elementary problem of section 5.2 at iteration 1, against its two-point boundary value problem by scipy: with e = xi - y and a
costate l, e' = d + g l, l' = q e, l = 0 at both ends; d is what the references are off by, g = 1 / r1 + 1 / r2, sqrt(q g) = 173 1/s.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_bvp, solve_ivp

from observers.elementary.iteration import elementary_solution
from observers.elementary.problems import decompose
from reference_models.van_der_pol import VAN_DER_POL

T, Q, R = 10.0, 10.0, (1e-3, 5e-4)
G = sum(1 / r for r in R)


@cache
def motions() -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """x(t) of (4), (5) with v of (11), and of the paper's first trajectories."""

    def rates(t: float, x: np.ndarray, v: float, part: float) -> list[float]:
        return [x[1] + np.sin(t) + v, (-9 * x[0] + 0.1 * np.sin(t) * (1 - x[0] ** 2) * x[1]) / part]

    how: dict[str, Any] = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-12, "dense_output": True}
    true = solve_ivp(lambda t, x: rates(t, x, external(t), 1), (0, T), [0.5, -0.3], **how).sol
    return true, solve_ivp(lambda t, x: rates(t, x, 0, 0.5), (0, T), [0.5, 0.0], **how).sol


def external(t: Any) -> Any:
    return 0.5 * np.clip(t - 1, 0, 1)


@cache
def continuous() -> Callable[[Any], Any]:
    """(e, l) (t) of the boundary value problem."""
    true, guess = motions()
    near = np.geomspace(1e-4, 0.2, 60)
    mesh = np.unique(np.concatenate([np.linspace(0, T, 401), near, T - near]))
    found = solve_bvp(
        lambda t, z: np.array([guess(t)[1] - true(t)[1] - external(t) + G * z[1], Q * z[0]]),
        lambda a, b: np.array([a[1], b[1]]),
        mesh,
        np.zeros((2, mesh.size)),
        tol=1e-8,
        max_nodes=20000,
    )
    assert found.status == 0
    return found.sol


def gaps(s: float) -> tuple[np.ndarray, np.ndarray]:
    """How far the problem's solution on samples `s` apart is from it: xi at the samples, x2 against its mean over each interval."""
    true, guess = motions()
    N = round(T / s) + 1
    t = s * np.arange(N)
    x, fine = true(t), t[:-1, None] + s * np.linspace(0, 1, 41)
    X, u = np.vstack([x[0], guess(t)[1]]), np.vstack([np.sin(t), 0.1 * np.sin(t)])
    rate = np.trapezoid((guess(fine.ravel())[1] + np.sin(fine.ravel())).reshape(fine.shape), dx=1 / 40, axis=1)
    data: list[Any] = [
        X,
        np.zeros((1, N - 1)),
        x[:1],
        np.ones((1, N)),
        u[:, :-1],
        u[:, 1:],
        u,
        np.ones((1, N - 1)),
        T,
        s,
        [],
    ]
    first = decompose(VAN_DER_POL, {})[0]
    xi, nu = elementary_solution(VAN_DER_POL, first, N, 81)(*data, [Q, *R], rate[None, :])
    moved = nu.full()[0] - (X[1, :-1] + X[1, 1:]) / 2
    mean = np.trapezoid((continuous()(fine.ravel())[1] / R[0]).reshape(fine.shape), dx=1 / 40, axis=1)
    return np.abs(xi.full()[0] - x[0] - continuous()(t)[0]), np.abs(moved - mean)


def test_the_layers_are_at_the_ends_alone_and_not_resolved_at_the_papers_sample_time() -> None:
    assert continuous()(np.array([0.0, T]))[0] == pytest.approx([-1.58e-3, 4.10e-3], rel=0.01)
    xi, x2 = gaps(0.05)
    assert xi[[0, -1]] == pytest.approx([1.34e-3, 3.23e-3], rel=0.01)
    assert x2[[0, -1]] == pytest.approx([9.0e-3, 2.17e-2], rel=0.01)
    assert xi[1:-1].max() < 1.5e-5 and x2[1:-1].max() < 1e-4
    assert xi[10:-10].max() < 2e-6 and x2[10:-10].max() < 1e-5


def test_samples_thinner_than_the_layers_resolve_them_with_second_order() -> None:
    (coarse, x2_coarse), (fine, x2_fine) = gaps(0.004), gaps(0.002)
    for a, b in ((coarse, fine), (x2_coarse, x2_fine)):
        assert a[0] / b[0] > 3 and a[-1] / b[-1] > 3
    assert fine.max() < 7e-5 and x2_fine.max() < 4e-3
