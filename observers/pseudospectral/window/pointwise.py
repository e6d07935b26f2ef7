"""A nonlinear term evaluated at many points of a window.

What depends on time and inputs only is computed once per sample, not once per iteration. Algebraic variables are eliminated point by point:
z solves g(x, z) = 0 by a few Newton steps from a given value, and phi's derivatives are those of phi(x, z(x)),

    phi_x - phi_z g_z^-1 g_x,    phi_theta - phi_z g_z^-1 g_theta.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from observers.numerics import algebraic, linear
from observers.numerics.equations import Equations
from observers.numerics.semilinear import Split


@dataclass(frozen=True)
class Pointwise:
    """The term phi of a Split at one point.

    `known(t, u, p) -> e` are the subexpressions without states and unknown parameters;
    `value(xq, e, p, theta, z0) -> (phi, phi_x, phi_theta)` is the rest, with its derivatives (nv), (nv x nq), (nv x nt).
    `solved(xq, e, p, theta, z0) -> (z, regularity)`: the algebraic variables and the smallest pivot of g_z, scaled. Without algebraic
    variables z0 and z are empty.
    """

    known: ca.Function
    value: ca.Function
    solved: ca.Function
    n: int
    n_states: int
    n_known: int
    n_algebraic: int


def pointwise(part: Split, eq: Equations, z_scale: tuple[float, ...] = ()) -> Pointwise:
    """Functions of `part.phi`, an expression in the symbols of `eq`; `z_scale` the algebraic variables' nominal values."""
    has_z = ca.depends_on(part.phi, eq.z) if part.phi.numel() and eq.z.numel() else False
    z = eq.z if has_z else ca.SX(0, 1)
    g = eq.algebraic if has_z else ca.SX(0, 1)
    reduced, symbols, subexpressions = ca.extract_parametric(ca.vertcat(part.phi, g), ca.vertcat(eq.t, eq.u, eq.p))
    e = ca.vertcat(*symbols) if symbols else ca.SX(0, 1)
    known = ca.vertcat(*subexpressions) if symbols else ca.SX(0, 1)
    # What extraction leaves of t and u where they stand alone still has to reach the value.
    left = [s for s in ca.vertsplit(ca.vertcat(eq.t, eq.u)) if ca.depends_on(reduced, s)]
    if left:
        stand_ins = [ca.SX.sym(s.name()) for s in left]
        reduced = ca.substitute(reduced, ca.vertcat(*left), ca.vertcat(*stand_ins))
        e, known = ca.vertcat(e, *stand_ins), ca.vertcat(known, *left)
    xq = eq.x[part.states] if part.states else ca.SX(0, 1)
    n = part.phi.numel()
    phi, g = reduced[:n], reduced[n:]
    value = [phi, ca.jacobian(phi, xq), ca.jacobian(phi, eq.theta)]
    z0, solution, regularity = ca.SX(0, 1), ca.SX(0, 1), ca.SX(1)
    if has_z:
        z0 = ca.SX.sym("z0", z.numel())
        slope = ca.jacobian(g, z)
        solution = algebraic.solution(g, z, z0)
        by_x = linear.qr_solve(slope, ca.densify(ca.jacobian(g, xq))) if xq.numel() else ca.SX(z.numel(), 0)
        by_theta = (
            linear.qr_solve(slope, ca.densify(ca.jacobian(g, eq.theta))) if eq.theta.numel() else ca.SX(z.numel(), 0)
        )
        phi_z = ca.jacobian(phi, z)
        value = [phi, value[1] - ca.mtimes(phi_z, by_x), value[2] - ca.mtimes(phi_z, by_theta)]
        R, _ = linear.givens(ca.mtimes(slope, ca.diag(ca.DM(z_scale))), ca.SX(z.numel(), 0))
        regularity = ca.mmin(ca.fabs(ca.diag(R)))
        *value, regularity = ca.substitute([*value, regularity], [z], [solution])
    arguments = [xq, e, eq.p, eq.theta, z0]
    return Pointwise(
        known=ca.Function("known", [eq.t, eq.u, eq.p], [ca.densify(known)]),
        value=ca.Function("value", arguments, [ca.densify(part) for part in value], {"cse": True}),
        solved=ca.Function("solved", arguments, [solution, regularity], {"cse": True}),
        n=n,
        n_states=len(part.states),
        n_known=e.numel(),
        n_algebraic=z.numel(),
    )
