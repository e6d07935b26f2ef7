"""The rates of a segment by the unknowns: its collocation equations, linearised and solved,

    (I - blk(phi_x) PsQ) sol = [phi - V, 0, phi_theta] + blk(phi_x) PhQ RG.

By nodes, the matrix is full. By rates it is as sparse as the model: a state's polynomial follows from its own rate, and phi_x says which
rates see it; with many states most of its tiles, a rate's values at all nodes by another's, are zero.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from observers.numerics import tiles
from observers.numerics.semilinear import Split
from observers.pseudospectral.window import groups
from observers.pseudospectral.window.along import Along, affine
from observers.pseudospectral.window.problem import LeastSquares

SPARSE = 0.6  # part of the tiles, elimination's included, from which on they are full


def are_sparse(split: Split, x: Any, order: int) -> bool:
    """Whether tiles by rates are to be had, few enough of them; x: the symbols of phi."""
    seen = np.array(ca.DM(ca.jacobian_sparsity(split.phi, x)).full()) != 0
    return order <= tiles.TILE and _pays(seen[:, split.states], _follows(split))


def solved_rates(problem: LeastSquares, kind: Any, at: Along, RG: Any) -> tuple[list[Any], Any]:
    """sol, d V / d [1; s], in groups of rows; and the algebraic variables at the nodes."""
    rates, s = problem.rates, problem.segment
    if rates.n == 0:
        return [], at.Z
    if kind is ca.MX and s.order <= tiles.TILE and _pays(_sees(problem), _follows(s.split)):
        return _by_rates(problem, at, RG)
    return _by_nodes(problem, kind, at, RG)


def _follows(split: Split) -> np.ndarray:
    """Which of the states that phi depends on follow from which rates, by the linear part (nq x nv)."""
    reached = split.E != 0
    for _ in range(len(split.A)):
        reached = reached | ((split.A != 0).astype(int) @ reached > 0)
    return np.asarray(reached[split.states])


def _sees(problem: LeastSquares) -> np.ndarray:
    """Which rates depend on which states (nv x nq)."""
    slope = groups.collocated_at(problem.rates).sparsity_out(0)
    return np.array(ca.DM(slope).full()) != 0


def _pays(sees: np.ndarray, follows: np.ndarray) -> bool:
    full = sees.astype(int) @ follows + np.eye(len(sees), dtype=int) > 0
    order = _order(full)
    filled = full[np.ix_(order, order)]
    for k in range(len(filled)):
        filled[k + 1 :, k + 1 :] |= np.outer(filled[k + 1 :, k], filled[k, k + 1 :])
    return bool(len(filled) and filled.mean() <= SPARSE)


def _by_rates(problem: LeastSquares, at: Along, RG: Any) -> tuple[list[Any], Any]:
    """Rates as tiles, only those that are not zero."""
    rates, s = problem.rates, problem.segment
    N, nq, nv, ne, nz, n = s.order, rates.n_states, rates.n, rates.n_known, rates.n_algebraic, RG.shape[1]
    PhQ, PsQ = s.at(s.node_times[1:], s.split.states)
    xq = affine(ca.MX, PhQ, at.xs, PsQ, at.V, at.known.forced)
    one = groups.collocated_at(rates)
    found = [
        one(
            xq[j * nq : (j + 1) * nq],
            at.known.known[j * ne : (j + 1) * ne],
            at.p,
            at.theta,
            at.Z[j * nz : (j + 1) * nz],
            at.V[j * nv : (j + 1) * nv],
        )
        for j in range(N)
    ]
    pattern = one.sparsity_out(0)
    entries = {(int(i), int(q)): place for place, (i, q) in enumerate(zip(*pattern.get_triplet(), strict=True))}
    slopes = ca.horzcat(*[f[0].nz[:] for f in found]).T  # (N x entries)
    gap = ca.horzcat(*[f[1] for f in found]).T  # (N x nv)
    by_theta = [ca.horzcat(*[f[2][:, i] for f in found]).T for i in range(problem.n_theta)]
    direct = problem.direct(s.held(s.node_times[1:], s.split.states))
    moved = []
    for q in range(nq):
        few = [int(i) for i in np.flatnonzero(np.any(PhQ[q::nq] != 0, axis=0))]
        own = ca.DM.zeros(N, n) if direct is None else ca.DM(direct[q::nq])
        moved.append(tiles.multiply_add(N, len(few), n, 1.0)(own, ca.DM(PhQ[q::nq, few]), RG[few, :]))
    follows = _follows(s.split)
    between, after = ca.MX(N, n - 1 - problem.n_theta - problem.n_noise), ca.MX(N, problem.n_noise)
    b: list[Any] = [
        ca.densify(ca.horzcat(gap[:, i], between, *[part[:, i] for part in by_theta], after)) for i in range(nv)
    ]
    zero, one_tile = ca.DM.zeros(N, N), ca.densify(ca.DM.eye(N))
    A: list[list[Any]] = [[one_tile if i == k else None for k in range(nv)] for i in range(nv)]
    for (i, q), place in entries.items():
        slope = slopes[:, place]
        b[i] = groups.scaled_add(N, n, 1.0)(b[i], slope, moved[q])
        for k in np.flatnonzero(follows[q]):
            before = A[i][k] if A[i][k] is not None else zero
            A[i][k] = groups.scaled_add(N, N, -1.0)(before, slope, ca.DM(PsQ[q::nq, k::nv]))
    order = _order(np.array([[tile is not None for tile in row] for row in A]))
    solved = tiles.solve_tiles([[A[i][k] for k in order] for i in order], [b[i] for i in order])
    by_rate = ca.vertcat(*[solved[order.index(i)] for i in range(nv)])
    by_node = [i * N + j for j in range(N) for i in range(nv)]
    return [by_rate[by_node, :]], ca.vertcat(*[f[3] for f in found])


def _order(full: np.ndarray) -> list[int]:
    """The order of elimination in which few of the tiles that are zero become full (approximate minimum degree)."""
    either = ca.sparsify(ca.DM((full | full.T).astype(float)))
    return [int(i) for i in either.sparsity().amd()]


def _by_nodes(problem: LeastSquares, kind: Any, at: Along, RG: Any) -> tuple[list[Any], Any]:
    """Groups of nodes as tiles, all of them full."""
    rates, s = problem.rates, problem.segment
    PhQ, PsQ = s.at(s.node_times[1:], s.split.states)
    sizes = [s.order] if kind is ca.SX else tiles.sizes(s.order, max(1, tiles.TILE // rates.n))
    nq, nv, ne, nz = rates.n_states, rates.n, rates.n_known, rates.n_algebraic
    collocated = {size: groups.collocated(rates, size, RG.shape[1], problem.n_noise) for size in set(sizes)}
    direct = problem.direct(s.held(s.node_times[1:], s.split.states))
    A: list[list[Any]] = []
    b: list[Any] = []
    z_new: list[Any] = []
    first = 0

    def rows(vector: Any, size: int, each: int) -> Any:
        return vector[first * each : (first + size) * each]

    for size in sizes:
        q = slice(first * nq, (first + size) * nq)
        xq = affine(kind, PhQ[q], at.xs, PsQ[q], at.V, rows(at.known.forced, size, nq))
        moved = ca.mtimes(kind(ca.DM(PhQ[q])), RG)
        if direct is not None:
            moved = moved + ca.DM(direct[q])
        known = rows(at.known.known, size, ne)
        arguments = [xq, known, at.p, at.theta, rows(at.Z, size, nz), rows(at.V, size, nv), moved]
        slope, right, z = collocated[size](*arguments)
        row, column, pattern = [], 0, tuple(slope.sparsity().compress())
        for other in sizes:
            c = slice(column * nv, (column + other) * nv)
            row.append(groups.tile(nv, nq, size, other, first == column, pattern)(slope, kind(ca.DM(PsQ[q, c]))))
            column += other
        A.append(row)
        b.append(right)
        z_new.append(z)
        first += size
    if nv > tiles.TILE and kind is ca.MX:
        return [tiles.solve(ca.blockcat(A), ca.vertcat(*b))[0]], ca.vertcat(*z_new)
    return tiles.solve_tiles(A, b), ca.vertcat(*z_new)
