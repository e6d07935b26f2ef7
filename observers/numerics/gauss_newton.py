"""One Gauss-Newton step of the windowed least-squares problem, condensed to the unknowns s = [x0; theta].

For the rates V and s, with X_Q = PhQ x0 + PsQ V + CQ the states that phi depends on:

    (I - blk(phi_x) PsQ) sol = [phi - V, phi_x PhQ, phi_theta]      dV = sol [1; ds]
    M = d h / d [1; s] at the measured points                        r = h - y
    (sum w M'M + lam I) ds = -sum w M'(r + M_0)

Points and nodes are worked on in groups, each by one function of scalars (SX). One group for all nodes while the problem is small: then the whole
step is one straight-line function. Beyond, groups of about `TILE` rows, and an LU by tiles, so that the code does not grow with N^3.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from observers.numerics import linear
from observers.numerics.collocation import Window
from observers.numerics.exact import product
from observers.numerics.pointwise import Pointwise
from observers.numerics.semilinear import Split

SMALL = 24  # rows of the collocation matrix up to which the step is one straight-line function
SMALL_POINTS = 2000  # entries of the measured points' matrix up to which it is
TILE = 10  # rows of a tile beyond


@dataclass(frozen=True)
class LeastSquares:
    """The constant data of the problem: a window, its rates phi, and outputs h = C x + D u + h_n(x_H, ...) measured at `points`.

    `points` are times [s] since the window's start; `scale` (ns) the nominal values of s = [x0; theta]; `rate_scale` (nv) those of V.
    """

    window: Window
    rates: Pointwise
    output: Split
    output_rest: Pointwise
    points: np.ndarray
    scale: np.ndarray
    rate_scale: np.ndarray
    n_parameters: int
    n_theta: int

    @property
    def nx(self) -> int:
        return len(self.window.split.A)

    @property
    def ny(self) -> int:
        return len(self.output.A)

    @property
    def n_rates(self) -> int:
        """Length of V: N nv."""
        return self.window.order * self.rates.n

    @property
    def is_small(self) -> bool:
        return self.n_rates <= SMALL and self.ny * len(self.points) * self.n_rates <= SMALL_POINTS


def sizes(total: int, each: int) -> list[int]:
    """`total` in groups of `each` and a last one of what is left."""
    return [each] * (total // each) + ([total % each] if total % each else [])


def known_terms(problem: LeastSquares) -> tuple[ca.Function, list[int]]:
    """(Function known(t_start, U, p) -> data, the lengths of its four parts): everything that stays fixed within a sample.

    The parts of `data`: forced response of the Q states at the nodes (nq N), known terms of phi at the nodes (ne N), C Xi U + D u at the points
    (ny m), forced response and known terms of h_n at the points ((nqh + neh) m). U is the stacked inputs of the window.
    """
    w, rates, rest = problem.window, problem.rates, problem.output_rest
    nodes = w.node_times[1:]
    at_nodes, at_points = w.inputs_at(nodes), w.inputs_at(problem.points)
    nu = w.split.B.shape[1]
    count = at_nodes.shape[1]
    t, p, U = ca.MX.sym("t"), ca.MX.sym("p", problem.n_parameters), ca.MX.sym("U", count * nu)
    XiQ = w.at(nodes, w.split.states)[2]
    xi_points = w.at(problem.points)[2]
    offset = product(np.kron(np.eye(len(problem.points)), problem.output.A), xi_points) + np.kron(
        at_points, problem.output.B
    )
    XiH = w.at(problem.points, problem.output.states)[2]

    def terms(part: Pointwise, weights: np.ndarray, times: np.ndarray) -> ca.MX:
        if part.n_known == 0 or len(times) == 0:
            return ca.MX(0, 1)
        stacked = ca.MX(ca.DM(np.kron(weights, np.eye(nu)))) @ U if nu else ca.MX(0, 1)
        values = [part.known(t + float(time), stacked[i * nu : (i + 1) * nu], p) for i, time in enumerate(times)]
        return ca.vertcat(*values)

    def response(matrix: np.ndarray) -> ca.MX:
        return ca.MX(ca.DM(matrix)) @ U if matrix.size and matrix.any() else ca.MX(ca.DM.zeros(matrix.shape[0], 1))

    parts = [
        response(XiQ),
        terms(rates, at_nodes, nodes),
        response(offset),
        ca.vertcat(response(XiH), terms(rest, at_points, problem.points)),
    ]
    lengths = [part.numel() for part in parts]
    function = ca.Function("known_terms", [t, U, p], [ca.vertcat(*parts)])
    return (function.expand() if problem.is_small else function), lengths


def _split_data(
    problem: LeastSquares, data: Any, lengths: list[int]
) -> tuple[list[Any], list[Any], list[Any], list[Any], list[Any]]:
    """The data's parts by node and by point: CQ_j, e_j; offset_i, CH_i, eh_i."""
    cuts = np.cumsum([0, *lengths])
    CQ, e, offset, rest = (data[int(a) : int(b)] for a, b in zip(cuts[:-1], cuts[1:], strict=True))
    N, m = problem.window.order, len(problem.points)
    nh = problem.output_rest.n_states

    def chop(vector: Any, each: int, count: int) -> list[Any]:
        return [vector[i * each : (i + 1) * each] for i in range(count)]

    return (
        chop(CQ, problem.rates.n_states, N),
        chop(e, problem.rates.n_known, N),
        chop(offset, problem.ny, m),
        chop(rest[: nh * m], nh, m),
        chop(rest[nh * m :], problem.output_rest.n_known, m),
    )


