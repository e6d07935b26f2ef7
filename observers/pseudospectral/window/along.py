"""A segment's trajectory as an affine function of its first state and its rates, and the outputs along it, with their derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from observers.numerics import tiles
from observers.numerics.exact import product
from observers.pseudospectral.window import groups
from observers.pseudospectral.window.problem import LeastSquares

ZEROS = 0.25  # part of a constant matrix up to which only what is not zero is multiplied


@dataclass(frozen=True)
class Along:
    """A segment's trajectory, and what is known of it, unpacked: what its rates and outputs are functions of. `jump` (nt) is what theta
    moves by at its end, where the outputs see it.
    """

    xs: Any
    V: Any
    Z: Any
    theta: Any
    known: SimpleNamespace
    p: Any
    jump: Any = None


def measured(
    problem: LeastSquares, j: int, at: Along, y: Any, by: tuple[Any, list[Any]] | None = None
) -> list[tuple[Any, Any]]:
    """(r, M) by groups of measured points: residual h - y and, where `by` = (RG, sol) is given, its derivative with respect to [1; s]."""
    rest, ny, points, kind = problem.output_rest, problem.ny, problem.points_of(j), type(at.xs)
    m, s = len(points), problem.segment
    Ph, Ps = s.at(points)
    C = np.kron(np.eye(m), problem.output.A)
    CPh, CPs = product(C, Ph), product(C, Ps)
    PhH, PsH = s.at(points, problem.output.states)
    nh, ne, nz = rest.n_states, rest.n_known, rest.n_algebraic
    z = ca.mtimes(kind(ca.DM(np.kron(s.from_nodes(points), np.eye(nz)))), at.Z) if nz else kind(0, 1)
    held, held_output = (
        problem.direct(problem.observed_noise(points)),
        problem.direct(s.held(points, problem.output.states)),
    )
    sizes = [m] if kind is ca.SX else tiles.sizes(m, max(1, tiles.TILE // ny))
    if at.jump is not None and m:
        sizes = [*sizes[:-1], *([sizes[-1] - 1] if sizes[-1] > 1 else []), 1]
    observed = {size: groups.observed(rest, size) for size in set(sizes)} if rest.n else {}
    out, first = [], 0
    for size in sizes:
        rows, h = slice(first * ny, (first + size) * ny), slice(first * nh, (first + size) * nh)
        r = affine(kind, CPh[rows], at.xs, CPs[rows], at.V, at.known.offset[rows]) - y[rows]
        M = sensitivity(kind, CPh[rows], CPs[rows], *by, None if held is None else held[rows]) if by else None
        if rest.n:
            xh = affine(kind, PhH[h], at.xs, PsH[h], at.V, at.known.forced_output[h])
            eh = at.known.known_output[first * ne : (first + size) * ne]
            embed = ca.DM(np.kron(np.eye(size), problem.output.E))
            jumped = at.jump is not None and first + size == m
            theta = at.theta + at.jump if jumped else at.theta
            value, slope, by_theta = observed[size](xh, eh, at.p, theta, z[first * nz : (first + size) * nz])
            r = r + ca.mtimes(embed, value)
            if by:
                moved = sensitivity(kind, PhH[h], PsH[h], *by, None if held_output is None else held_output[h])
                M = M + ca.mtimes(embed, groups.chain(rest.n, nh, size, moved.shape[1])(slope, moved))
                if problem.n_theta:
                    own = ca.mtimes(embed, by_theta)
                    columns = [kind(ca.DM.zeros(size * ny, 1 + problem.nx)), own]
                    if problem.n_noise:
                        columns.append(kind(ca.DM.zeros(size * ny, len(problem.noisy_states))))
                        jumps = own[:, list(problem.noisy_parameters)]
                        columns.append(jumps if jumped else kind(ca.DM.zeros(*jumps.shape)))
                    M = M + ca.horzcat(*columns)
        out.append((r, M))
        first += size
    return out


def path(problem: LeastSquares, j: int, at: Along, by: tuple[Any, list[Any]]) -> tuple[Any, Any]:
    """The path constraints at the nodes and samples of segment j, and their derivatives, `by` as for `measured`; theta is that before
    a jump at the end."""
    kind = type(at.xs)
    if problem.path is None:
        return kind(0, 1), kind(0, by[0].shape[1])
    known = SimpleNamespace(
        offset=at.known.path_offset, forced_output=at.known.path_forced, known_output=at.known.path_known
    )
    limits = kind(ca.DM.zeros(known.offset.numel()))
    rows = measured(problem.path, j, replace(at, known=known, jump=None), limits, by)
    values, derivatives = (ca.vertcat(*column) for column in zip(*rows, strict=True))
    return values, derivatives


def affine(kind: Any, Ph: np.ndarray, xs: Any, Ps: np.ndarray, V: Any, offset: Any) -> Any:
    return ca.mtimes(constant(kind, Ph), xs) + ca.mtimes(constant(kind, Ps), V) + offset


def constant(kind: Any, matrix: np.ndarray) -> Any:
    """`matrix` for products with what is not constant: its zeros left out where that saves work."""
    return kind(ca.sparsify(ca.DM(matrix)) if _mostly_zero(matrix) else ca.DM(matrix))


def _mostly_zero(matrix: np.ndarray) -> bool:
    return bool(np.count_nonzero(matrix) < ZEROS * matrix.size)


def _by_rows(matrix: np.ndarray, X: Any) -> Any:
    """matrix X: rows that are not zero in the same columns are one dense product of these."""
    groups_of: dict[tuple[int, ...], list[int]] = {}
    for i, row in enumerate(matrix):
        groups_of.setdefault(tuple(int(j) for j in np.flatnonzero(row)), []).append(i)
    parts, order = [], []
    for columns, rows in groups_of.items():
        zero = ca.DM.zeros(len(rows), X.shape[1])
        few = ca.DM(matrix[np.ix_(rows, columns)])
        parts.append(tiles.multiply_add(len(rows), len(columns), X.shape[1], 1.0)(zero, few, X[list(columns), :]))
        order += rows
    return ca.vertcat(*parts)[list(np.argsort(order)), :]


def sensitivity(
    kind: Any, Ph: np.ndarray, Ps: np.ndarray, RG: Any, sol: list[Any], direct: np.ndarray | None = None
) -> Any:
    """Ph RG + Ps sol + what the noise does directly: d x(points) / d [1; x0; theta; noise]."""
    total: Any
    if len(sol) == 1 and kind is ca.MX and _mostly_zero(Ps):
        total = _by_rows(np.hstack([Ph, Ps]), ca.vertcat(RG, sol[0]))
        return total if direct is None else total + ca.DM(direct)
    total = ca.mtimes(constant(kind, Ph), RG)
    column = 0
    for block in sol:
        n = block.shape[0]
        total = tiles.multiply_add(Ph.shape[0], n, block.shape[1], 1.0)(
            total, kind(ca.DM(Ps[:, column : column + n])), block
        )
        column += n
    return total if direct is None else total + ca.DM(direct)
