"""A half-explicit Runge-Kutta step for x' = F + G m', 0 = h(x) - y(t), where G moves with x: no derivative of y, and none of G.

Brasey & Hairer, "Half-explicit Runge-Kutta methods for differential-algebraic systems of index 2", SIAM Journal on Numerical Analysis 30,
1993: each stage's m' is the one with which the next stage satisfies the constraint. Their method HEM4, of order 4 in five stages; its
weights are those of Radau IIA.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from observers.numerics.runge_kutta import Tableau

_ROOT = 6**0.5
HEM_4 = Tableau(
    np.array(
        [
            [0, 0, 0, 0, 0],
            [3 / 10, 0, 0, 0, 0],
            [(1 + _ROOT) / 30, (11 - 4 * _ROOT) / 30, 0, 0, 0],
            [(-79 - 31 * _ROOT) / 150, (-1 - 4 * _ROOT) / 30, (24 + 11 * _ROOT) / 25, 0, 0],
            [(14 + 5 * _ROOT) / 6, (-8 + 7 * _ROOT) / 6, (-9 - 7 * _ROOT) / 4, (9 - _ROOT) / 4, 0],
        ]
    ),
    np.array([0, 0, (16 - _ROOT) / 36, (16 + _ROOT) / 36, 1 / 9]),
    np.array([0, 3 / 10, (4 - _ROOT) / 10, (4 + _ROOT) / 10, 1]),
    order=4,
    stable=2.5,
)


def half_explicit(
    terms: Callable[[Any, Any, float], tuple[Any, Any]],
    constrain: Callable[[Any, Any, float], Any],
    x: Any,
    m: Any,
    h: Any,
) -> tuple[Any, Any]:
    """(x, m) after a step of length `h` by HEM_4; `x` (n x 1), `m` (p x 1) numeric or CasADi.

    Args:
        terms: `(x, m, c) -> (F (n x 1), G (n x p))` at the time t + c h.
        constrain: `(x, G, c) -> nu` (p x 1) with h(x + G nu) = y at the time t + c h.
    """
    stages: list[tuple[Any, Any, Any]] = []  # (F, G, m')
    rows, nodes = [*HEM_4.a[1:], HEM_4.b], [*HEM_4.c[1:], 1.0]
    here = x, m
    for i, (row, c) in enumerate(zip(rows, nodes, strict=True)):
        F, G = terms(*here, float(HEM_4.c[i]))
        moved = x + h * float(row[i]) * F
        advanced = m
        for weight, (F_j, G_j, m_dot) in zip(row, stages, strict=False):
            if weight != 0:
                moved = moved + h * float(weight) * (F_j + G_j @ m_dot)
                advanced = advanced + h * float(weight) * m_dot
        nu = constrain(moved, G, float(c))
        stages.append((F, G, nu / (h * float(row[i]))))
        here = moved + G @ nu, advanced + nu
    return here