def _rows(group: list[Any], start: int, size: int) -> Any:
    chosen = group[start : start + size]
    return ca.vertcat(*chosen)


def output_residual(problem: LeastSquares, lengths: list[int]) -> ca.Function:
    """Function residual(V, s, data, p, y) -> h(points) - y, stacked (ny m)."""
    kind = ca.SX if problem.is_small else ca.MX
    V, s, data, p, y = _symbols(problem, lengths, kind)
    return ca.Function(
        "residual",
        [V, s, data, p, y],
        [ca.vertcat(*[r for r, _ in _measured(problem, lengths, kind, V, s, data, p, y, None)])],
    )


def newton_step(problem: LeastSquares, lengths: list[int]) -> ca.Function:
    """Function newton(V, s, data, p, y, w, lam) -> (V+, s+, size, cost, conditioning).

    `size` is |scaled step|^2 (NaN or infinite if the step failed), `cost` the weighted sum of squares that the linearisation predicts
    after the step, `conditioning` in [0, 1] the smallest pivot of the scaled normal matrix over the largest.
    """
    kind = ca.SX if problem.is_small else ca.MX
    V, s, data, p, y = _symbols(problem, lengths, kind)
    w, lam = kind.sym("w", problem.ny * len(problem.points)), kind.sym("lam")
    sol = _condense(problem, lengths, kind, V, s, data, p)
    rows = _measured(problem, lengths, kind, V, s, data, p, y, sol)
    ns, nxt = problem.nx + problem.n_theta, 1 + problem.nx + problem.n_theta
    normal, start = kind(ca.DM.zeros(nxt, nxt)), 0
    for r, M in rows:
        normal = normal + _normal(M.shape[0], nxt)(r, M, w[start : start + M.shape[0]])
        start += M.shape[0]
    step, conditioning, cost = _reduced(tuple(problem.scale))(normal, lam)
    full = ca.vertcat(1, step)
    dV = ca.vertcat(*[_product(block.shape[0], nxt)(block, full) for block in sol]) if sol else kind(0, 1)
    weights = np.tile(1 / problem.rate_scale, problem.window.order) if problem.n_rates else np.zeros(0)
    size = ca.sumsqr(step / problem.scale) + (ca.sumsqr(dV * weights) if problem.n_rates else 0)
    assert step.numel() == ns
    return ca.Function("newton", [V, s, data, p, y, w, lam], [V + dV, s + step, size, cost, conditioning])


def _symbols(problem: LeastSquares, lengths: list[int], kind: Any) -> tuple[Any, ...]:
    counts = (
        problem.n_rates,
        problem.nx + problem.n_theta,
        sum(lengths),
        problem.n_parameters,
        problem.ny * len(problem.points),
    )
    return tuple(kind.sym(name, count) for name, count in zip(("V", "s", "data", "p", "y"), counts, strict=True))


