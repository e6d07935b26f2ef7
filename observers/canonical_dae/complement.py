"""What a constant matrix leaves over: a basis of its left null space, in exact fractions, rounded once."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np


@dataclass(frozen=True)
class Complement:
    """Of E (n x q) of full column rank: T (n - q x n) with T E = 0, R (n x n - q) with T R = I, L (q x n) with L E = I.

    T and R are of the form [.. I ..]: the rows of E with the pivots are eliminated.
    """

    T: np.ndarray
    R: np.ndarray
    L: np.ndarray


def complement(E: np.ndarray) -> Complement | None:
    """The complement of E (n x q); None where E has not full column rank."""
    n, q = E.shape
    augmented = [[Fraction(float(x)) for x in row] for row in E.T]
    augmented = [row + [Fraction(int(i == j)) for j in range(q)] for i, row in enumerate(augmented)]
    pivots: list[int] = []
    for i in range(q):
        # The largest entry, the first of several: deterministic, and well conditioned after rounding.
        column = max((j for j in range(n) if j not in pivots), key=lambda j: (abs(augmented[i][j]), -j), default=None)
        if column is None or augmented[i][column] == 0:
            return None
        pivots.append(column)
        augmented[i] = [x / augmented[i][column] for x in augmented[i]]
        for k in range(q):
            if k != i and augmented[k][column] != 0:
                factor = augmented[k][column]
                augmented[k] = [x - factor * y for x, y in zip(augmented[k], augmented[i], strict=True)]
    rest = [j for j in range(n) if j not in pivots]
    # Row i of `augmented` is now (E_P^-1)' E' and (E_P^-1)'.
    T, R, L = np.zeros((n - q, n)), np.zeros((n, n - q)), np.zeros((q, n))
    for row, j in enumerate(rest):
        T[row, j] = R[j, row] = 1
        for i, pivot in enumerate(pivots):
            T[row, pivot] = -float(augmented[i][j])
    for i, pivot in enumerate(pivots):
        for k in range(q):
            L[k, pivot] = float(augmented[i][n + k])
    return Complement(T, R, L)


def exact_inverse(N: np.ndarray) -> np.ndarray | None:
    """N^-1 (n x n), each entry rounded once; None where N is singular."""
    made = complement(N)
    return None if made is None else made.L
