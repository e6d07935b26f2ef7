"""Equidistant samples between their instants: the polynomial through the last few of them."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import casadi as ca

CUBIC = 3


def lagrange_weights(degree: int, at: Fraction) -> list[Fraction]:
    """Weights of the samples at 0, -1, ..., -degree in the value at `at` of the polynomial through them; exact."""
    weights = []
    for i in range(degree + 1):
        weight = Fraction(1)
        for j in range(degree + 1):
            if j != i:
                weight *= (at + j) / Fraction(j - i)
        weights.append(weight)
    return weights


def lagrange_slopes(degree: int, at: Fraction) -> list[Fraction]:
    """The same for the derivative, in units of 1 / sample interval."""
    slopes = []
    for i in range(degree + 1):
        total = Fraction(0)
        for left_out in range(degree + 1):
            if left_out == i:
                continue
            term = Fraction(1, left_out - i)
            for j in range(degree + 1):
                if j not in (i, left_out):
                    term *= (at + j) / Fraction(j - i)
            total += term
        slopes.append(total)
    return slopes


def interpolated(samples: list[Any], k: Any, at: Fraction, derivative: bool = False) -> Any:
    """Value (or derivative, per sample interval) at `at` in [-1, 0], between the last two of `samples`, newest first.

    The samples (p x 1 each) are the k-th and those before it; while k < 3 the polynomial has degree k, then it is the cubic.
    """
    rule = lagrange_slopes if derivative else lagrange_weights
    value = None
    for degree in range(CUBIC, 0, -1):
        weights = rule(degree, at)
        here = sum(float(w) * y for w, y in zip(weights, samples, strict=False) if w)
        value = here if value is None else ca.if_else(k > degree, value, here)
    return value