def _condense(problem: LeastSquares, lengths: list[int], kind: Any, V: Any, s: Any, data: Any, p: Any) -> list[Any]:
    """sol, d V / d [1; s], in groups of rows."""
    rates, w = problem.rates, problem.window
    if rates.n == 0:
        return []
    PhQ, PsQ, _ = w.at(w.node_times[1:], w.split.states)
    CQ, e, *_ = _split_data(problem, data, lengths)
    groups = [w.order] if kind is ca.SX else sizes(w.order, max(1, TILE // rates.n))
    nq, nv, nx = rates.n_states, rates.n, problem.nx
    x0, theta = s[:nx], s[nx:]
    A: list[list[Any]] = []
    b: list[Any] = []
    first = 0
    for size in groups:
        q, v = slice(first * nq, (first + size) * nq), slice(first * nv, (first + size) * nv)
        xq = _affine(kind, PhQ[q], x0, PsQ[q], V, _rows(CQ, first, size))
        slope, right = _collocated(rates, size, nx)(xq, _rows(e, first, size), p, theta, V[v], kind(ca.DM(PhQ[q])))
        row, column = [], 0
        for other in groups:
            c = slice(column * nv, (column + other) * nv)
            row.append(_tile(nv, nq, size, other, first == column)(slope, kind(ca.DM(PsQ[q, c]))))
            column += other
        A.append(row)
        b.append(right)
        first += size
    return _solve_tiles(A, b)


def _measured(
    problem: LeastSquares,
    lengths: list[int],
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
    *_, offset, CH, eh = _split_data(problem, data, lengths)
    x0, theta = s[:nx], s[nx:]
    nh = rest.n_states
    out, first = [], 0
    for size in [m] if kind is ca.SX else sizes(m, max(1, TILE // ny)):
        rows, h = slice(first * ny, (first + size) * ny), slice(first * nh, (first + size) * nh)
        r = _affine(kind, CPh[rows], x0, CPs[rows], V, _rows(offset, first, size)) - y[rows]
        M = _sensitivity(kind, CPh[rows], CPs[rows], sol, problem.n_theta) if sol is not None else None
        if rest.n:
            xh = _affine(kind, PhH[h], x0, PsH[h], V, _rows(CH, first, size))
            eh_rows = _rows(eh, first, size)
            embed = ca.DM(np.kron(np.eye(size), problem.output.E))
            value, slope, by_theta = _observed(rest, size)(xh, eh_rows, p, theta)
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
        total = _multiply_add(Ph.shape[0], n, block.shape[1], 1.0)(
            total, kind(ca.DM(Ps[:, column : column + n])), block
        )
        column += n
    return total


def _solve_tiles(A: list[list[Any]], b: list[Any]) -> list[Any]:
    """LU without pivoting on a square grid of tiles (one tile: plain LU)."""
    n, m = len(A), b[0].shape[1]
    rows = [tile.shape[0] for tile in b]
    for k in range(n):
        A[k][k] = _factor(rows[k])(A[k][k])
        for j in range(k + 1, n):
            A[k][j] = _forward(rows[k], rows[j])(A[k][k], A[k][j])
        b[k] = _forward(rows[k], m)(A[k][k], b[k])
        for i in range(k + 1, n):
            A[i][k] = _right(rows[i], rows[k])(A[k][k], A[i][k])
            for j in range(k + 1, n):
                A[i][j] = _multiply_add(rows[i], rows[k], rows[j], -1.0)(A[i][j], A[i][k], A[k][j])
            b[i] = _multiply_add(rows[i], rows[k], m, -1.0)(b[i], A[i][k], b[k])
    for k in reversed(range(n)):
        for j in range(k + 1, n):
            b[k] = _multiply_add(rows[k], rows[j], m, -1.0)(b[k], A[k][j], b[j])
        b[k] = _backward(rows[k], m)(A[k][k], b[k])
    return b


# The group functions. Each exists once for each shape, so that the generated C holds each once however many tiles there are.


def _function(name: str, *shapes: tuple[int, int]) -> Callable[[Callable[..., Any]], ca.Function]:
    def build(body: Callable[..., Any]) -> ca.Function:
        arguments = [ca.SX.sym(f"a{i}", *shape) for i, shape in enumerate(shapes)]
        result = body(*arguments)
        return ca.Function(name, arguments, list(result) if isinstance(result, tuple) else [result])

    return build


@cache
def _multiply_add(n: int, k: int, m: int, sign: float) -> ca.Function:
    return _function(f"gemm_{n}_{k}_{m}{'' if sign > 0 else '_sub'}", (n, m), (n, k), (k, m))(
        lambda c, a, b: c + sign * ca.mtimes(a, b)
    )


@cache
def _product(n: int, m: int) -> ca.Function:
    return _function(f"gemv_{n}_{m}", (n, m), (m, 1))(ca.mtimes)


@cache
def _factor(n: int) -> ca.Function:
    return _function(f"getrf_{n}", (n, n))(linear.lu_factor)


@cache
def _forward(n: int, m: int) -> ca.Function:
    return _function(f"forward_{n}_{m}", (n, n), (n, m))(linear.forward)


@cache
def _backward(n: int, m: int) -> ca.Function:
    return _function(f"backward_{n}_{m}", (n, n), (n, m))(linear.backward)


@cache
def _right(m: int, n: int) -> ca.Function:
    return _function(f"right_{m}_{n}", (n, n), (m, n))(linear.right_solve)


@cache
def _tile(nv: int, nq: int, size: int, other: int, diagonal: bool) -> ca.Function:
    """-blk(phi_x) PsQ, plus the identity on the diagonal; phi_x stacked (size nv x nq)."""

    def body(slope: ca.SX, PsQ: ca.SX) -> ca.SX:
        rows = [-ca.mtimes(slope[j * nv : (j + 1) * nv, :], PsQ[j * nq : (j + 1) * nq, :]) for j in range(size)]
        return ca.vertcat(*rows) + (ca.SX(ca.DM.eye(size * nv)) if diagonal else 0)

    name = f"tile_{nv}_{nq}_{size}_{other}{'_d' if diagonal else ''}"
    return _function(name, (size * nv, nq), (size * nq, other * nv))(body)


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
    return _function(f"collocated_{size}", *shapes)(body)


def _observed(rest: Pointwise, size: int) -> ca.Function:
    """h_n, its derivatives by the states (stacked size n x nh) and by theta, at `size` points."""
    nh, ne = rest.n_states, rest.n_known
    n_p, n_theta = rest.value.numel_in(2), rest.value.numel_in(3)

    def body(xh: ca.SX, e: ca.SX, p: ca.SX, theta: ca.SX) -> tuple[ca.SX, ...]:
        found = [rest.value(xh[i * nh : (i + 1) * nh], e[i * ne : (i + 1) * ne], p, theta) for i in range(size)]
        return tuple(ca.vertcat(*column) for column in zip(*found, strict=True))

    return _function(f"observed_{size}", (size * nh, 1), (size * ne, 1), (n_p, 1), (n_theta, 1))(body)


@cache
def _chain(n: int, nh: int, size: int, m: int) -> ca.Function:
    """blk(slopes) moved, with the slopes stacked (size n x nh)."""

    def body(slope: ca.SX, moved: ca.SX) -> ca.SX:
        return ca.vertcat(
            *[ca.mtimes(slope[i * n : (i + 1) * n, :], moved[i * nh : (i + 1) * nh, :]) for i in range(size)]
        )

    return _function(f"chain_{n}_{nh}_{size}_{m}", (size * n, nh), (size * nh, m))(body)


@cache
def _normal(rows: int, n: int) -> ca.Function:
    """[r + M_0, M_s]' W [r + M_0, M_s]: normal matrix, gradient and cost in one symmetric matrix."""

    def body(r: ca.SX, M: ca.SX, w: ca.SX) -> ca.SX:
        full = ca.horzcat(r + M[:, 0], M[:, 1:])
        return ca.mtimes((full * ca.repmat(w, 1, n)).T, full)

    return _function(f"normal_{rows}_{n}", (rows, 1), (rows, n), (rows, 1))(body)


def _reduced(scale: tuple[float, ...]) -> ca.Function:
    """(step, conditioning, cost after the step) from the matrix of `_normal` and the regularisation, in units of `scale`."""
    ns = len(scale)

    def body(full: ca.SX, lam: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        S = ca.diag(ca.DM(scale))
        H, g = ca.mtimes([S, full[1:, 1:], S]), ca.mtimes(S, full[1:, 0])
        step, pivots = linear.ldl_solve(H + lam * ca.DM.eye(ns), -g)
        cost = full[0, 0] + 2 * ca.dot(g, step) + ca.dot(step, ca.mtimes(H, step))
        return ca.mtimes(S, step), ca.mmin(pivots) / ca.mmax(pivots), ca.fmax(cost, 0)

    return _function("reduced", (ns + 1, ns + 1), (1, 1))(body)
