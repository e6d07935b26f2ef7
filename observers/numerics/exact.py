"""Matrices in 192-bit ball arithmetic (Arb, by python-flint), rounded to doubles once, at the end.

The constants of generated code are computed here: LAPACK's and BLAS' last bits depend on the processor of the machine that builds, and the
same sources must give the same FMU everywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np
from flint import arb, arb_mat, ctx

PRECISION = 192  # bits; a double has 53
TRUSTED = 2.0**-70  # largest radius of an entry, relative to the largest entry, that still rounds to the right double

P = ParamSpec("P")
R = TypeVar("R")


def in_high_precision(function: Callable[P, R]) -> Callable[P, R]:
    """Run `function` with Arb's working precision set to PRECISION."""

    @wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        with ctx.workprec(PRECISION):
            return function(*args, **kwargs)

    return wrapped


def matrix(array: Any) -> arb_mat:
    """An Arb matrix (n x m) from a numpy array of doubles (exactly) or of Arb numbers."""
    array = np.atleast_2d(np.asarray(array))
    if array.dtype != object:
        array = array.astype(float)
    return arb_mat(array.shape[0], array.shape[1], [arb(x) for x in array.ravel().tolist()])


def table(m: arb_mat) -> np.ndarray:
    """The entries of an Arb matrix as a numpy array of Arb numbers (n x m)."""
    made = np.empty((m.nrows(), m.ncols()), dtype=object)
    made.ravel()[:] = m.entries()
    return made


def rounded(array: np.ndarray) -> np.ndarray:
    """Doubles from an array of Arb numbers, of the same shape.

    Raises:
        ValueError: an entry is not known well enough for that: the computation was too ill-conditioned.
    """
    entries = array.ravel().tolist()
    values = np.array([float(x.mid()) for x in entries])
    radius = max((float(x.rad()) for x in entries), default=0.0)
    largest = np.abs(values).max(initial=0.0)
    if not radius <= TRUSTED * max(largest, 1.0):
        raise ValueError(
            f"constants of the window are lost to ill-conditioning: known to {radius:.1e}, largest {largest:.1e}"
        )
    return values.reshape(array.shape)


@in_high_precision
def product(*factors: np.ndarray) -> np.ndarray:
    """The matrix product of arrays of doubles, each entry rounded once."""
    if any(0 in factor.shape for factor in factors):
        return np.zeros((factors[0].shape[0], factors[-1].shape[1]))
    total = matrix(factors[0])
    for factor in factors[1:]:
        total = total * matrix(factor)
    return rounded(table(total))
