"""Backward differentiation of fixed step (Brenan, Campbell & Petzold 1989, 3.2): the derivative of the polynomial through the past."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import casadi as ca

from observers.canonical_dae.interpolation import lagrange_slopes

MOST = 6  # the highest order: from 7 on backward differentiation is not zero-stable


def coefficients(order: int) -> list[float]:
    """a_0, ..., a_order of h z'_k = a_0 z_k + a_1 z_(k-1) + ...; rounded once from fractions."""
    return [float(a) for a in lagrange_slopes(order, Fraction(0))]


def growing(order: int, past: list[Any], k: Any) -> tuple[Any, Any]:
    """(a_0, a_1 z_(k-1) + a_2 z_(k-2) + ...) of the highest order up to `order` that k past values allow.

    `past`: the columns z_(k-1), z_(k-2), ..., as many as `order`; `k` >= 1 the number of steps done.
    """
    first, rest = None, None
    for use in range(order, 0, -1):
        a = coefficients(use)
        older = sum(c * z for c, z in zip(a[1:], past, strict=False))
        first = ca.MX(a[0]) if first is None else ca.if_else(k > use, first, a[0])
        rest = older if rest is None else ca.if_else(k > use, rest, older)
    return first, rest
