"""Dense linear algebra unrolled into scalar CasADi expressions (SX), for small systems inside generated C.

Own code, not a library's: CasADi's solvers either do not generate C, or generate a sparse QR that costs ten times as much here.
"""

from __future__ import annotations

from functools import cache

import casadi as ca


def lu_factor(A: ca.SX) -> ca.SX:
    """L and U of A (n x n) = L U without pivoting, in one matrix (L's unit diagonal implied).

    Without pivoting: for the caller to check the result. The collocation matrix I - blk(phi_x) Psi stays near the identity for a sensible
    window (growth at most 340 in cold starts), and a breakdown shows as a non-finite step.
    """
    A = ca.densify(ca.SX(A))
    n = A.shape[0]
    a = [[A[i, j] for j in range(n)] for i in range(n)]
    for k in range(n):
        for i in range(k + 1, n):
            a[i][k] = a[i][k] / a[k][k]
            for j in range(k + 1, n):
                a[i][j] = a[i][j] - a[i][k] * a[k][j]
    return ca.vertcat(*[ca.horzcat(*row) for row in a])


def forward(LU: ca.SX, b: ca.SX) -> ca.SX:
    """L^-1 b with the unit lower triangle of `LU`; b (n x m)."""
    n = LU.shape[0]
    rows = [b[i, :] for i in range(n)]
    for i in range(n):
        for k in range(i):
            rows[i] = rows[i] - LU[i, k] * rows[k]
    return ca.vertcat(*rows)


def backward(LU: ca.SX, b: ca.SX) -> ca.SX:
    """U^-1 b with the upper triangle of `LU`; b (n x m)."""
    n = LU.shape[0]
    rows = [b[i, :] for i in range(n)]
    for i in reversed(range(n)):
        for k in range(i + 1, n):
            rows[i] = rows[i] - LU[i, k] * rows[k]
        rows[i] = rows[i] / LU[i, i]
    return ca.vertcat(*rows)


def right_solve(LU: ca.SX, b: ca.SX) -> ca.SX:
    """b U^-1 with the upper triangle of `LU`; b (m x n)."""
    n = LU.shape[0]
    columns = [b[:, j] for j in range(n)]
    for j in range(n):
        for k in range(j):
            columns[j] = columns[j] - columns[k] * LU[k, j]
        columns[j] = columns[j] / LU[j, j]
    return ca.horzcat(*columns)


def qr_solve(A: ca.SX, b: ca.SX) -> ca.SX:
    """A^-1 b by Givens rotations, stable for every regular A (n x n); b (n x m)."""
    R, rotated = givens(A, b)
    return backward(R, rotated)


def givens(A: ca.SX, b: ca.SX) -> tuple[ca.SX, ca.SX]:
    """(R, Q'b) of A = Q R (n x n) by Givens rotations, so that det A is the product of R's diagonal; b (n x m)."""
    n = A.shape[0]
    rows = [ca.densify(ca.horzcat(A[i, :], b[i, :])) for i in range(n)]
    for j in range(n):
        for i in range(j + 1, n):
            radius = ca.sqrt(rows[j][j] ** 2 + rows[i][j] ** 2)
            regular = radius > 0
            c = ca.if_else(regular, rows[j][j] / radius, 1)
            s = ca.if_else(regular, rows[i][j] / radius, 0)
            rows[j], rows[i] = c * rows[j] + s * rows[i], c * rows[i] - s * rows[j]
    R = ca.vertcat(*rows)
    return R[:, :n], R[:, n:]


def ldl_solve(H: ca.SX, b: ca.SX) -> tuple[ca.SX, ca.SX]:
    """(H^-1 b, pivots) of a symmetric positive definite H (n x n) by L D L'; b (n x m).

    The pivots (n x 1) tell how near H is to singular.
    """
    H = ca.densify(ca.SX(H))
    n = H.shape[0]
    L = [[ca.SX(0)] * n for _ in range(n)]
    d: list[ca.SX] = []
    for j in range(n):
        pivot = H[j, j]
        for k in range(j):
            pivot = pivot - L[j][k] ** 2 * d[k]
        d.append(pivot)
        for i in range(j + 1, n):
            entry = H[i, j]
            for k in range(j):
                entry = entry - L[i][k] * L[j][k] * d[k]
            L[i][j] = entry / pivot
    x = [b[i, :] for i in range(n)]
    for i in range(n):
        for k in range(i):
            x[i] = x[i] - L[i][k] * x[k]
    x = [x[i] / d[i] for i in range(n)]
    for i in reversed(range(n)):
        for k in range(i + 1, n):
            x[i] = x[i] - L[k][i] * x[k]
    return ca.vertcat(*x), ca.vertcat(*d)


def left_transposed(L: ca.SX, b: ca.SX) -> ca.SX:
    """b L^-1 with the lower triangle of `L`; b (m x n)."""
    n = L.shape[0]
    columns = [b[:, j] for j in range(n)]
    for j in reversed(range(n)):
        for k in range(j + 1, n):
            columns[j] = columns[j] - columns[k] * L[k, j]
        columns[j] = columns[j] / L[j, j]
    return ca.horzcat(*columns)


def square_root(A: ca.SX) -> ca.SX:
    """The lower triangle S (n x n), S S' = A A', of A (n x m), m >= n, by modified Gram-Schmidt on the rows: the R of a QR of A'.

    A row that depends on those before it gets a zero diagonal entry, not a division by zero.
    """
    n = A.shape[0]
    rows = [A[i, :] for i in range(n)]
    S = [[ca.SX(0)] * n for _ in range(n)]
    for j in range(n):
        length = ca.sqrt(ca.dot(rows[j], rows[j]))
        S[j][j] = length
        unit = rows[j] / ca.if_else(length > 0, length, 1)
        for i in range(j + 1, n):
            S[i][j] = ca.dot(rows[i], unit)
            rows[i] = rows[i] - S[i][j] * unit
    return ca.vertcat(*[ca.horzcat(*row) for row in S])


def inverse(A: ca.SX) -> ca.SX:
    """A^-1 (n x n) by elimination without pivoting, see `lu_factor`."""
    LU = lu_factor(A)
    return backward(LU, forward(LU, ca.SX.eye(A.shape[0])))


@cache
def solver(n: int, m: int) -> ca.Function:
    """solver(A, B) -> A^-1 B for a symmetric positive definite A (n x n), which needs no pivots; B (n x m)."""
    A, B = ca.SX.sym("A", n, n), ca.SX.sym("B", n, m)
    LU = lu_factor(A)
    return ca.Function("solver", [A, B], [backward(LU, forward(LU, B))])
