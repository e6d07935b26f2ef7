"""The algebra of the filter as loops over matrices (MX): the same numbers as the unrolled form up to rounding.

The C that becomes of it grows with n, where that of scalars grows with its third power.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca

from observers.numerics import linear
from observers.numerics.finite import HUGE
from observers.numerics.layout import Layout
from observers.numerics.operations import straightened

LONG = 24  # rows of a root from which on GROUP of them are done before the others are copied together; of fewer, half as many
GROUP = 4


def each(body: Callable[..., Any], points: Any, *given: Any) -> Any:
    """body(x, *given) for each column x of `points` (n x N), side by side: one function, called in a loop."""
    n, count = points.shape
    layout = Layout(**{f"given{i}": value.numel() for i, value in enumerate(given)})
    x, packed = ca.MX.sym("x", n), ca.MX.sym("packed", layout.total)
    one = straightened(ca.Function("point", [x, packed], [body(x, *vars(layout.unpack(packed)).values())]))
    return one.map("points", "serial", count, [1], [])(points, ca.vertcat(*given))


def either(condition: Any, value: Any, otherwise: Any, *symbols: Any) -> Any:
    """`value` where the condition holds; only where not, `otherwise`, an expression of `symbols`, is worked out."""
    kept = ca.MX.sym("kept", *value.shape)
    this = ca.Function("this", [kept, *symbols], [kept])
    other = ca.Function("other", [kept, *symbols], [otherwise])
    return ca.Function.if_else("either", this, other)(condition, value, *symbols)


def chosen(which: Any, *matrices: Any) -> Any:
    """Number `which` of the matrices (all of one shape), without a sum over all of them."""
    symbols = [ca.MX.sym("matrix", *matrix.shape) for matrix in matrices]
    cases = [ca.Function("one", symbols, [symbol]) for symbol in symbols]
    return ca.Function.conditional("chosen", cases[:-1], cases[-1])(which, *matrices)


def square_root(A: Any, sigma: Any) -> Any:
    """The lower triangle S (n x n) with no negative entry on its diagonal, S S' = A A' + diag(sigma)^2; A (n x m), sigma (n) >= 0.

    Row by row a Householder reflection of [diag(sigma) A], which leaves of the diagonal all but one entry as it is; with sigma = 0 that is
    modified Gram-Schmidt. A row that depends on those before it gets a zero on the diagonal.
    """
    n = A.shape[0]
    columns = []
    group = GROUP if n >= LONG else GROUP // 2
    for j in range(n):
        k = j % group
        if j and k == 0:
            A = A[group:, :]
        row = A[k, :].T
        length = ca.sqrt(ca.sumsqr(row) + sigma[j] ** 2)
        along = A @ row
        inverse = ca.if_else(length > 0, 1 / length, 0)
        _, below = ca.vertsplit(along * inverse, [0, k + 1, along.numel()])
        columns.append(ca.vertcat(ca.MX.zeros(j), length, below))
        if j < n - 1:
            A = ca.mac(along * (-inverse * ca.if_else(length > 0, 1 / (length + sigma[j]), 0)), row.T, A)
    return ca.horzcat(*columns)


def halved(Sy: Any, b: Any) -> Any:
    """Sy^-1 b of a lower triangle Sy (ny x ny); b (ny x m)."""
    ny = Sy.shape[0]

    def column(x: Any, packed: Any) -> Any:
        S: Any = ca.reshape(packed, ny, ny)
        return linear.right_solve(S.T, x.T).T

    return each(column, b, ca.vec(Sy))


def solved(Sy: Any, Pxy: Any) -> Any:
    """K (n x ny) of Pxy = K Sy Sy', row by row."""
    ny = Sy.shape[0]

    def row(x: Any, packed: Any) -> Any:
        S = ca.reshape(packed, ny, ny)
        return linear.left_transposed(S, linear.right_solve(S.T, x.T)).T

    return each(row, Pxy.T, ca.vec(Sy)).T


def covariance(S: Any, dy: Any, weights: Any) -> Any:
    """That of the states and of what is seen (n x ny), of points drawn around their mean with the root S; dy as in `corrected`."""
    return S @ _slopes(dy, weights).T


def corrected(S: Any, Sy: Any, dy: Any, weights: Any, noise: Any) -> Any:
    """The root (n x n) of the covariance after a sample, S that before it, of points that lie as far from their mean to either side.

    Args:
        S: lower triangle (n x n).
        Sy: that of the innovation's covariance (ny x ny); HUGE on the diagonal: the output has nothing to add.
        dy: what is seen at the points less its mean (ny x n_points); 0 for an output that does not act.
        weights: of the points. noise: the outputs' deviations (ny).

    The points' differences across the mean make dy = d S^-1 dx + e, where e, all the rest, is noise: what remains is one sequential
    update for each output (Carlson, "Fast triangular formulation of the square root filter", AIAA Journal 11, 1973), of order n^2.
    """
    n, ny = S.shape[0], dy.shape[0]
    curved = ca.sqrt(weights[-1] / 2) * (dy[:, 1 : n + 1] + dy[:, n + 1 :])
    L = square_root(ca.horzcat(ca.sqrt(weights[0]) * dy[:, 0], curved), noise)

    def independent(column: Any, packed: Any, diagonal: Any) -> Any:
        """The same of outputs whose noises are independent."""
        L = ca.reshape(packed, ny, ny)
        found: list[Any] = []
        for i in range(ny):
            value = column[i]
            for k in range(i):
                value = value - ca.if_else(L[k, k] > 0, L[i, k] / L[k, k], 0) * found[k]
            found.append(value)
        return ca.vertcat(*[ca.if_else(diagonal[i] < HUGE, value, 0) for i, value in enumerate(found)])

    both = ca.vertcat(S, each(independent, _slopes(dy, weights), ca.vec(L), ca.diag(Sy)))
    update = _update(n, ny)
    for i in range(ny):
        both = update(both, both[n + i, :].T, L[i, i])
    return both[:n, :]


def _slopes(dy: Any, weights: Any) -> Any:
    """d (ny x n) of dy = d S^-1 dx + e."""
    n = dy.shape[1] // 2
    return ca.sqrt(weights[-1] / 2) * (dy[:, 1 : n + 1] - dy[:, n + 1 :])


def _update(n: int, ny: int) -> ca.Function:
    """update(both, d, r): the columns [S; D] ((n + ny) x n), S lower triangular, after a sample d S^-1 x + v, r the deviation of v."""
    both, d, r = ca.MX.sym("both", n + ny, n), ca.MX.sym("d", n), ca.MX.sym("r")
    columns = []
    gathered, before, known = ca.MX.zeros(ny), r**2, r
    for j in reversed(range(n)):
        column = both[j:, j]
        after = before + d[j] ** 2
        total = ca.sqrt(after)
        shrink = ca.if_else(after > 0, known / total, 1)
        slope = ca.if_else(before > 0, d[j] / (known * total), 0)
        old = ca.vertcat(0, gathered)
        columns.append(ca.vertcat(ca.MX.zeros(j), shrink * column - slope * old))
        gathered, before, known = old + d[j] * column, after, total
    return ca.Function("update", [both, d, r], [ca.horzcat(*reversed(columns))])
