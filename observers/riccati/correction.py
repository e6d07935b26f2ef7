"""The exact correction of a Gaussian (m, Q) by a sample, in the form of Joseph."""

from __future__ import annotations

from functools import cache

import casadi as ca

from observers.numerics import linear
from observers.numerics.riccati import symmetric

UNROLLED = 6  # states up to which the products are unrolled into scalars


@cache
def correction(n: int, ny: int) -> ca.Function:
    """correction(m, Q, QC, C, r, Rd, valid) -> (m, Q, r' S^-1 r) after a sample with innovation r = C e + v, v of covariance Rd.

    m (n), Q (n x n), QC = Q C' (n x ny), C (ny x n), r (ny), Rd (ny x ny); valid (ny): 0 takes an entry of the sample out, as if it were
    not there. Q stays symmetric positive semidefinite whatever the gain's rounding (Joseph): (I - K C) Q (I - K C)' + K Rd K', a matrix
    of rank ny after the other. For one output, scalars; for more, LU of C Q C' + Rd > 0.
    """
    m, Q, QC, C, r, Rd, valid = (
        ca.MX.sym(*shape)
        for shape in (("m", n), ("Q", n, n), ("QC", n, ny), ("C", ny, n), ("r", ny), ("Rd", ny, ny), ("valid", ny))
    )
    keep = ca.diag(valid)
    QC_valid, transposed = QC @ keep, (keep @ C).T
    Rd_valid = keep @ Rd @ keep + ca.diag(1 - valid)
    S = symmetric(transposed.T @ QC_valid + Rd_valid)
    solved = linear.solver(ny, n + 1)(S, ca.horzcat(QC_valid.T, valid * r))
    K = solved[:, :n].T
    once = ca.mac(-K, QC_valid.T, Q)
    both = ca.mac(K @ Rd_valid - once @ transposed, K.T, once)
    made = ca.Function(
        "correction",
        [m, Q, QC, C, r, Rd, valid],
        [m + K @ (valid * r), symmetric(both), ca.dot(valid * r, solved[:, n])],
    )
    return made.expand() if n <= UNROLLED else made
