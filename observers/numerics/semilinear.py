"""Splits a right-hand side into a constant linear part and the rest: f = A x + B u + E phi(x_Q, ...).

What enters linearly with constant coefficients can be solved once and for all when the observer is built; only phi is left for the run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from observers.numerics.equations import Equations
from observers.numerics.operations import JUMPS, holds


@dataclass(frozen=True)
class Split:
    """f = A x + B u + E phi.

    `rows` are the rows of f that phi fills (E = identity[:, rows]), `states` and `inputs` the entries of x and u that it depends on.
    A (n x nx), B (n x nu) numeric; phi (nv x 1) a CasADi expression in x[states], u and the remaining symbols of f.
    """

    A: np.ndarray
    B: np.ndarray
    E: np.ndarray
    phi: ca.SX
    rows: list[int]
    states: list[int]
    inputs: list[int]


def split(f: ca.SX, x: ca.SX, u: ca.SX) -> Split:
    """Split `f` (n x 1) by its Jacobian: entries that hold no symbol go to A and B, everything else to phi.

    Where df_i/dx_j is constant, f_i is x_j's term plus something without x_j (its other derivatives cannot depend on x_j
    either), so phi_i is f_i with x_j = 0: exact, and without cancellation. Rows with fmod, floor and the like stay whole in phi.
    """
    A, B = _constant_entries(f, x), _constant_entries(f, u)
    rest = []
    for i, expression in enumerate(ca.vertsplit(f)):
        rest.append(ca.simplify(_without(_without(expression, x, A[i]), u, B[i])))
    rows = [i for i, expression in enumerate(rest) if not (expression.is_constant() and expression.is_zero())]
    phi = ca.vertcat(*[rest[i] for i in rows]) if rows else ca.SX(0, 1)
    return Split(A, B, np.eye(len(rest))[:, rows], phi, rows, _used(phi, x), _used(phi, u))


def thinned(part: Split, f: ca.SX, x: ca.SX, u: ca.SX) -> Split:
    """`part`, the split of `f`, with phi's rows whole but for what inputs add: what is left of A says which state is another's rate.

    The linear part's response then couples few states; phi_x sees more of them.
    """
    A = part.A.copy()
    A[part.rows] = 0
    phi = ca.vertcat(*[ca.simplify(_without(f[i], u, part.B[i])) for i in part.rows]) if part.rows else part.phi
    return replace(part, A=A, phi=phi, states=_used(phi, x), inputs=_used(phi, u))


def lift_inputs(eq: Equations) -> tuple[Equations, ca.Function]:
    """(equations with more inputs, Function lift(u, p) -> those inputs): what u forces through settable gains becomes an input.

    A term b(p) u_j of a row whose coefficient depends on parameters only is no constant, but as known as u: with w_i = sum_j b_ij(p) u_j
    as a further input of row i it enters with coefficient 1, and its response is exact like that of B u.
    """
    slope = ca.densify(ca.jacobian(eq.ode, eq.u))
    others = ca.vertcat(eq.x, eq.u, eq.theta, eq.t)
    rows, forced = list(ca.vertsplit(eq.ode)), []
    names = []
    for i in range(slope.shape[0]):
        entries = [ca.simplify(slope[i, j]) for j in range(slope.shape[1])]
        through = [j for j, b in enumerate(entries) if not b.is_constant() and not ca.depends_on(b, others)]
        if through and not holds(rows[i], JUMPS):
            w = ca.SX.sym(f"w{i}")
            rows[i] = ca.substitute(rows[i], eq.u[through], ca.DM.zeros(len(through))) + w
            forced.append(sum((entries[j] * eq.u[j] for j in through), ca.SX(0)))
            names.append(w)
    lifted = replace(eq, u=ca.vertcat(eq.u, *names), ode=ca.vertcat(*rows))
    return lifted, ca.Function("lift", [eq.u, eq.p], [ca.vertcat(eq.u, *forced)])


def unreachable(f: ca.SX, h: ca.SX, symbols: ca.SX, x: ca.SX) -> list[int]:
    """Indices of `symbols` (states, or states and parameters, states first) that no output sees, not even through other states."""
    sees: np.ndarray = np.any(ca.DM(ca.jacobian_sparsity(h, symbols)).full(), axis=0)
    feeds = np.array(ca.DM(ca.jacobian_sparsity(f, symbols)).full()) != 0  # nx x ns: symbol j enters x_i'
    for _ in range(x.numel()):
        sees = sees | (feeds & sees[: x.numel(), None]).any(axis=0)
    return [int(j) for j in np.flatnonzero(~sees)]


def _without(expression: ca.SX, symbols: ca.SX, constant: np.ndarray) -> ca.SX:
    """An entry of f without the terms of its `constant` derivatives by `symbols`."""
    gone = [int(j) for j in np.flatnonzero(constant)]
    return ca.substitute(expression, symbols[gone], ca.DM.zeros(len(gone))) if gone else expression


def _constant_entries(f: ca.SX, symbols: ca.SX) -> np.ndarray:
    jacobian = ca.jacobian(f, symbols)
    values = np.zeros(jacobian.shape)
    jumping = [holds(f[i], JUMPS) for i in range(f.shape[0])]
    for k, (i, j) in enumerate(zip(*jacobian.sparsity().get_triplet(), strict=True)):
        entry = ca.simplify(jacobian.nz[k])
        if entry.is_constant() and not jumping[i]:
            values[i, j] = float(entry)
    return values


def _used(expression: ca.SX, symbols: ca.SX) -> list[int]:
    pattern: Sequence[bool] = (
        ca.which_depends(expression, symbols, 1, False) if expression.numel() and symbols.numel() else []
    )
    return [j for j, used in enumerate(pattern) if used]
