"""How a model moves: x' = f(x, z, u, p, t) by Runge-Kutta, with 0 = g(x, z, u, p, t) solved for z at every stage (index 1).

z is solved from its last value, so that it stays on its branch where g has several solutions. Where a branch ends, at a singular g_z, the
failure says which variable is no longer determined, when, and g_z's pivot: (its number from 1, time, pivot), or zeros.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca

from observers.model import Model
from observers.numerics.equations import Equations
from observers.numerics.index_one import algebraic_solver
from observers.numerics.runge_kutta import runge_kutta


def consistent(model: Model, x: ca.SX, z: ca.SX, given: list[ca.SX], t: ca.SX) -> tuple[ca.SX, ca.SX]:
    """(z, failure) at x from the guess z; `given` = [u, p, theta]. Both empty (0 x 1) for a model without algebraic variables."""
    if not model.algebraic:
        return z, ca.SX(0, 1)
    found, code, pivot = _solver(model, follow=False)(x, z, *given, t)
    return found, _failure(code, t, pivot)


def move(
    model: Model, x: ca.SX, z: ca.SX, failure: ca.SX, given: list[ca.SX], t: ca.SX, h: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """(x, z, failure) at t + h from those at t, `given` = [u, p, theta] held; the first failure is kept."""
    eq = _driven(model)
    rhs = ca.Function("rhs", [eq.x, eq.z, eq.u, eq.p, eq.theta, eq.t], [eq.ode])
    if not model.algebraic:
        return runge_kutta(lambda state, time: rhs(state, z, *given, time), x, t, h), z, failure
    follow = _solver(model, follow=True)
    # What is given may have jumped since the last step: z is where that puts it.
    z, now = consistent(model, x, z, given, t)
    failure = ca.if_else(failure[0] != 0, failure, now)

    def solved(state: ca.SX, time: ca.SX) -> ca.SX:
        nonlocal z, failure
        z, code, pivot = follow(state, z, *given, time)
        failure = ca.if_else(failure[0] != 0, failure, _failure(code, time, pivot))
        return z

    moved = runge_kutta(lambda state, time: rhs(state, solved(state, time), *given, time), x, t, h)
    return moved, solved(moved, t + h), failure


def _driven(model: Model) -> Equations:
    """The equations with unknown disturbances behind the known inputs: here somebody knows them."""
    eq = model.equations
    return replace(eq, u=ca.vertcat(eq.u, eq.w))


def _solver(model: Model, *, follow: bool) -> ca.Function:
    return algebraic_solver(_driven(model), [v.nominal for v in model.algebraic], follow=follow)


def _failure(code: ca.SX, t: ca.SX, pivot: ca.SX) -> ca.SX:
    return ca.if_else(code != 0, ca.vertcat(code, t, pivot), ca.DM.zeros(3))
