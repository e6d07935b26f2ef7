"""Algebraic variables eliminated: z solves g(x, z) = 0 by Newton's method from a value nearby, which picks the branch."""

from __future__ import annotations

import casadi as ca

from observers.numerics import linear
from observers.numerics.equations import Equations
from observers.numerics.index_one import algebraic_solver

STEPS = 3  # of Newton's method: what calls it goes on from where they end


def solution(g: ca.SX, z: ca.SX, z0: ca.SX) -> ca.SX:
    """The expression for z (nz) with g(z) = 0 from z0, by STEPS Newton steps."""
    others = [s for s in ca.symvar(g) if not ca.depends_on(z, s)]
    step = ca.Function("step", [z, *others], [z - linear.qr_solve(ca.jacobian(g, z), g)])
    found = z0
    for _ in range(STEPS):
        found = step(found, *others)
    return found


def motion(eq: Equations) -> ca.Function:
    """motion(x, u, p, theta, t, z0) -> (x', z), the model as an ordinary differential equation."""
    return ca.Function("motion", *_eliminated(eq, eq.ode), {"cse": True})


def measurement(eq: Equations) -> ca.Function:
    """measurement(x, u, p, theta, t, z0) -> (y, z)."""
    return ca.Function("measurement", *_eliminated(eq, eq.output), {"cse": True})


def followed(eq: Equations, nominal: list[float]) -> ca.Function:
    """followed(x, z, u, p, theta, t) -> (z, lost): z on the branch of a known value nearby, or that there is none any more."""
    if not eq.z.numel():
        return ca.Function("followed", [eq.x, eq.z, eq.u, eq.p, eq.theta, eq.t], [eq.z, 0])
    solver = algebraic_solver(eq, nominal, follow=True)
    arguments = [ca.SX.sym(solver.name_in(i), solver.size_in(i)) for i in range(solver.n_in())]
    z, failure, _ = solver(*arguments)
    return ca.Function("followed", arguments, [z, failure != 0])


def _eliminated(eq: Equations, expression: ca.SX) -> tuple[list[ca.SX], list[ca.SX]]:
    z0 = ca.SX.sym("z0", eq.z.numel())
    z = solution(eq.algebraic, eq.z, z0) if eq.z.numel() else eq.z
    value = ca.substitute(expression, eq.z, z) if eq.z.numel() else expression
    return [eq.x, eq.u, eq.p, eq.theta, eq.t, z0], [value, z]
