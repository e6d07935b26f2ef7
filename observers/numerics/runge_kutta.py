"""One explicit Runge-Kutta step for CasADi expressions, from a table of coefficients.

The table is data: scipy publishes that of Dormand & Prince's eighth-order method (Hairer, Norsett & Wanner, "Solving Ordinary Differential
Equations I", II.10). Fixed steps, without its error control: a real-time component must take the same time every time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import DOP853


@dataclass(frozen=True)
class Tableau:
    """An explicit Butcher tableau: stages x_i = x + h sum_j a_ij k_j at t + c_i h, result x + h sum_i b_i k_i.

    `stable`: |h lambda| inside the region of stability, with a margin, for lambda in the left half plane.
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    order: int
    stable: float


DORMAND_PRINCE_8 = Tableau(np.asarray(DOP853.A), np.asarray(DOP853.B), np.asarray(DOP853.C), order=8, stable=3.0)
CLASSICAL_4 = Tableau(
    np.array([[0, 0, 0, 0], [0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 1, 0]]),
    np.array([1, 2, 2, 1]) / 6,
    np.array([0, 0.5, 0.5, 1]),
    order=4,
    stable=2.5,
)


def runge_kutta(rhs: Callable[[Any, Any], Any], x: Any, t: Any, h: Any, tableau: Tableau = DORMAND_PRINCE_8) -> Any:
    """x(t + h) from x(t) of x' = rhs(x, t); `x` (n x 1) numeric or CasADi, `t`, `h` scalar. Local error O(h^(order + 1))."""
    stages: list[Any] = []
    for row, c in zip(tableau.a, tableau.c, strict=True):
        increment = _combine(row, stages)
        stages.append(rhs(x if increment is None else x + h * increment, t + float(c) * h))
    return x + h * _combine(tableau.b, stages)


def stable_step(rates: Iterable[float], longest: float, tableau: Tableau = DORMAND_PRINCE_8) -> float:
    """The longest of `longest`, `longest` / 2, ... with which the method is stable for modes of these rates, |eigenvalue|.

    Halved, not cut to size: the last bits of eigenvalues depend on the machine.
    """
    fastest = max(rates, default=0.0)
    step = longest
    while step * fastest > tableau.stable:
        step /= 2
    return step


def _combine(weights: np.ndarray, stages: list[Any]) -> Any:
    """sum_j weights_j stages_j without the zero weights; None where all are zero (the first stage)."""
    total = None
    for weight, stage in zip(weights, stages, strict=False):
        if weight != 0:
            term = float(weight) * stage
            total = term if total is None else total + term
    return total
