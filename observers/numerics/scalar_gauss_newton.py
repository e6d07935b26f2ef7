"""A smooth scalar problem without bounds by Gauss-Newton steps, each one tridiagonal system in the costates; exact for an affine one."""

from __future__ import annotations

import casadi as ca

from observers.numerics import tridiagonal
from observers.numerics.scalar_problem import ScalarProblem

STEPS = 2  # Gauss-Newton steps of a problem that is not affine


def gauss_newton(problem: ScalarProblem, N: int) -> ca.Function:
    """solve(ref, nu, rate, known, target, active, s, p, q, r) -> (xi (1 x N), delta (m x N-1)); O(N).

    With A the linearised constraints, Omega the states' weights and G_i = sum_j b_ij^2 / r_j, the costates solve
    (A Omega^-1 A' + s G) lambda = residual, symmetric positive definite whatever the controls' weights are: nothing is stiff here.
    """
    v = problem.arguments(ca.SX, N)
    m, active = problem.n_controls, ca.horzsplit(v.active)
    xi, delta = ca.horzsplit(v.ref), [ca.SX.zeros(m) for _ in range(N - 1)]
    weight = [v.s / 2 * (sum(active[max(n - 1, 0) : n + 1])) for n in range(N)]
    inverse_r = 1 / v.r if m else ca.SX(0, 1)
    at_reference: list[ca.SX] = []
    for step in range(1 if problem.affine else STEPS):
        slopes, omega, curved = [], [], []
        for n in range(N):
            _, slope, second = problem.penalty(xi[n], v.ref[n], v.target[:, n], v.p, v.q)
            slopes.append(weight[n] * slope)
            omega.append(1 / ca.if_else(weight[n] > 0, weight[n] * second, 1))
        left, right, gain, residual = [], [], [], []
        for i in range(N - 1):
            F, a, b = problem.dynamics((xi[i] + xi[i + 1]) / 2, v.nu[:, i] + delta[i], v.known[:, i], v.p)
            if step == 0:
                at_reference.append(F)
            left.append(active[i] * (1 + v.s / 2 * a))
            right.append(active[i] * (1 - v.s / 2 * a))
            gain.append(b.T * inverse_r)
            curved.append(v.s * ca.dot(b.T * inverse_r, b.T) if m else ca.SX(0))
            moved = xi[i + 1] - xi[i] - v.s * (v.rate[i] + F - at_reference[i])
            residual.append(active[i] * (moved + (v.s * ca.mtimes(b, delta[i]) if m else 0)))
        costate = tridiagonal.solve(
            [
                ca.if_else(active[i] > 0, left[i] ** 2 * omega[i] + right[i] ** 2 * omega[i + 1] + curved[i], 1)
                for i in range(N - 1)
            ],
            [-right[i] * left[i + 1] * omega[i + 1] for i in range(N - 2)],
            [
                residual[i] - right[i] * omega[i + 1] * slopes[i + 1] + left[i] * omega[i] * slopes[i]
                for i in range(N - 1)
            ],
        )
        xi = [
            xi[n]
            - omega[n]
            * (
                slopes[n]
                + (right[n - 1] * costate[n - 1] if n else 0)
                - (left[n] * costate[n] if n < N - 1 else 0)
            )
            for n in range(N)
        ]
        delta = [active[i] * gain[i] * costate[i] for i in range(N - 1)]
    return ca.Function(
        f"solve_{problem.name}",
        list(vars(v).values()),
        [ca.horzcat(*xi), ca.horzcat(*delta) if m else ca.SX(0, N - 1)],
    )
