"""Rank and observability of matrices of numbers, for checks while an observer is built.

By numpy's singular values: what follows from them is a decision, not a constant of generated code.
"""

from __future__ import annotations

import numpy as np

TOLERANCE = 1e-8  # smallest over largest singular value that counts as full rank
ROUNDING = 1e-13  # a row this much shorter than its factors is zero


def kernel(matrix: np.ndarray) -> np.ndarray:
    """An orthonormal basis of the null space of `matrix` (m x n), as rows (k x n). The matrix's rows are measured by their own length."""
    n = matrix.shape[1]
    if n == 0:
        return np.zeros((0, 0))
    lengths = np.linalg.norm(matrix, axis=1, keepdims=True)
    scaled = np.vstack([matrix / np.where(lengths > 0, lengths, 1.0), np.zeros((n, n))])
    _, singular, V = np.linalg.svd(scaled, full_matrices=False)
    basis: np.ndarray = V[singular <= TOLERANCE * max(float(singular[0]), TOLERANCE)]
    return basis


def unobservable(A: np.ndarray, C: np.ndarray) -> np.ndarray:
    """An orthonormal basis of the states (A n x n) that C (m x n) never shows, as rows (k x n): the null space of [C; C A; ...].

    Each row is scaled to one before the next product, since rows grow or shrink like A's powers.
    """
    row, rows, size = C, [C], ROUNDING * np.linalg.norm(A)
    for _ in range(len(A) - 1):
        lengths = np.linalg.norm(row, axis=1, keepdims=True)
        row = row / np.where(lengths > 0, lengths, 1.0) @ A
        row = np.where(np.linalg.norm(row, axis=1, keepdims=True) > size, row, 0.0)
        rows.append(row)
    return kernel(np.vstack(rows))
