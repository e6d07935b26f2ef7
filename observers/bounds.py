"""The bounds of what is estimated, imposed on an estimate by projection."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import casadi as ca

from observers.model import Variable

MARGIN = 1e-3  # of a nominal value


def bounded(variables: Sequence[Variable]) -> bool:
    """Whether any of them has a bound."""
    return any(math.isfinite(v.min) or math.isfinite(v.max) for v in variables)


def conditioned(variables: Sequence[Variable], x: Any, P: Any) -> Any:
    """x (n x 1) of covariance P (n x n) within the bounds: where an entry lies outside, the nearest point on its bound in the metric of P.

    One bound after another, so that what is correlated with the entry moves with it (Simon, "Kalman filtering with state constraints", IET
    Control Theory & Applications 4, 2010, estimate projection); P stays.
    """
    within = projected(variables, x)
    if within is x:
        return x
    for i, v in enumerate(variables):
        if math.isfinite(v.min) or math.isfinite(v.max):
            excess = x[i] - projected([v], x[i])
            x = x - ca.if_else(excess == 0, 0, P[:, i] / P[i, i] * excess)
    return projected(variables, x)


def inside(variables: Sequence[Variable], x: Any) -> Any:
    """x (n x 1) at least MARGIN of a nominal value within its bounds: where a derivative is taken that may be none on a bound."""
    margins = [min(MARGIN * v.nominal, (v.max - v.min) / 2) for v in variables]
    return _cut([(v.min + gap, v.max - gap) for v, gap in zip(variables, margins, strict=True)], x)


def projected(variables: Sequence[Variable], x: Any) -> Any:
    """x (n x m), each row cut to the bounds of its variable; a row without bounds stays as it is, a NaN too."""
    return _cut([(v.min, v.max) for v in variables], x)


def _cut(bounds: Sequence[tuple[float, float]], x: Any) -> Any:
    if not any(math.isfinite(low) or math.isfinite(high) for low, high in bounds):
        return x
    rows = []
    for i, (low, high) in enumerate(bounds):
        row = x[i, :]
        if math.isfinite(low):
            row = ca.if_else(row < low, low, row)
        if math.isfinite(high):
            row = ca.if_else(row > high, high, row)
        rows.append(row)
    return ca.vertcat(*rows)
