"""The solvers of scalar problems: against dense least squares, bounded least squares, each other; their order of convergence."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import solveh_banded
from scipy.optimize import lsq_linear

from observers.elementary import tridiagonal
from observers.elementary.defect import mean_rate
from observers.elementary.hamilton_jacobi import hamilton_jacobi
from observers.elementary.problems import decompose, scalar_problem
from observers.elementary.scalar_gauss_newton import gauss_newton
from observers.elementary.scalar_problem import ScalarProblem
from reference_models.duffing import DUFFING_KNOWN
from reference_models.van_der_pol import VAN_DER_POL, VAN_DER_POL_SIGNED

FREE = scalar_problem(VAN_DER_POL, decompose(VAN_DER_POL, {})[0], 81)
CURVED = decompose(VAN_DER_POL, {})[1]


def bounded(nodes: int) -> ScalarProblem:
    """The problem of x1 with 0 <= v <= 0.5."""
    return scalar_problem(VAN_DER_POL_SIGNED, decompose(VAN_DER_POL_SIGNED, {})[0], nodes)


def arguments(N: int, s: float, seed: int) -> dict[str, Any]:
    """Data of the problem of x1 (controls x2, v), smooth and far from solved."""
    rng, t = np.random.default_rng(seed), np.arange(N) * s
    nu = np.vstack([0.5 * np.sin(3 * t[:-1] + seed), np.clip(0.25 + 0.3 * np.sin(2 * t[:-1]), 0, 0.5)])
    y = 0.5 * np.cos(3 * t) + 0.1 * rng.normal() * np.sin(5 * t)
    return {
        "ref": np.zeros((1, N)),
        "nu": nu,
        "rate": np.cos(2 * t[:-1] + seed)[None] + nu[0],
        "known": np.zeros((3, N - 1)),
        "target": np.vstack([y[None], np.zeros((5, N))]),
        "active": np.ones((1, N - 1)),
        "s": s,
        "p": [],
        "q": 10.0,
        "r": np.array([1e-3, 5e-4]),
    }


def curved_arguments(N: int, s: float) -> dict[str, Any]:
    """Data of the problem of x2 (control x1): the example's weights, a reference that moves."""
    t = np.arange(N) * s
    middle = t[:-1] + s / 2
    return {
        "ref": (np.cos(3 * t) + 0.3 * np.sin(t))[None],
        "nu": (np.sin(3 * middle) / 3)[None],
        "rate": -3 * np.sin(3 * middle)[None],
        "known": np.vstack([0 * middle, 0.5 * np.sin(middle), middle]),
        "target": np.zeros((5, N)) + np.vstack([np.zeros((2, N)), 0 * t, 0 * t, t])[:5],
        "active": np.ones((1, N - 1)),
        "s": s,
        "p": [],
        "q": 0.1,
        "r": np.array([10.0]),
    }


