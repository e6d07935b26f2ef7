"""What `condense` evaluates at a group of nodes or measured points at once: functions of scalars, each existing once for each shape."""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca

from observers.numerics import tiles
from observers.pseudospectral.window.pointwise import Pointwise


@cache
def tile(nv: int, nq: int, size: int, other: int, diagonal: bool, pattern: tuple[int, ...]) -> ca.Function:
    """-blk(phi_x) PsQ, plus the identity on the diagonal; phi_x stacked (size nv x nq), with the compressed sparsity `pattern`."""

    def body(slope: ca.SX, PsQ: ca.SX) -> ca.SX:
        rows = [-ca.mtimes(slope[j * nv : (j + 1) * nv, :], PsQ[j * nq : (j + 1) * nq, :]) for j in range(size)]
        return ca.vertcat(*rows) + (ca.SX(ca.DM.eye(size * nv)) if diagonal else 0)

    name = f"tile_{nv}_{nq}_{size}_{other}{'_d' if diagonal else ''}"
    slope, PsQ = ca.SX.sym("slope", ca.Sparsity.compressed(list(pattern))), ca.SX.sym("PsQ", size * nq, other * nv)
    return ca.Function(name, [slope, PsQ], [ca.densify(body(slope, PsQ))])


def collocated(rates: Pointwise, size: int, n: int, n_noise: int = 0) -> ca.Function:
    """phi_x stacked (size nv x nq, sparse), the right-hand side [phi - V, 0, phi_theta, 0] + phi_x PhQ RG of `size` nodes, and z there."""
    nq, ne, nv, nz = rates.n_states, rates.n_known, rates.n, rates.n_algebraic
    n_p, n_theta = rates.value.numel_in(2), rates.value.numel_in(3)

    def body(xq: ca.SX, e: ca.SX, p: ca.SX, theta: ca.SX, z: ca.SX, V: ca.SX, moved: ca.SX) -> tuple[ca.SX, ...]:
        slopes, right, algebraic = [], [], []
        for j in range(size):
            q = slice(j * nq, (j + 1) * nq)
            at = [xq[q], e[j * ne : (j + 1) * ne], p, theta, z[j * nz : (j + 1) * nz]]
            value, slope, by_theta = rates.value(*at)
            slopes.append(slope)
            between = ca.SX(nv, n - 1 - n_theta - n_noise)
            own = ca.horzcat(value - V[j * nv : (j + 1) * nv], between, by_theta, ca.SX(nv, n_noise))
            right.append(own + ca.mtimes(slope, moved[q, :]))
            algebraic.append(rates.solved(*at)[0])
        return ca.sparsify(ca.vertcat(*slopes)), ca.vertcat(*right), ca.vertcat(*algebraic)

    shapes = [(size * nq, 1), (size * ne, 1), (n_p, 1), (n_theta, 1), (size * nz, 1), (size * nv, 1), (size * nq, n)]
    return tiles.function(f"collocated_{size}", *shapes)(body)


@cache
def collocated_at(rates: Pointwise) -> ca.Function:
    """phi_x (nv x nq, sparse), phi - V, phi_theta (nv x nt) and z at one node."""
    at = [ca.SX.sym(rates.value.name_in(i), rates.value.size1_in(i)) for i in range(rates.value.n_in())]
    V = ca.SX.sym("V", rates.n)
    value, slope, by_theta = rates.value(*at)
    results = [ca.sparsify(slope), value - V, by_theta, rates.solved(*at)[0]]
    return ca.Function("collocated_at", [*at, V], results)


@cache
def scaled_add(rows: int, columns: int, sign: float) -> ca.Function:
    """c + sign diag(a) b."""
    shapes = ((rows, columns), (rows, 1), (rows, columns))

    def body(c: ca.SX, a: ca.SX, b: ca.SX) -> ca.SX:
        return c + sign * ca.repmat(a, 1, columns) * b

    return tiles.function(f"scaled_{rows}_{columns}{'' if sign > 0 else '_sub'}", *shapes)(body)


def observed(rest: Pointwise, size: int) -> ca.Function:
    """h_n, its derivatives by the states (stacked size n x nh) and by theta, at `size` points."""
    nh, ne, nz = rest.n_states, rest.n_known, rest.n_algebraic
    n_p, n_theta = rest.value.numel_in(2), rest.value.numel_in(3)

    def body(xh: ca.SX, e: ca.SX, p: ca.SX, theta: ca.SX, z: ca.SX) -> tuple[ca.SX, ...]:
        found = [
            rest.value(xh[i * nh : (i + 1) * nh], e[i * ne : (i + 1) * ne], p, theta, z[i * nz : (i + 1) * nz])
            for i in range(size)
        ]
        return tuple(ca.vertcat(*column) for column in zip(*found, strict=True))

    shapes = [(size * nh, 1), (size * ne, 1), (n_p, 1), (n_theta, 1), (size * nz, 1)]
    return tiles.function(f"observed_{size}", *shapes)(body)


@cache
def chain(n: int, nh: int, size: int, m: int) -> ca.Function:
    """blk(slopes) moved, with the slopes stacked (size n x nh)."""

    def body(slope: ca.SX, moved: ca.SX) -> ca.SX:
        return ca.vertcat(
            *[ca.mtimes(slope[i * n : (i + 1) * n, :], moved[i * nh : (i + 1) * nh, :]) for i in range(size)]
        )

    return tiles.function(f"chain_{n}_{nh}_{size}_{m}", (size * n, nh), (size * nh, m))(body)


@cache
def normal(rows: int, n: int) -> ca.Function:
    """[r + M_0, M_s]' W [r + M_0, M_s]: normal matrix, gradient and cost in one symmetric matrix."""

    def body(r: Any, M: Any, w: Any) -> Any:
        full = ca.horzcat(r + M[:, 0], M[:, 1:])
        return ca.mtimes((full * ca.repmat(w, 1, n)).T, full)

    return tiles.function(f"normal_{rows}_{n}", (rows, 1), (rows, n), (rows, 1), kind=tiles.kind(n - 1))(body)
