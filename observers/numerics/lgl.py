"""Legendre-Gauss-Lobatto collocation on [-1, 1]: nodes, weights, differentiation and interpolation (Gong, Ross & Kang 2007, (12)-(15))."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import legendre
from scipy.interpolate import BarycentricInterpolator


def nodes(order: int) -> np.ndarray:
    """The order + 1 nodes, ascending: -1, 1 and the roots of L_N'. Raises ValueError for an order below 1."""
    if order < 1:
        raise ValueError(f"polynomial order N = {order} must be at least 1")
    slope = legendre.Legendre.basis(order).deriv()
    tau = np.concatenate([[-1.0], np.sort(slope.roots().real), [1.0]])
    curvature = slope.deriv()
    for _ in range(3):  # the companion matrix's roots carry 1e-14; Newton's method takes them to the last bit
        tau[1:-1] -= slope(tau[1:-1]) / curvature(tau[1:-1])
    return (tau - tau[::-1]) / 2  # exactly antisymmetric


def weights(order: int) -> np.ndarray:
    """Quadrature weights 2 / (N (N + 1) L_N(tau_k)^2), exact for polynomials up to degree 2 N - 1."""
    return 2 / (order * (order + 1) * legendre.Legendre.basis(order)(nodes(order)) ** 2)


def differentiation(order: int) -> np.ndarray:
    """D of (15), (N + 1) x (N + 1): values at the nodes to derivatives at the nodes, exact for polynomials up to degree N."""
    tau = nodes(order)
    value = legendre.Legendre.basis(order)(tau)
    gap = tau[:, None] - tau[None, :]
    np.fill_diagonal(gap, 1.0)
    d = value[:, None] / value[None, :] / gap
    np.fill_diagonal(d, 0.0)
    np.fill_diagonal(d, -d.sum(axis=1))  # D 1 = 0 exactly: equals (15)'s diagonal, with less rounding
    return d


def interpolation(order: int, at: np.ndarray) -> np.ndarray:
    """The Lagrange matrix of (12), len(at) x (N + 1): values at the nodes to values at `at`."""
    # The barycentric weights are known for these nodes; scipy's own come by a randomly permuted product, new bits every time.
    signs = np.where(np.arange(order + 1) % 2 == 0, 1.0, -1.0)
    barycentric = BarycentricInterpolator(nodes(order), np.eye(order + 1), wi=signs * np.sqrt(weights(order)))
    return np.asarray(barycentric(np.asarray(at)))
