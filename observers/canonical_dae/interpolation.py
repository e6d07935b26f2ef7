"""Equidistant samples between their instants: the polynomial through the last few of them."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import casadi as ca

HIGHEST = 9  # degree; at the middle of the last interval its weights add up to 15 in absolute value, the cubic's to 1.6


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


def interpolated(samples: list[Any], k: Any, at: Fraction, degree: int) -> Any:
    """Value at `at` in [-1, 0], between the last two of `samples`, newest first, of the polynomial of `degree` through degree + 1 of them.

    The samples (p x 1 each) are the k-th and those before it; while k < degree the polynomial has degree k.
    """
    value = None
    for use in range(degree, 0, -1):
        weights = lagrange_weights(use, at)
        here = sum(float(w) * y for w, y in zip(weights, samples, strict=False) if w)
        value = here if value is None else ca.if_else(k > use, value, here)
    return value
