"""Exact pole placement for an observer: Ackermann's formula, free of division where the pair is not observable."""

from __future__ import annotations

import casadi as ca


def observability_matrix(c: ca.SX, A: ca.SX) -> ca.SX:
    """[c; c A; ...; c A^(n-1)] (n m x n) of c (m x n) and A (n x n)."""
    rows = [c]
    for _ in range(A.shape[0] - 1):
        rows.append(ca.mtimes(rows[-1], A))
    return ca.vertcat(*rows)


def ackermann(A: ca.SX, c: ca.SX, polynomial: ca.SX, eps: ca.SX) -> tuple[ca.SX, ca.SX]:
    """(J, det O): J (n x 1) gives A - J c (c 1 x n) the roots of w as eigenvalues, where det O is large against `eps`.

    `polynomial`: w(A) (n x n), w monic of degree n.

    J = w(A) O^-1 e_n (Ackermann 1972) with O^-1 e_n = cofactors / det O, whose division is guarded:
    1 / det O becomes det O / (det O^2 + eps^2).
    """
    n = A.shape[0]
    O = ca.densify(observability_matrix(c, A))
    # Of the last row: that row of O deleted, and one column after the other.
    minors = [O[: n - 1, [j for j in range(n) if j != i]] for i in range(n)]
    cofactors = ca.vertcat(*[(-1) ** (n - 1 + i) * ca.det(minor) if n > 1 else 1 for i, minor in enumerate(minors)])
    determinant = ca.dot(O[n - 1, :].T, cofactors)
    guarded = determinant / (determinant**2 + eps**2)
    return ca.mtimes(polynomial, cofactors * guarded), determinant
