"""The paper's spline through the samples: a not-a-knot cubic through equidistant points, as a matrix.

Own code, not scipy's CubicSpline: that solves by LAPACK, whose last bits depend on the machine (see `exact`).
"""

from __future__ import annotations

import numpy as np
from flint import arb

from observers.numerics.exact import in_high_precision, matrix, rounded, table


@in_high_precision
def spline_matrix(samples: int, at: np.ndarray) -> np.ndarray:
    """len(at) x (samples + 1): values at 0, 1, ..., samples to the spline's values at `at` in [0, samples]; samples >= 3.

    Slopes s_i: s_{i-1} + 4 s_i + s_{i+1} = 3 (y_{i+1} - y_{i-1}) inside; at the ends the third derivative is continuous over the first and
    the last inner point: s_0 + 2 s_1 = (-5 y_0 + 4 y_1 + y_2) / 2, mirrored at the other end.
    """
    n = samples + 1
    left, right = np.zeros((n, n)), np.zeros((n, n))
    for i in range(1, samples):
        left[i, i - 1 : i + 2] = 1, 4, 1
        right[i, [i - 1, i + 1]] = -3, 3
    left[0, :2], right[0, :3] = (1, 2), (-2.5, 2, 0.5)
    left[-1, -2:], right[-1, -3:] = (2, 1), (-0.5, -2, 2.5)
    slopes = table(matrix(left).solve(matrix(right)))
    rows = []
    for time in at:
        i = int(np.clip(np.floor(float(time)), 0, samples - 1))
        x = arb(float(time)) - i
        row = slopes[i] * (x * (1 - x) ** 2) + slopes[i + 1] * (x**2 * (x - 1))  # Hermite's basis
        row[i] += (1 + 2 * x) * (1 - x) ** 2
        row[i + 1] += x**2 * (3 - 2 * x)
        rows.append(row)
    return rounded(np.vstack(rows))
