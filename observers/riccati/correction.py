"""The exact correction of a Gaussian (m, Q) by a sample, in the form of Joseph."""

from __future__ import annotations

from functools import cache

import casadi as ca

from observers.numerics import linear
from observers.numerics.riccati import symmetric


@cache
def correction(n: int, ny: int) -> ca.Function:
    """correction(m, Q, C, r, Rd, valid) -> (m, Q, r' S^-1 r) after a sample with innovation r = C e + v, v of covariance Rd.

    m (n), Q (n x n), C (ny x n), r (ny), Rd (ny x ny); valid (ny): 0 takes an entry of the sample out, as if it were not there. Q stays
    symmetric positive semidefinite whatever the gain's rounding (Joseph). For one output, scalars; for more, LU of C Q C' + Rd > 0.
    """
    m, Q, C, r, Rd, valid = (
        ca.MX.sym(*shape) for shape in (("m", n), ("Q", n, n), ("C", ny, n), ("r", ny), ("Rd", ny, ny), ("valid", ny))
    )
    keep = ca.diag(valid)
    C_valid = keep @ C
    Rd_valid = keep @ Rd @ keep + ca.diag(1 - valid)
    QC = Q @ C_valid.T
    solved = linear.solver(ny, n + 1)(symmetric(C_valid @ QC + Rd_valid), ca.horzcat(QC.T, valid * r))
    K = solved[:, :n].T
    L = ca.MX.eye(n) - K @ C_valid
    m_after = m + K @ (valid * r)
    Q_after = symmetric(L @ Q @ L.T + K @ Rd_valid @ K.T)
    return ca.Function("correction", [m, Q, C, r, Rd, valid], [m_after, Q_after, ca.dot(valid * r, solved[:, n])])
