"""How much the least-squares observer trusts its samples and its guess: the paper's gamma and p0, or standard deviations by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import casadi as ca

from observers import ports, units
from observers.component import Port
from observers.least_squares.information import contraction
from observers.model import Model, Variable
from observers.numerics.finite import HUGE

SMALLEST_WEIGHT, LARGEST_WEIGHT = 1e-12, 1e60  # of gamma and p0
SMALLEST_STD = 1e-9  # relative to the nominal value: a weight is one over its square


@dataclass(frozen=True)
class Weights:
    """The tuning parameters `samples` and `prior`, and which way they say it: `by_noise` instead of gamma, `by_std` instead of p0.

    `noise_known`: whether the samples' weight is what the user says the noise is.
    """

    samples: tuple[Port, ...]
    prior: tuple[Port, ...]
    by_noise: bool
    by_std: bool
    noise_known: bool = False

    @property
    def ports(self) -> tuple[Port, ...]:
        return (*self.samples, *self.prior)

    def of_sample(self, values: Any, Ts: Any) -> tuple[Any, Any]:
        """(g, sigma) of `samples`' values: a sample adds g w_o w_o', each output in units of its sigma (ny; empty: as it is)."""
        return (ca.MX(1), values) if self.by_noise else (values * Ts, ca.MX(0, 1))

    def information(self, values: Any, n: int) -> Any:
        """P_o^-1 at a reset (n^2), of `prior`'s values."""
        return ca.vec(ca.densify(ca.diag(1 / values**2))) if self.by_std else ca.DM.eye(n).full().ravel() / values

    def covariance(self, values: Any, n: int) -> Any:
        """P_o at a reset (n^2), of `prior`'s values."""
        return ca.vec(ca.densify(ca.diag(values**2))) if self.by_std else ca.DM.eye(n).full().ravel() * values

    def contraction(self, Phi: Any, Y: Any, values: Any) -> Any:
        """What `contraction` says of an interval; by deviations, of the error in units of these."""
        n = Phi.shape[0]
        if not self.by_std:
            return contraction(n)(Phi, Y, values)
        return contraction(n)(ca.diag(1 / values) @ Phi @ ca.diag(values), ca.diag(values) @ Y @ ca.diag(values), 1)


def weights(
    model: Model,
    variables: Sequence[Variable],
    gamma: float | None,
    p0: float | None,
    measurement_noise: Mapping[str, float] | None,
    initial_std: Mapping[str, float] | None,
) -> Weights:
    """Each of the two one way or the other; given neither way, 1, or where a deviation is given, the deviation's own default.

    Raises:
        ModelError: a deviation of something that is not estimated or measured.
        ValueError: both ways at once, gamma or p0 not positive and finite, or out of their parameter's range.
    """
    for what, value, other, deviations in (
        ("gamma", gamma, "measurement_noise", measurement_noise),
        ("p0", p0, "initial_std", initial_std),
    ):
        ports.refuse_both("least_squares", what, value, other, deviations)
        if value is not None and not 0 < value < HUGE:
            raise ValueError(f"least_squares: {what} = {value:g} must be positive and finite")
    by_name = measurement_noise is not None or initial_std is not None
    by_noise, by_std = by_name and gamma is None, by_name and p0 is None
    samples, prior = _paper(model, variables, gamma, p0)
    if by_noise:
        samples = _deviations("measurement_noise", ports.MEASUREMENT_NOISE, model.outputs, measurement_noise, 0.1)
    if by_std:
        prior = _deviations("initial_std", ports.INITIAL_STD, variables, initial_std, 1.0)
    return Weights(samples, prior, by_noise, by_std, measurement_noise is not None)


def _paper(
    model: Model, variables: Sequence[Variable], gamma: float | None, p0: float | None
) -> tuple[tuple[Port, ...], tuple[Port, ...]]:
    per_sample = units.product([(units.common(model.outputs), -2), ("s", -1)])
    squared = units.power(units.common(variables), 2)
    first = 1.0 if gamma is None else gamma
    second = 1.0 if p0 is None else p0
    weight = partial(Port, min=SMALLEST_WEIGHT, max=LARGEST_WEIGHT, variability="tunable")
    return (
        (weight("tuning.gamma", "least-squares gain", per_sample, first),),
        (weight("tuning.p0", "what P_o is reset to", squared, second),),
    )


def _deviations(
    group: str, what: ports.Deviation, variables: Sequence[Variable], values: Mapping[str, float] | None, part: float
) -> tuple[Port, ...]:
    return ports.deviations("least_squares", group, what, variables, values, part, smallest=SMALLEST_STD)
