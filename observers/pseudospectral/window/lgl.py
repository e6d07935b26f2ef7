"""Legendre-Gauss-Lobatto collocation on [-1, 1]: nodes, weights, differentiation and interpolation (Gong, Ross & Kang 2007, (12)-(15)).

The functions that end in `_exact` return arrays of Arb numbers, the others doubles.
"""

from __future__ import annotations

import numpy as np
from flint import arb
from numpy.polynomial import legendre

from observers.numerics.exact import in_high_precision, rounded

COINCIDENT = 1e-13  # points closer to a node than this are that node
NEWTON_STEPS = 5  # from the 1e-14 of a companion matrix' eigenvalues to far below 1e-50


@in_high_precision
def nodes_exact(order: int) -> np.ndarray:
    """The order + 1 nodes, ascending: -1, 1 and the roots of L_N'. Raises ValueError for an order below 1."""
    if order < 1:
        raise ValueError(f"polynomial order N = {order} must be at least 1")
    found = [arb(-1)]
    for guess in np.sort(legendre.Legendre.basis(order).deriv().roots().real):
        x = arb(float(guess))
        for _ in range(NEWTON_STEPS):  # on (1 - x^2) L_N' = N (L_{N-1} - x L_N), whose derivative is -N (N + 1) L_N
            value = _legendre(order, x)
            x = (x + (_legendre(order - 1, x) - x * value) / ((order + 1) * value)).mid()
        found.append(x)
    return np.array([*found, arb(1)], dtype=object)


def _legendre(order: int, x: arb) -> arb:
    return x.legendre_p(order)


@in_high_precision
def weights_exact(order: int) -> np.ndarray:
    """Quadrature weights 2 / (N (N + 1) L_N(tau_k)^2), exact for polynomials up to degree 2 N - 1."""
    return np.array([2 / (order * (order + 1) * _legendre(order, x) ** 2) for x in nodes_exact(order)], dtype=object)


@in_high_precision
def differentiation_exact(order: int) -> np.ndarray:
    """D of (15), (N + 1) x (N + 1): values at the nodes to derivatives at the nodes, exact for polynomials up to degree N."""
    tau = nodes_exact(order)
    value = [_legendre(order, x) for x in tau]
    d = np.full((order + 1, order + 1), arb(0), dtype=object)
    for i in range(order + 1):
        for k in range(order + 1):
            if i != k:
                d[i, k] = value[i] / value[k] / (tau[i] - tau[k])
    d[0, 0], d[order, order] = -arb(order * (order + 1)) / 4, arb(order * (order + 1)) / 4
    return d


@in_high_precision
def interpolation_exact(order: int, at: np.ndarray) -> np.ndarray:
    """The Lagrange matrix of (12), len(at) x (N + 1): values at the nodes to values at `at`; (13) in its barycentric form."""
    tau = nodes_exact(order)
    barycentric = [1 / _legendre(order, x) for x in tau]
    rows = []
    for point in np.asarray(at, dtype=object):
        gaps = [arb(point) - x for x in tau]
        nearest = min(range(order + 1), key=lambda k: abs(float(gaps[k])))
        if abs(float(gaps[nearest])) < COINCIDENT:
            rows.append([arb(int(k == nearest)) for k in range(order + 1)])
            continue
        terms = [w / gap for w, gap in zip(barycentric, gaps, strict=True)]
        total = sum(terms, arb(0))
        rows.append([term / total for term in terms])
    return np.array(rows, dtype=object).reshape(len(rows), order + 1)


def nodes(order: int) -> np.ndarray:
    """The order + 1 nodes."""
    return rounded(nodes_exact(order))


def weights(order: int) -> np.ndarray:
    """The order + 1 quadrature weights."""
    return rounded(weights_exact(order))


def differentiation(order: int) -> np.ndarray:
    """The differentiation matrix, (N + 1) x (N + 1)."""
    return rounded(differentiation_exact(order))


def interpolation(order: int, at: np.ndarray) -> np.ndarray:
    """The Lagrange matrix, len(at) x (N + 1)."""
    return rounded(interpolation_exact(order, at))
