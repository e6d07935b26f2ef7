"""A smooth scalar problem without bounds by Gauss-Newton steps, each one tridiagonal system in the costates; exact for an affine one."""

from __future__ import annotations

from typing import Any

import casadi as ca

from observers.elementary import tridiagonal
from observers.elementary.columns import repeated
from observers.elementary.scalar_problem import ScalarProblem

STEPS = 2  # Gauss-Newton steps of a problem that is not affine


def gauss_newton(problem: ScalarProblem, N: int) -> ca.Function:
    """solve(ref, nu, rate, known, target, active, s, p, q, r) -> (xi (1 x N), delta (m x N-1)); O(N).

    With A the linearised constraints, Omega the states' weights and G_i = sum_j b_ij^2 / r_j, the costates solve
    (A Omega^-1 A' + s G) lambda = residual, symmetric positive definite whatever the controls' weights are: nothing is stiff here.
    """
    v = problem.arguments(ca.MX, N)
    m = problem.n_controls
    before, after = slice(None, -1), slice(1, None)
    interval, node, costates = _interval(problem).map(N - 1), _node(problem).map(N), _costates(N - 1)
    weight = v.s / 2 * (ca.horzcat(0, v.active) + ca.horzcat(v.active, 0))
    shared = [repeated(column, N - 1) for column in (v.s, v.p, v.r)]
    xi, delta, moved = v.ref, ca.MX.zeros(m, N - 1), v.s * v.rate
    at_reference: Any = None
    for _ in range(1 if problem.affine else STEPS):
        slope, inverse = node(xi, v.ref, v.target, weight, repeated(v.p, N), repeated(v.q, N))
        F, left, right, gain, acting, curved = interval(
            (xi[before] + xi[after]) / 2, v.nu, delta, v.known, v.active, *shared
        )
        at_reference = F if at_reference is None else at_reference
        residual = v.active * (xi[after] - xi[before] - moved - v.s * (F - at_reference)) + acting
        diagonal = left**2 * inverse[before] + right**2 * inverse[after] + curved
        beside = -right[before] * left[after] * inverse[slice(1, N - 1)]
        pull = slope * inverse
        costate = costates(diagonal, beside, residual - right * pull[after] + left * pull[before])
        xi = xi - pull - inverse * (ca.horzcat(0, right * costate) - ca.horzcat(left * costate, 0))
        delta = gain * repeated(costate.T, m).T if m else delta
    return ca.Function(f"solve_{problem.name}", list(vars(v).values()), [xi, delta])


def _interval(problem: ScalarProblem) -> ca.Function:
    """interval(xi, nu, delta, known, active, s, p, r) -> (F, the constraint's two coefficients, delta / lambda, s b delta, s G).

    An interval before the first sample constrains nothing: its costate is 0.
    """
    m, (xi, active, s) = problem.n_controls, (ca.SX.sym(name) for name in ("xi", "active", "s"))
    nu, delta, r = ca.SX.sym("nu", m), ca.SX.sym("delta", m), ca.SX.sym("r", m)
    known, p = ca.SX.sym("known", problem.dynamics.numel_in(2)), ca.SX.sym("p", problem.dynamics.numel_in(3))
    F, a, b = problem.dynamics(xi, nu + delta, known, p)
    gain = b.T / r
    found = [F, active * (1 + s / 2 * a), active * (1 - s / 2 * a), active * gain]
    acting = active * s * ca.dot(b.T, delta) if m else ca.SX(0)
    curved = ca.if_else(active, s * ca.dot(gain, b.T) if m else 0, 1)
    return ca.Function("interval", [xi, nu, delta, known, active, s, p, r], [*found, acting, curved])


def _node(problem: ScalarProblem) -> ca.Function:
    """node(xi, ref, target, w, p, q) -> (w dl/dxi, 1 / (w its second derivative)); a node that pays nothing moves with no one."""
    xi, weight = ca.SX.sym("xi"), ca.SX.sym("w")
    ref, target, p, q = (ca.SX.sym(problem.penalty.name_in(i), problem.penalty.numel_in(i)) for i in range(1, 5))
    _, slope, second = problem.penalty(xi, ref, target, p, q)
    inverse = 1 / ca.if_else(weight > 0, weight * second, 1)
    return ca.Function("node", [xi, ref, target, weight, p, q], [weight * slope, inverse])


def _costates(n: int) -> ca.Function:
    """costates(diagonal, beside, right) -> the solution (1 x n) of the tridiagonal system."""
    diagonal, beside, right = ca.SX.sym("d", 1, n), ca.SX.sym("e", 1, n - 1), ca.SX.sym("b", 1, n)
    solution = tridiagonal.solve(ca.horzsplit(diagonal), ca.horzsplit(beside), ca.horzsplit(right))
    return ca.Function("costates", [diagonal, beside, right], [ca.horzcat(*solution)])
