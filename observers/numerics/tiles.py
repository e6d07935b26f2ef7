"""Dense kernels as functions of scalars, each existing once for each shape, and an LU factorisation by tiles made of them.

However many tiles there are, the generated C holds each kernel once. Large products are loops over matrices (MX).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

import casadi as ca

from observers.numerics import linear

TILE = 10  # rows of a tile
MANY = 8  # unknowns up to which dense algebra is written out in scalars: its C grows with their third power
LOOPED, LONG = 1000, 250  # multiplications beyond which a product of tiles, of a tile and a column, is a loop


def sizes(total: int, each: int) -> list[int]:
    """`total` in groups of `each` and a last one of what is left."""
    return [each] * (total // each) + ([total % each] if total % each else [])


def kind(unknowns: int) -> Any:
    """Of expressions of dense algebra in so many unknowns: SX while they are few, MX beyond, for `solve` and products in loops."""
    return ca.SX if unknowns <= MANY else ca.MX


def solve(A: Any, b: Any) -> tuple[Any, Any]:
    """(A^-1 b, pivots) of MX or numbers, by LU without pivoting on tiles: for A symmetric positive definite or near the identity."""
    n = A.shape[0]
    # Equal tiles, where n allows them, need fewer kernels.
    each = next((rows for rows in (8, 10, 9, 7, 6) if n % rows == 0), TILE)
    offsets = [0]
    for rows in sizes(n, each):
        offsets.append(offsets[-1] + rows)
    grid = [list(row) for row in ca.blocksplit(ca.densify(A), offsets, offsets)]
    solved = solve_tiles(grid, list(ca.vertsplit(ca.densify(b), offsets)))
    return ca.vertcat(*solved), ca.vertcat(*[ca.diag(grid[k][k]) for k in range(len(grid))])


def solve_tiles(A: list[list[Any]], b: list[Any]) -> list[Any]:
    """LU without pivoting on a square grid of tiles (one tile: plain LU). None is a tile of zeros; what stays zero is not computed."""
    n, m = len(A), b[0].shape[1]
    rows = [tile.shape[0] for tile in b]

    def kept(k: int, lines: Iterable[Any]) -> list[int]:
        return [j for j, tile in enumerate(lines) if j > k and tile is not None]

    for k in range(n):
        A[k][k] = _factor(rows[k])(A[k][k])
        right = kept(k, A[k])
        for j in right:
            A[k][j] = _forward(rows[k], rows[j])(A[k][k], A[k][j])
        b[k] = _forward(rows[k], m)(A[k][k], b[k])
        for i in kept(k, [row[k] for row in A]):
            A[i][k] = _right(rows[i], rows[k])(A[k][k], A[i][k])
            for j in right:
                before = A[i][j] if A[i][j] is not None else ca.DM.zeros(rows[i], rows[j])
                A[i][j] = multiply_add(rows[i], rows[k], rows[j], -1.0)(before, A[i][k], A[k][j])
            b[i] = multiply_add(rows[i], rows[k], m, -1.0)(b[i], A[i][k], b[k])
    for k in reversed(range(n)):
        for j in kept(k, A[k]):
            b[k] = multiply_add(rows[k], rows[j], m, -1.0)(b[k], A[k][j], b[j])
        b[k] = _backward(rows[k], m)(A[k][k], b[k])
    return b


def function(name: str, *shapes: tuple[int, int], kind: Any = ca.SX) -> Callable[[Callable[..., Any]], ca.Function]:
    def build(body: Callable[..., Any]) -> ca.Function:
        arguments = [kind.sym(f"a{i}", *shape) for i, shape in enumerate(shapes)]
        result = body(*arguments)
        return ca.Function(name, arguments, list(result) if isinstance(result, tuple) else [result])

    return build


@cache
def multiply_add(n: int, k: int, m: int, sign: float) -> ca.Function:
    name, shapes = f"gemm_{n}_{k}_{m}{'' if sign > 0 else '_sub'}", ((n, m), (n, k), (k, m))
    if n * k * m > LOOPED:
        return function(name, *shapes, kind=ca.MX)(lambda c, a, b: ca.mac(a if sign > 0 else -a, b, c))
    return function(name, *shapes)(lambda c, a, b: c + ca.mtimes(a, b) if sign > 0 else c - ca.mtimes(a, b))


@cache
def product(n: int, m: int) -> ca.Function:
    return function(f"gemv_{n}_{m}", (n, m), (m, 1), kind=ca.MX if n * m > LONG else ca.SX)(ca.mtimes)


@cache
def _factor(n: int) -> ca.Function:
    return function(f"getrf_{n}", (n, n))(linear.lu_factor)


@cache
def _forward(n: int, m: int) -> ca.Function:
    return function(f"forward_{n}_{m}", (n, n), (n, m))(linear.forward)


@cache
def _backward(n: int, m: int) -> ca.Function:
    return function(f"backward_{n}_{m}", (n, n), (n, m))(linear.backward)


@cache
def _right(m: int, n: int) -> ca.Function:
    return function(f"right_{m}_{n}", (n, n), (m, n))(linear.right_solve)
