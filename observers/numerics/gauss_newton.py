"""One Gauss-Newton step of the windowed least-squares problem, condensed to the unknowns s = [x0; theta].

For the rates V and s, with X_Q = PhQ x0 + PsQ V + CQ the states that phi depends on:

    (I - blk(phi_x) PsQ) sol = [phi - V, phi_x PhQ, phi_theta]      dV = sol [1; ds]
    M = d h / d [1; s] at the measured points                        r = h - y
    (sum w M'M + lam I) ds = -sum w M'(r + M_0)
"""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from observers.numerics import linear, tiles
from observers.numerics.exact import product
from observers.numerics.least_squares import LeastSquares, split_data
from observers.numerics.pointwise import Pointwise


def _rows(group: list[Any], start: int, size: int) -> Any:
    chosen = group[start : start + size]
    return ca.vertcat(*chosen)


def output_residual(problem: LeastSquares) -> ca.Function:
    """Function residual(V, s, data, p, y) -> h(points) - y, stacked (ny m)."""
    kind: Any = ca.SX if problem.is_small else ca.MX
    V, s, data, p, y = _symbols(problem, kind)
    return ca.Function(
        "residual",
        [V, s, data, p, y],
        [ca.vertcat(*[r for r, _ in _measured(problem, kind, V, s, data, p, y, None)])],
    )


def newton_step(problem: LeastSquares) -> ca.Function:
    """Function newton(V, s, data, p, y, w, lam, length) -> (V+, s+, size, cost, conditioning).

    The correction of V for its collocation residual is always whole; `length` is the part taken of the step in s, and of V's with it.
    `size` is |scaled step|^2 (NaN or infinite if the step failed), `cost` the weighted sum of squares that the linearisation predicts
    after the whole step, `conditioning` in [0, 1] the smallest pivot of the scaled normal matrix over the largest.
    """
    kind: Any = ca.SX if problem.is_small else ca.MX
    V, s, data, p, y = _symbols(problem, kind)
    w = kind.sym("w", problem.ny * len(problem.points))
    lam, length = kind.sym("lam"), kind.sym("length")
    sol = _condense(problem, kind, V, s, data, p)
    rows = _measured(problem, kind, V, s, data, p, y, sol)
    nxt = 1 + problem.nx + problem.n_theta
    normal, start = kind(ca.DM.zeros(nxt, nxt)), 0
    for r, M in rows:
        normal = normal + _normal(M.shape[0], nxt)(r, M, w[start : start + M.shape[0]])
        start += M.shape[0]
    step, conditioning, cost = _reduced(tuple(problem.scale))(normal, lam)
    full = ca.vertcat(1, length * step)
    dV = ca.vertcat(*[tiles.product(block.shape[0], nxt)(block, full) for block in sol]) if sol else kind(0, 1)
    weights = np.tile(1 / problem.rate_scale, problem.window.order) if problem.n_rates else np.zeros(0)
    size = ca.sumsqr(step / problem.scale) + (ca.sumsqr(dV * weights) if problem.n_rates else 0)
    return ca.Function(
        "newton", [V, s, data, p, y, w, lam, length], [V + dV, s + length * step, size, cost, conditioning]
    )


def _symbols(problem: LeastSquares, kind: Any) -> tuple[Any, ...]:
    counts = (
        problem.n_rates,
        problem.nx + problem.n_theta,
        sum(problem.lengths),
        problem.n_parameters,
        problem.ny * len(problem.points),
    )
    return tuple(kind.sym(name, count) for name, count in zip(("V", "s", "data", "p", "y"), counts, strict=True))


