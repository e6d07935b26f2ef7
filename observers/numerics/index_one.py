"""The algebraic equations 0 = g(x, z, u, p, t) of an index-1 DAE, solved for z near a known value, as a CasADi function.

Newton's method in a fixed number of steps: a real-time component must take the same time every time. Where g_z becomes singular the
solution branches or ends, and Newton's method would jump to some other branch: that must not pass for a solution.
"""

from __future__ import annotations

import math

import casadi as ca

from observers.numerics import linear
from observers.numerics.equations import Equations

STEPS = 6  # from a value nearby: an error of 1e-2 is below 1e-16 after four
STEPS_FROM_GUESS = 20
CONVERGED = 1e-10  # the last step, relative to z and its nominal value
SMALLEST_PIVOT = 1e-8  # of g_z, relative to its largest entry
SLOPE_CHANGE = (
    2.0  # of det g_z along one branch from one solution to the next: it goes through zero between two branches
)


def algebraic_solver(equations: Equations, nominal: list[float], *, follow: bool) -> ca.Function:
    """Function (x, z, u, p, theta, t) -> (z, failure, pivot).

    z (nz x 1) is where Newton's method starts and what it finds; `nominal` its typical magnitudes. `follow`: z comes from a solution
    nearby and stays on its branch, else from a guess. failure: 0, or i (from 1) where no solution was found and g_z's i-th pivot by
    Givens rotations, which belongs to z_i, is the smallest: at the known solution, or on the way from the guess; pivot: its magnitude.
    """
    eq = equations
    nz = eq.z.numel()
    symbols = [eq.x, eq.z, eq.u, eq.p, eq.theta, eq.t]
    R, rotated = linear.givens(ca.jacobian(eq.algebraic, eq.z), eq.algebraic)
    step = linear.backward(R, rotated)
    scale = ca.norm_inf(ca.densify(ca.jacobian(eq.algebraic, eq.z))[:])
    newton = ca.Function("newton", symbols, [step, ca.diag(R), scale])
    z = eq.z
    visited = []
    change = ca.SX(0)
    for _ in range(STEPS if follow else STEPS_FROM_GUESS):
        dz, pivots, _ = newton(eq.x, z, *symbols[2:])
        visited.append(pivots)
        z = z - dz
        change = ca.norm_inf(dz / (ca.fabs(z) + ca.DM(nominal)))
    worst, where = ca.SX(math.inf), ca.SX(1)
    for passed in visited[:1] if follow else visited:
        for i in range(nz):
            smaller = ca.fabs(passed[i]) < worst
            worst, where = ca.if_else(smaller, ca.fabs(passed[i]), worst), ca.if_else(smaller, i + 1, where)
    _, pivots, scale = newton(eq.x, z, *symbols[2:])
    # NaN fails every comparison.
    found = ca.logic_and(change < CONVERGED, ca.mmin(ca.fabs(pivots)) > SMALLEST_PIVOT * scale)
    if follow:
        ratio = _product(pivots) / _product(visited[0])
        found = ca.logic_and(found, ca.logic_and(ratio < SLOPE_CHANGE, ratio > 1 / SLOPE_CHANGE))
    return ca.Function("algebraic", symbols, [z, ca.if_else(found, 0, where), worst])


def _product(values: ca.SX) -> ca.SX:
    total = ca.SX(1)
    for value in ca.vertsplit(values):
        total = total * value
    return total