def by_least_squares(data: dict[str, Any], low: float = -np.inf, high: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
    """(xi, delta) of the problem of x1, with v between the bounds, from scipy: all unknowns in one bounded linear least-squares problem."""
    N, s = data["ref"].shape[1], data["s"]
    n = N - 1
    sums = s * np.tril(np.ones((N, n)), -1)
    base = np.concatenate([[0], np.cumsum(s * data["rate"][0])])
    trajectory = np.hstack([np.ones((N, 1)), sums, sums])
    weight = np.full(N, s)
    weight[[0, -1]] /= 2
    rows = [np.sqrt(weight * data["q"])[:, None] * trajectory]
    for place in range(2):
        row = np.zeros((n, 1 + 2 * n))
        row[:, 1 + place * n : 1 + (place + 1) * n] = np.sqrt(s * data["r"][place]) * np.eye(n)
        rows.append(row)
    right = np.concatenate([np.sqrt(weight * data["q"]) * (data["target"][0] - base), np.zeros(2 * n)])
    lower = np.concatenate([np.full(1 + n, -np.inf), low - data["nu"][1] - 1e-12])
    upper = np.concatenate([np.full(1 + n, np.inf), high - data["nu"][1] + 1e-12])
    found = lsq_linear(np.vstack(rows), right, (lower, upper), method="bvls", tol=1e-14, max_iter=2000).x
    return trajectory @ found + base, found[1:].reshape(2, n)


def test_the_tridiagonal_solver_agrees_with_scipy() -> None:
    rng = np.random.default_rng(0)
    beside, right = rng.normal(size=29), rng.normal(size=30)
    diagonal = 2 + rng.random(30) + np.abs(np.append(beside, 0)) + np.abs(np.append(0, beside))
    found = tridiagonal.solve([ca.SX(d) for d in diagonal], [ca.SX(e) for e in beside], [ca.SX(b) for b in right])
    banded = np.vstack([np.append(0, beside), diagonal])
    np.testing.assert_allclose(
        ca.DM(ca.evalf(ca.vertcat(*found))).full().ravel(), solveh_banded(banded, right), rtol=0, atol=5e-15
    )


def test_the_mean_rate_over_an_interval_is_of_fourth_order() -> None:
    """Against the trajectory itself: (x(t + s) - x(t)) / s, by scipy to 1e-12."""
    from scipy.integrate import solve_ivp

    eq = DUFFING_KNOWN.equations
    p = [v.start for v in DUFFING_KNOWN.parameters]
    u = [v.start for v in DUFFING_KNOWN.inputs]
    rhs, rule = ca.Function("rhs", [eq.t, eq.x, eq.u, eq.p], [eq.ode]), mean_rate(eq)

    def gap(s: float) -> float:
        path = solve_ivp(lambda t, x: rhs(t, x, u, p).full().ravel(), (0, s), [2, 1], rtol=1e-12, atol=1e-13).y
        found = rule(path[:, 0], path[:, -1], u, u, [], p, 0, s).full().ravel()
        return float(np.abs(found - (path[:, -1] - path[:, 0]) / s).max())

    order = np.log2(gap(0.1) / gap(0.05))
    assert 3.7 <= order <= 4.5, order


@pytest.mark.parametrize("seed", range(3))
def test_an_affine_problem_is_solved_exactly(seed: int) -> None:
    data = arguments(41, 0.05, seed)
    xi, delta = gauss_newton(FREE, 41)(*data.values())
    expected_xi, expected_delta = by_least_squares(data)
    np.testing.assert_allclose(xi.full()[0], expected_xi, rtol=0, atol=6e-9)
    np.testing.assert_allclose(delta.full(), expected_delta, rtol=0, atol=2e-8)


@pytest.mark.parametrize(("N", "s"), [(41, 0.05), (201, 0.05), (31, 0.5)])
def test_the_grid_agrees_with_lq_whatever_the_feedback_rate(N: int, s: float) -> None:
    """sqrt(q (1/r1 + 1/r2)) = 173 rad/s: 8.7 and 87 time constants a sample, where an explicit scheme diverges."""
    data = arguments(N, s, 1)
    exact = gauss_newton(FREE, N)(*data.values())
    for found, expected in zip(hamilton_jacobi(FREE, N)(*data.values()), exact, strict=True):
        assert np.abs((found - expected).full()).max() <= 8e-13


def on_grid(nodes: int, data: dict[str, Any]) -> np.ndarray:
    """xi of the problem of x2 on a grid of so many nodes."""
    N = data["ref"].shape[1]
    return hamilton_jacobi(scalar_problem(VAN_DER_POL, CURVED, nodes), N)(*data.values())[0].full()


@pytest.mark.parametrize("q", [1e-3, 0.1, 10.0])
def test_the_grid_agrees_with_gauss_newton(q: float) -> None:
    data = curved_arguments(41, 0.05) | {"q": q}
    exact = gauss_newton(scalar_problem(VAN_DER_POL, CURVED, 81), 41)(*data.values())[0].full()
    assert np.abs(on_grid(81, data) - exact).max() <= 5e-5


def test_a_smooth_problem_converges_with_the_third_order_of_the_grid_at_least() -> None:
    data = curved_arguments(41, 0.05) | {"q": 10.0}
    limit = on_grid(321, data)
    gaps = [np.abs(on_grid(nodes, data) - limit).max() for nodes in (21, 41, 81)]
    orders = np.log2(np.divide(gaps[:-1], gaps[1:]))
    assert np.all(orders >= 3), (gaps, orders)


@pytest.mark.parametrize(("N", "s", "seed"), [(21, 0.1, 0), (61, 0.1, 1), (61, 0.05, 2)])
def test_with_bounds_the_grid_agrees_with_bounded_least_squares(N: int, s: float, seed: int) -> None:
    data = arguments(N, s, seed)
    xi, delta = by_least_squares(data, 0.0, 0.5)
    gaps = []
    for nodes in (41, 161):
        found_xi, found_delta = hamilton_jacobi(bounded(nodes), N)(*data.values())
        v = data["nu"][1] + found_delta.full()[1]
        assert v.min() >= -1e-12 and v.max() <= 0.5 + 1e-12
        gaps.append(np.abs(found_xi.full()[0] - xi).max())
        assert np.abs(found_delta.full() - delta).max() <= 0.01
    assert gaps[1] <= 2e-4 and gaps[1] < gaps[0]


@pytest.mark.parametrize("solver", [gauss_newton, hamilton_jacobi])
def test_intervals_before_the_first_sample_do_not_count(solver: Any) -> None:
    whole, waiting = arguments(12, 0.05, 3), arguments(20, 0.05, 3)
    for name in ("ref", "nu", "rate", "known", "target"):
        waiting[name] = np.hstack([np.full((whole[name].shape[0], 8), 0.1), whole[name]])
    waiting["active"] = np.hstack([np.zeros((1, 8)), whole["active"]])
    xi, delta = solver(FREE, 20)(*waiting.values())
    expected_xi, expected_delta = solver(FREE, 12)(*whole.values())
    np.testing.assert_allclose(xi.full()[:, 8:], expected_xi.full(), rtol=0, atol=1e-9)
    np.testing.assert_allclose(delta.full()[:, 8:], expected_delta.full(), rtol=0, atol=1e-7)


def test_a_value_function_with_two_valleys_is_searched_as_a_whole() -> None:
    """Penalty (xi^2 - 1)^2 with its valley at -1 a little deeper than at 1, started from the other one: the lowest is found."""
    xi, ref, target, p, q, known = (
        ca.SX.sym("xi"), ca.SX.sym("ref"), ca.SX.sym("target"), ca.SX.sym("p", 0), ca.SX.sym("q"), ca.SX.sym("known")
    )  # fmt: skip
    nu = ca.SX.sym("nu")
    cost = q * ((xi**2 - 1) ** 2 + 0.2 * xi)
    problem = ScalarProblem(
        name="valleys",
        dynamics=ca.Function("dynamics", [xi, nu, known, p], [nu, ca.SX(0), ca.SX(1)]),
        penalty=ca.Function("penalty", [xi, ref, target, p, q], [cost, ca.gradient(cost, xi), ca.SX(1)]),
        affine=True,
        lower=[-10.0],
        upper=[10.0],
        nodes=(-2.0, 2.0, 81),
    )
    N = 15
    found, _ = hamilton_jacobi(problem, N)(
        np.ones((1, N)), np.zeros((1, N - 1)), np.zeros((1, N - 1)), np.zeros((1, N - 1)), np.zeros((1, N)),
        np.ones((1, N - 1)), 0.1, [], 1.0, [0.01],
    )  # fmt: skip
    lowest = np.roots([4, 0, -4, 0.2])
    assert np.abs(found.full() - lowest.real.min()).max() <= 3e-6
