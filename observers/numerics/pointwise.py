"""A nonlinear term evaluated at many points of a window.

What depends on time and inputs only is computed once per sample, not once per iteration.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from observers.numerics.equations import Equations
from observers.numerics.semilinear import Split


@dataclass(frozen=True)
class Pointwise:
    """The term phi of a Split at one point.

    `known(t, u, p) -> e` are the subexpressions without states and unknown parameters;
    `value(xq, e, p, theta) -> (phi, phi_x, phi_theta)` is the rest, with its derivatives (nv), (nv x nq), (nv x nt).
    """

    known: ca.Function
    value: ca.Function
    n: int
    n_states: int
    n_known: int


def pointwise(part: Split, eq: Equations) -> Pointwise:
    """Functions of `part.phi`, an expression in the symbols of `eq`."""
    reduced, symbols, subexpressions = ca.extract_parametric(part.phi, ca.vertcat(eq.t, eq.u, eq.p))
    e = ca.vertcat(*symbols) if symbols else ca.SX(0, 1)
    known = ca.vertcat(*subexpressions) if symbols else ca.SX(0, 1)
    # What extraction leaves of t and u where they stand alone still has to reach the value.
    left = [s for s in ca.vertsplit(ca.vertcat(eq.t, eq.u)) if ca.depends_on(reduced, s)]
    if left:
        stand_ins = [ca.SX.sym(s.name()) for s in left]
        reduced = ca.substitute(reduced, ca.vertcat(*left), ca.vertcat(*stand_ins))
        e, known = ca.vertcat(e, *stand_ins), ca.vertcat(known, *left)
    xq = eq.x[part.states] if part.states else ca.SX(0, 1)
    derivatives = [ca.densify(ca.jacobian(reduced, xq)), ca.densify(ca.jacobian(reduced, eq.theta))]
    return Pointwise(
        known=ca.Function("known", [eq.t, eq.u, eq.p], [ca.densify(known)]),
        value=ca.Function("value", [xq, e, eq.p, eq.theta], [ca.densify(reduced), *derivatives], {"cse": True}),
        n=part.phi.numel(),
        n_states=len(part.states),
        n_known=e.numel(),
    )
