"""The design of the Riccati observer as tuning parameters: the paper's N, R and Q0, or the standard deviations that they stand for.

N N' = diag(process_noise^2)        R R' / Ts = diag(measurement_noise^2)        Q0 = diag(initial_std^2)
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
from observers.model import Model, ModelError, Variable

SMALLEST = 1e-12  # a diagonal entry: with 0 the matrix would be singular
SMALLEST_STD = 1e-9  # standard deviation, relative to the nominal value
LARGEST = 1e30  # an entry of N and R, the root of one of Q0
UNKNOWN = 1e30  # a bound that says nothing
Given = ArrayLike | Mapping[str, float] | None  # scalar, diagonal, whole, or the diagonal by names


@dataclass(frozen=True)
class Matrix:
    """A square matrix of tuning parameters.

    `ports`: its parameters; `start` (n x n): its value at their start values; `of`: the matrix of their values, a CasADi column.
    """

    ports: tuple[Port, ...]
    start: np.ndarray
    of: Callable[[Any], Any]


@dataclass(frozen=True)
class Design:
    """`N` and `Q0`, and the parameters and the start value of `R`; `Rd` (values, Ts) -> the covariance of a sample.

    `sample_time`: the only Ts [s] at which R has its start value; None where R does not depend on it. `noise_known`: whether R is what the
    user says the noise is, not a weight or a default. `weighted`: whether it is the paper's, a weight.
    """

    N: Matrix
    R: Matrix
    Q0: Matrix
    Rd: Callable[[Any, Any], Any]
    sample_time: float | None = None
    noise_known: bool = False
    weighted: bool = False

    @property
    def ports(self) -> tuple[Port, ...]:
        return (*self.N.ports, *self.R.ports, *self.Q0.ports)

    @property
    def sizes(self) -> dict[str, int]:
        return {"N": len(self.N.ports), "R": len(self.R.ports), "Q0": len(self.Q0.ports)}


def design(
    model: Model,
    variables: Sequence[Variable],
    sample_time: float,
    paper: Mapping[str, Given],
    deviations: Mapping[str, Mapping[str, float] | None],
) -> Design:
    """The design of `paper`'s N, R, Q0, or of `deviations`' process_noise, measurement_noise, initial_std, each one way or the other.

    What is given neither way is the deviation's own default, or where any of the paper's matrices is given, the identity. N and Q0 are over
    `variables`, R is over the outputs.

    Raises:
        ModelError: a deviation of something that is not estimated or measured.
        ValueError: both ways at once; what `matrix` refuses; a Q0 that is not symmetric positive definite.
    """
    by_name = all(value is None for value in paper.values()) or any(value is not None for value in deviations.values())
    chosen = {}
    for name, other in (("N", "process_noise"), ("R", "measurement_noise"), ("Q0", "initial_std")):
        ports.refuse_both("riccati", name, paper[name], other, deviations[other])
        chosen[name] = by_name and paper[name] is None
    one = {name: 1.0 if value is None else value for name, value in paper.items()}
    N = (
        _diagonal(ports.process_noise("riccati", model, deviations["process_noise"], sample_time))
        if chosen["N"]
        else matrix("N", one["N"], variables, Entry("disturbance intensity", "in {0} per sqrt(s)"))
    )
    Q0 = (
        _squared(_named("initial_std", ports.INITIAL_STD, variables, deviations, 1.0, "fixed", SMALLEST_STD))
        if chosen["Q0"]
        else matrix("Q0", one["Q0"], variables, Entry("first Q", "", power=2), "fixed")
    )
    if not np.array_equal(Q0.start, Q0.start.T) or np.linalg.eigvalsh(Q0.start).min() <= 0:
        raise ValueError(f"riccati: Q0 = {Q0.start.tolist()} is not symmetric positive definite")
    if chosen["R"]:
        noise = _named(
            "measurement_noise", ports.MEASUREMENT_NOISE, model.outputs, deviations, 0.1, smallest=SMALLEST_STD
        )
        R = Matrix(noise.ports, noise.start * np.sqrt(sample_time), noise.of)
        known = deviations["measurement_noise"] is not None
        return Design(N, R, Q0, lambda values, Ts: ca.diag(values**2), sample_time, known)
    R = matrix("R", one["R"], model.outputs, Entry("measurement error", "in {0} times sqrt(s)"))

    def covariance(values: Any, Ts: Any) -> Any:
        root = R.of(values)
        return root @ root.T / Ts

    return Design(N, R, Q0, covariance, weighted=True)


def _named(
    group: str,
    what: ports.Deviation,
    variables: Sequence[Variable],
    given: Mapping[str, Mapping[str, float] | None],
    part: float,
    variability: str = "tunable",
    smallest: float = 0.0,
) -> Matrix:
    return _diagonal(ports.deviations("riccati", group, what, variables, given[group], part, variability, smallest))


def _diagonal(made: tuple[Port, ...]) -> Matrix:
    return Matrix(made, np.diag([port.start for port in made]), ca.diag)


def _squared(of: Matrix) -> Matrix:
    return Matrix(of.ports, of.start**2, lambda values: ca.diag(values**2))


@dataclass(frozen=True)
class Entry:
    """What an entry of a matrix is: `text`; its unit in words, `{0}` being the variable's, or that unit's `power`."""

    text: str
    words: str
    power: int = 0

    def port(self, name: str, of: str, factors: Sequence[Variable], start: float, variability: str) -> Port:
        """The entry between `factors`, one variable or two; half powers of seconds have no unit expression."""
        said = units.product([(units.difference(v.unit), self.power // len(factors)) for v in factors])
        words = f", {self.words.format(units.difference(factors[0].unit) or 'its unit')}" if self.words else ""
        unit = said if self.power else units.NONE
        high = LARGEST ** max(self.power, 1)
        return Port(
            name,
            f"{self.text}{of}{words}",
            unit,
            start,
            min=SMALLEST if len(factors) == 1 else -high,
            max=high,
            variability=variability,
        )


def matrix(
    name: str, value: Given, variables: Sequence[Variable], entry: Entry, variability: str = "tunable"
) -> Matrix:
    """The tuning matrix `name` for `variables`, from a scalar, the diagonal (in their order or by their names), or the whole matrix.

    A diagonal has n parameters `tuning.<name>.<variable>`, a whole matrix n^2, `tuning.<name>[i,j]`, row by row.

    Raises:
        ModelError: a name that is none of the `variables`.
        ValueError: a wrong shape, an entry that is not finite, a diagonal entry below SMALLEST, a singular matrix.
    """
    n = len(variables)
    if isinstance(value, Mapping):
        for unknown in value.keys() - {v.name for v in variables}:
            raise ModelError(f"riccati: {name} of '{unknown}'; known: {', '.join(v.name for v in variables)}")
        value = [value.get(v.name, 1.0) for v in variables]
    given = np.asarray(value, dtype=float)
    if given.shape not in ((), (n,), (n, n)):
        raise ValueError(f"riccati: {name} has the shape {given.shape}, expected a scalar, ({n},) or ({n}, {n})")
    if not np.all(np.isfinite(given)):
        raise ValueError(f"riccati: {name} = {given.tolist()} is not finite")
    if given.ndim == 2:
        if np.linalg.matrix_rank(given) < n:
            raise ValueError(f"riccati: {name} is singular: rank {np.linalg.matrix_rank(given)} of {n}")
        made = tuple(
            entry.port(
                f"tuning.{name}[{i + 1},{j + 1}]",
                f", entry {i + 1}, {j + 1}",
                (variables[i], variables[j]),
                float(given[i, j]),
                variability,
            )
            for i, j in np.ndindex(n, n)
        )
        return Matrix(made, given, lambda values: ca.reshape(values, n, n).T)
    diagonal = np.broadcast_to(given, (n,))
    for variable, number in zip(variables, diagonal, strict=True):
        if not number >= SMALLEST:
            raise ValueError(f"riccati: {name} of '{variable.name}' = {number:g} must be at least {SMALLEST:g}")
    made = tuple(
        entry.port(f"tuning.{name}.{v.name}", f" of {v.description or v.name}", (v,), float(number), variability)
        for v, number in zip(variables, diagonal, strict=True)
    )
    return Matrix(made, np.diag(diagonal), ca.diag)
