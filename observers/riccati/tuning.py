"""Matrices of an observer's tuning as parameters: a diagonal by the variables' names, or every entry by its indices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from observers.component import Port
from observers.model import Variable

SMALLEST = 1e-12  # a diagonal entry: with 0 the matrix would be singular
UNKNOWN = 1e30  # a bound that says nothing


@dataclass(frozen=True)
class Matrix:
    """A square matrix of tuning parameters.

    `ports`: its parameters; `start` (n x n): its value at their start values. A diagonal has n parameters `tuning.<name>.<variable>`,
    a full matrix n^2, `tuning.<name>[i,j]`, row by row.
    """

    ports: tuple[Port, ...]
    start: np.ndarray
    is_diagonal: bool

    def expression(self, values: Any) -> Any:
        """The matrix of the parameters' values (a CasADi column in the order of `ports`)."""
        n = len(self.start)
        return ca.diag(values) if self.is_diagonal else ca.reshape(values, n, n).T


def matrix(
    owner: str,
    name: str,
    value: ArrayLike,
    variables: Sequence[Variable],
    description: str,
    variability: str = "tunable",
) -> Matrix:
    """The tuning matrix `name` for `variables`, from a scalar, the diagonal, or the whole matrix.

    The parameters' unit is 1, for FMI has none with half powers of seconds; `description` says what they are.

    Raises:
        ValueError: a wrong shape, an entry that is not finite, a diagonal entry below SMALLEST, a singular matrix.
    """
    n = len(variables)
    given = np.asarray(value, dtype=float)
    if given.shape not in ((), (n,), (n, n)):
        raise ValueError(f"{owner}: {name} has the shape {given.shape}, expected a scalar, ({n},) or ({n}, {n})")
    if not np.all(np.isfinite(given)):
        raise ValueError(f"{owner}: {name} = {given.tolist()} is not finite")
    if given.ndim == 2:
        if np.linalg.matrix_rank(given) < n:
            raise ValueError(f"{owner}: {name} is singular: rank {np.linalg.matrix_rank(given)} of {n}")
        ports = tuple(
            Port(f"tuning.{name}[{i},{j}]", f"{description}, entry {i}, {j}", start=entry, variability=variability)
            for (i, j), entry in zip(((i + 1, j + 1) for i, j in np.ndindex(n, n)), given.ravel().tolist(), strict=True)
        )
        return Matrix(ports, given, is_diagonal=False)
    diagonal = np.broadcast_to(given, (n,))
    for variable, entry in zip(variables, diagonal, strict=True):
        if not entry >= SMALLEST:
            raise ValueError(f"{owner}: {name} of '{variable.name}' = {entry:g} must be at least {SMALLEST:g}")
    ports = tuple(
        Port(
            f"tuning.{name}.{v.name}",
            f"{description}: {v.description or v.name}",
            start=float(entry),
            min=SMALLEST,
            variability=variability,
        )
        for v, entry in zip(variables, diagonal, strict=True)
    )
    return Matrix(ports, np.diag(diagonal), is_diagonal=True)
