"""A covariance between samples, Q' = A Q + Q A' + W over a step h, A and W held.

    Q(h) = Q + h (B + h/2 L(B + h/3 L(B + ...))),  L(X) = A X + X A',  B = L(Q) + W

X is symmetric, so that X A' alone makes L(X): dense times sparse, as many multiplications as A has entries, times n. How many terms there
are depends on h |A|. Where that is large the series gives way to `riccati.propagator`, which doubles a short step.
"""

from __future__ import annotations

import math
from typing import Any

import casadi as ca

from observers.numerics.riccati import propagator, symmetric

TERMS = (4, 6, 9, 12, 16)
FEW = (9, 16)  # unrolled, where each of them is code of its own
EXACT = 1e-16  # of h W, which is the smaller part: what the first term that is left out makes of it
UNROLLED = 120  # multiplications of a term up to which it is unrolled into scalars
SPARSE = (
    0.75  # of n^2, entries of A up to which its zeros are left out: a product of dense matrices takes less for each
)


def longest(terms: int) -> float:
    """2 h |A| up to which so many terms are exact."""
    return math.exp((math.log(EXACT) + math.lgamma(terms + 2)) / terms)


def covariance_step(pattern: ca.Sparsity) -> ca.Function:
    """step(Q, A, W, h) -> Q(h); n x n, `pattern` A's, Q and W symmetric. Relative to the largest entry at most 1e-15 off."""
    n = pattern.size1()
    if pattern.nnz() > SPARSE * n**2:
        pattern = ca.Sparsity.dense(n, n)
    A, Q, W, h = ca.MX.sym("A", pattern), ca.MX.sym("Q", n, n), ca.MX.sym("W", n, n), ca.MX.sym("h")
    Phi, Wd = propagator(n)(ca.densify(A), W, h)
    doubled = ca.Function("doubled", [Q, A, W, h], [symmetric(Wd + Phi @ Q @ Phi.T)])
    numbers = FEW if _unrolled(pattern) else TERMS
    cases = [_series(pattern, terms) for terms in numbers]
    chosen = ca.Function.conditional("covariance", cases, doubled)
    size = 2 * h * ca.sqrt(_largest_sum(A, columns=True) * _largest_sum(A, columns=False))
    which = sum((size > longest(terms) for terms in numbers), ca.MX(0))  # NaN: the first
    return ca.Function("covariance_step", [Q, A, W, h], [chosen(which, Q, A, W, h)])


def _series(pattern: ca.Sparsity, terms: int) -> ca.Function:
    n = pattern.size1()
    unrolled = _unrolled(pattern)
    sym: Any = ca.SX.sym if unrolled else ca.MX.sym
    Q, A, W, h = sym("Q", n, n), sym("A", pattern), sym("W", n, n), sym("h")
    twice = _mirrored if unrolled else _doubled
    B = twice(ca.mac(Q, A.T, W / 2))
    R, transposed = B, (h * A).T
    for j in range(terms, 1, -1):
        R = twice(ca.mac(R, transposed / j, B / 2))
    return ca.Function(f"series_{terms}", [Q, A, W, h], [Q + h * R])


def _unrolled(pattern: ca.Sparsity) -> bool:
    return bool(pattern.nnz() * pattern.size1() <= UNROLLED)


def _doubled(X: Any) -> Any:
    return X + X.T


def _mirrored(X: Any) -> Any:
    """X + X' of scalars, each sum once."""
    upper = ca.triu(X + X.T)
    return ca.triu2symm(upper)


def _largest_sum(A: Any, columns: bool) -> Any:
    """The norm of A (n x n) for 1 (`columns`) or for infinity."""
    return ca.mmax(ca.sum1(ca.fabs(A)) if columns else ca.sum2(ca.fabs(A)))
