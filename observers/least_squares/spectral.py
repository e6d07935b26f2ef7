"""Upper bounds of spectral norms in generated code, where there is no eigenvalue solver."""

from __future__ import annotations

from typing import Any

import casadi as ca

from observers.numerics.riccati import symmetric

SQUARINGS = 10  # the bound is above the norm by a factor of at most n^(1 / 2^(SQUARINGS + 1)): 3e-4 for n = 2, 1.7e-3 for n = 30


def norm_bound(n: int) -> ca.Function:
    """bound(X) -> b with |X|_2 <= b <= n^(1 / 2^(SQUARINGS + 1)) |X|_2, for X (n x n).

    |X|^2 is the largest eigenvalue of G = X'X, and lmax(G)^k <= tr(G^k) <= n lmax(G)^k with k = 2^SQUARINGS. Each square is divided by its
    trace, whose logarithm is kept, so that nothing overflows.
    """
    X = ca.MX.sym("X", n, n)
    G, logarithm = _scaled(symmetric(X.T @ X))
    for _ in range(SQUARINGS):
        G, more = _scaled(symmetric(G @ G))
        logarithm = 2 * logarithm + more
    bound = ca.exp(logarithm / 2 ** (SQUARINGS + 1))
    return ca.Function("norm_bound", [X], [ca.if_else(ca.sumsqr(X) > 0, bound, 0)])


def _scaled(G: Any) -> tuple[Any, Any]:
    trace = ca.trace(G)
    return G / trace, ca.log(trace)
