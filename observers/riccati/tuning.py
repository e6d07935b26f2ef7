"""The design matrices N, R, Q0 of the Riccati observer as parameters: the paper's matrices, or standard deviations by name.

N N' = diag(process_noise^2). A sample of the deviation s, every Ts, says what the paper's continuous measurement with R = s sqrt(Ts) does:
R R' / Ts = s^2. Q0 = diag(initial_std^2).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from observers import ports, units
from observers.component import Port
from observers.linearisation import Linearisation
from observers.model import Model, ModelError, Variable

METHOD = "riccati"
SMALLEST = 1e-12  # a diagonal entry: with 0 the matrix would be singular
UNKNOWN = 1e30  # a bound that says nothing

Given = ArrayLike | Mapping[str, float]


@dataclass(frozen=True)
class Matrix:
    """A square matrix made of tuning parameters.

    `ports`: its parameters; `start` (n x n): its value at their start values and the first sample time; `expression`(values, Ts): its value
    for a CasADi column in the order of `ports`. `timed`: it depends on Ts.
    """

    ports: tuple[Port, ...]
    start: np.ndarray
    expression: Callable[[Any, Any], Any]
    timed: bool = False


@dataclass(frozen=True)
class Design:
    """N (n x n), R (ny x ny), Q0 (n x n), and the sample time [s] that R.start belongs to."""

    N: Matrix
    R: Matrix
    Q0: Matrix
    sample_time: float

    @property
    def ports(self) -> tuple[Port, ...]:
        return (*self.N.ports, *self.R.ports, *self.Q0.ports)


def design(
    model: Model,
    line: Linearisation,
    sample_time: float,
    deviations: Mapping[str, Mapping[str, float] | None],
    matrices: Mapping[str, Given | None],
) -> Design:
    """The design matrices from `deviations` (process_noise, measurement_noise, initial_std) or `matrices` (N, R, Q0; 1 if absent).

    Raises:
        ValueError: both for the same matrix; a matrix of a wrong shape or singular, a Q0 that is not symmetric positive definite.
        ModelError: a name that is not estimated or measured; a deviation out of range.
    """
    for matrix_name, deviation in zip(matrices, deviations, strict=True):
        ports.refuse_both(METHOD, matrix_name, matrices[matrix_name], deviation, deviations[deviation])
    made = Design(
        N=_intensity(line.variables, deviations["process_noise"])
        or _matrix("N", matrices["N"], line.variables, "disturbance intensity", lambda row: f"{row} per sqrt(s)"),
        R=_sampled(model.outputs, deviations["measurement_noise"], sample_time)
        or _matrix("R", matrices["R"], model.outputs, "measurement error", lambda row: f"{row} times sqrt(s)"),
        Q0=_variance(line.variables, deviations["initial_std"])
        or _matrix("Q0", matrices["Q0"], line.variables, "first Q", None, "fixed"),
        sample_time=sample_time,
    )
    Q0 = made.Q0.start
    if not np.array_equal(Q0, Q0.T) or np.linalg.eigvalsh(Q0).min() <= 0:
        raise ValueError(f"{METHOD}: Q0 = {Q0.tolist()} is not symmetric positive definite")
    return made


def _intensity(variables: Sequence[Variable], given: Mapping[str, float] | None) -> Matrix | None:
    """N = diag(process_noise), which may have zeros: then there is no certificate."""
    if given is None:
        return None
    made = ports.deviations(METHOD, "process_noise", ports.PROCESS_NOISE, variables, given, 1e-3)
    return Matrix(made, np.diag([p.start for p in made]), lambda values, Ts: ca.diag(values))


def _sampled(variables: Sequence[Variable], given: Mapping[str, float] | None, sample_time: float) -> Matrix | None:
    """R = diag(measurement_noise) sqrt(Ts)."""
    if given is None:
        return None
    made = ports.deviations(
        METHOD, "measurement_noise", ports.MEASUREMENT_NOISE, variables, given, 0.1, smallest=SMALLEST
    )
    start = np.diag([p.start for p in made]) * np.sqrt(sample_time)
    return Matrix(made, start, lambda values, Ts: ca.diag(values) * ca.sqrt(Ts), timed=True)


def _variance(variables: Sequence[Variable], given: Mapping[str, float] | None) -> Matrix | None:
    """Q0 = diag(initial_std^2)."""
    if given is None:
        return None
    made = ports.deviations(METHOD, "initial_std", ports.INITIAL_STD, variables, given, 1.0, "fixed", smallest=SMALLEST)
    return Matrix(made, np.diag([p.start**2 for p in made]), lambda values, Ts: ca.diag(values**2))


def _matrix(
    name: str,
    value: Given | None,
    variables: Sequence[Variable],
    description: str,
    words: Callable[[str], str] | None,
    variability: str = "tunable",
) -> Matrix:
    """The paper's matrix `name`: from a scalar, the diagonal (also by name, 1 where one is absent), or the whole matrix.

    A diagonal has n parameters `tuning.<name>.<variable>`, a whole matrix n^2, `tuning.<name>[i,j]`, row by row. `words` says, for the unit
    of a row, what no unit expression can; without it the unit is that of row times column.

    Raises:
        ValueError: a wrong shape, an entry that is not finite, a diagonal entry below SMALLEST, a singular matrix.
        ModelError: a name that is none of the `variables`.
    """
    n = len(variables)
    given = np.asarray(_diagonal(name, value, variables), dtype=float)
    if given.shape not in ((), (n,), (n, n)):
        raise ValueError(f"{METHOD}: {name} has the shape {given.shape}, expected a scalar, ({n},) or ({n}, {n})")
    if not np.all(np.isfinite(given)):
        raise ValueError(f"{METHOD}: {name} = {given.tolist()} is not finite")
    whole = given.ndim == 2
    if whole and np.linalg.matrix_rank(given) < n:
        raise ValueError(f"{METHOD}: {name} is singular: rank {np.linalg.matrix_rank(given)} of {n}")
    start = given if whole else np.diag(np.broadcast_to(given, (n,)))
    made = []
    for i, j in np.ndindex(n, n) if whole else ((i, i) for i in range(n)):
        row, column = (units.difference(variables[k].unit) for k in (i, j))
        if not whole and not start[i, i] >= SMALLEST:
            raise ValueError(
                f"{METHOD}: {name} of '{variables[i].name}' = {start[i, i]:g} must be at least {SMALLEST:g}"
            )
        what = f"entry {i + 1}, {j + 1}" if whole else variables[i].description or variables[i].name
        made.append(
            Port(
                f"tuning.{name}[{i + 1},{j + 1}]" if whole else f"tuning.{name}.{variables[i].name}",
                f"{description}: {what}{f', in {words(row)}' if words else ''}",
                units.NONE if words else units.product([(row, 1), (column, 1)]),
                float(start[i, j]),
                min=-np.inf if whole else SMALLEST,
                variability=variability,
            )
        )
    if whole:
        return Matrix(tuple(made), start, lambda values, Ts: ca.reshape(values, n, n).T)
    return Matrix(tuple(made), start, lambda values, Ts: ca.diag(values))


def _diagonal(name: str, value: Given | None, variables: Sequence[Variable]) -> ArrayLike:
    """`value` without names: 1 if absent; a mapping as the diagonal."""
    if value is None:
        return 1.0
    if not isinstance(value, Mapping):
        return value
    known = [v.name for v in variables]
    for key in value:
        if key not in known:
            raise ModelError(f"{METHOD}: {name} of '{key}'; known: {', '.join(known)}")
    return [value.get(key, 1.0) for key in known]