def _condense(problem: LeastSquares, kind: Any, V: Any, s: Any, data: Any, p: Any) -> list[Any]:
    """sol, d V / d [1; s], in groups of rows."""
    rates, w = problem.rates, problem.window
    if rates.n == 0:
        return []
    PhQ, PsQ, _ = w.at(w.node_times[1:], w.split.states)
    CQ, e, *_ = split_data(problem, data)
    groups = [w.order] if kind is ca.SX else tiles.sizes(w.order, max(1, tiles.TILE // rates.n))
    nq, nv, nx = rates.n_states, rates.n, problem.nx
    x0, theta = s[:nx], s[nx:]
    collocated = {size: _collocated(rates, size, nx) for size in set(groups)}
    A: list[list[Any]] = []
    b: list[Any] = []
    first = 0
    for size in groups:
        q, v = slice(first * nq, (first + size) * nq), slice(first * nv, (first + size) * nv)
        xq = _affine(kind, PhQ[q], x0, PsQ[q], V, _rows(CQ, first, size))
        slope, right = collocated[size](xq, _rows(e, first, size), p, theta, V[v], kind(ca.DM(PhQ[q])))
        row, column = [], 0
        for other in groups:
            c = slice(column * nv, (column + other) * nv)
            row.append(_tile(nv, nq, size, other, first == column)(slope, kind(ca.DM(PsQ[q, c]))))
            column += other
        A.append(row)
        b.append(right)
        first += size
    return tiles.solve_tiles(A, b)


def _measured(
    problem: LeastSquares,
    kind: Any,
    V: Any,
    s: Any,
    data: Any,
    p: Any,
    y: Any,
    sol: list[Any] | None,
) -> list[tuple[Any, Any]]:
    """(r, M) by groups of measured points: residual h - y and, where `sol` is given, its derivative with respect to [1; s]."""
    rest, nx, ny, m = problem.output_rest, problem.nx, problem.ny, len(problem.points)
    Ph, Ps, _ = problem.window.at(problem.points)
    C = np.kron(np.eye(m), problem.output.A)
    CPh, CPs = product(C, Ph), product(C, Ps)
    PhH, PsH, _ = problem.window.at(problem.points, problem.output.states)
    *_, offset, CH, eh = split_data(problem, data)
    x0, theta = s[:nx], s[nx:]
    nh = rest.n_states
    groups = [m] if kind is ca.SX else tiles.sizes(m, max(1, tiles.TILE // ny))
    observed = {size: _observed(rest, size) for size in set(groups)} if rest.n else {}
    out, first = [], 0
    for size in groups:
        rows, h = slice(first * ny, (first + size) * ny), slice(first * nh, (first + size) * nh)
        r = _affine(kind, CPh[rows], x0, CPs[rows], V, _rows(offset, first, size)) - y[rows]
        M = _sensitivity(kind, CPh[rows], CPs[rows], sol, problem.n_theta) if sol is not None else None
        if rest.n:
            xh = _affine(kind, PhH[h], x0, PsH[h], V, _rows(CH, first, size))
            eh_rows = _rows(eh, first, size)
            embed = ca.DM(np.kron(np.eye(size), problem.output.E))
            value, slope, by_theta = observed[size](xh, eh_rows, p, theta)
            r = r + ca.mtimes(embed, value)
            if M is not None:
                moved = _sensitivity(kind, PhH[h], PsH[h], sol or [], problem.n_theta)
                M = M + ca.mtimes(embed, _chain(rest.n, nh, size, moved.shape[1])(slope, moved))
                if problem.n_theta:
                    M = M + ca.horzcat(kind(ca.DM.zeros(size * ny, 1 + nx)), ca.mtimes(embed, by_theta))
        out.append((r, M))
        first += size
    return out


def _affine(kind: Any, Ph: np.ndarray, x0: Any, Ps: np.ndarray, V: Any, offset: Any) -> Any:
    return ca.mtimes(kind(ca.DM(Ph)), x0) + ca.mtimes(kind(ca.DM(Ps)), V) + offset


def _sensitivity(kind: Any, Ph: np.ndarray, Ps: np.ndarray, sol: list[Any], n_theta: int) -> Any:
    """Ps sol + [0 Ph 0]: d x(points) / d [1; x0; theta]."""
    total: Any = kind(ca.DM(np.hstack([np.zeros((len(Ph), 1)), Ph, np.zeros((len(Ph), n_theta))])))
    column = 0
    for block in sol:
        n = block.shape[0]
        total = tiles.multiply_add(Ph.shape[0], n, block.shape[1], 1.0)(
            total, kind(ca.DM(Ps[:, column : column + n])), block
        )
        column += n
    return total


# The group functions.


@cache
def _tile(nv: int, nq: int, size: int, other: int, diagonal: bool) -> ca.Function:
    """-blk(phi_x) PsQ, plus the identity on the diagonal; phi_x stacked (size nv x nq)."""

    def body(slope: ca.SX, PsQ: ca.SX) -> ca.SX:
        rows = [-ca.mtimes(slope[j * nv : (j + 1) * nv, :], PsQ[j * nq : (j + 1) * nq, :]) for j in range(size)]
        return ca.vertcat(*rows) + (ca.SX(ca.DM.eye(size * nv)) if diagonal else 0)

    name = f"tile_{nv}_{nq}_{size}_{other}{'_d' if diagonal else ''}"
    return tiles.function(name, (size * nv, nq), (size * nq, other * nv))(body)


def _collocated(rates: Pointwise, size: int, nx: int) -> ca.Function:
    """phi_x stacked (size nv x nq) and the right-hand side [phi - V, phi_x PhQ, phi_theta] of `size` nodes."""
    nq, ne, nv = rates.n_states, rates.n_known, rates.n
    n_p, n_theta = rates.value.numel_in(2), rates.value.numel_in(3)

    def body(xq: ca.SX, e: ca.SX, p: ca.SX, theta: ca.SX, V: ca.SX, PhQ: ca.SX) -> tuple[ca.SX, ca.SX]:
        slopes, right = [], []
        for j in range(size):
            q = slice(j * nq, (j + 1) * nq)
            value, slope, by_theta = rates.value(xq[q], e[j * ne : (j + 1) * ne], p, theta)
            slopes.append(slope)
            right.append(ca.horzcat(value - V[j * nv : (j + 1) * nv], ca.mtimes(slope, PhQ[q, :]), by_theta))
        return ca.vertcat(*slopes), ca.vertcat(*right)

    shapes = [(size * nq, 1), (size * ne, 1), (n_p, 1), (n_theta, 1), (size * nv, 1), (size * nq, nx)]
    return tiles.function(f"collocated_{size}", *shapes)(body)


def _observed(rest: Pointwise, size: int) -> ca.Function:
    """h_n, its derivatives by the states (stacked size n x nh) and by theta, at `size` points."""
    nh, ne = rest.n_states, rest.n_known
    n_p, n_theta = rest.value.numel_in(2), rest.value.numel_in(3)

    def body(xh: ca.SX, e: ca.SX, p: ca.SX, theta: ca.SX) -> tuple[ca.SX, ...]:
        found = [rest.value(xh[i * nh : (i + 1) * nh], e[i * ne : (i + 1) * ne], p, theta) for i in range(size)]
        return tuple(ca.vertcat(*column) for column in zip(*found, strict=True))

    return tiles.function(f"observed_{size}", (size * nh, 1), (size * ne, 1), (n_p, 1), (n_theta, 1))(body)


@cache
def _chain(n: int, nh: int, size: int, m: int) -> ca.Function:
    """blk(slopes) moved, with the slopes stacked (size n x nh)."""

    def body(slope: ca.SX, moved: ca.SX) -> ca.SX:
        return ca.vertcat(
            *[ca.mtimes(slope[i * n : (i + 1) * n, :], moved[i * nh : (i + 1) * nh, :]) for i in range(size)]
        )

    return tiles.function(f"chain_{n}_{nh}_{size}_{m}", (size * n, nh), (size * nh, m))(body)


@cache
def _normal(rows: int, n: int) -> ca.Function:
    """[r + M_0, M_s]' W [r + M_0, M_s]: normal matrix, gradient and cost in one symmetric matrix."""

    def body(r: ca.SX, M: ca.SX, w: ca.SX) -> ca.SX:
        full = ca.horzcat(r + M[:, 0], M[:, 1:])
        return ca.mtimes((full * ca.repmat(w, 1, n)).T, full)

    return tiles.function(f"normal_{rows}_{n}", (rows, 1), (rows, n), (rows, 1))(body)


def _reduced(scale: tuple[float, ...]) -> ca.Function:
    """(step, conditioning, cost after the step) from the matrix of `_normal` and the regularisation, in units of `scale`."""
    ns = len(scale)

    def body(full: ca.SX, lam: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        S = ca.diag(ca.DM(scale))
        H, g = ca.mtimes([S, full[1:, 1:], S]), ca.mtimes(S, full[1:, 0])
        step, pivots = linear.ldl_solve(H + lam * ca.DM.eye(ns), -g)
        cost = full[0, 0] + 2 * ca.dot(g, step) + ca.dot(step, ca.mtimes(H, step))
        return ca.mtimes(S, step), (ca.mmin(pivots) - lam) / ca.mmax(pivots), ca.fmax(cost, 0)

    return tiles.function("reduced", (ns + 1, ns + 1), (1, 1))(body)
