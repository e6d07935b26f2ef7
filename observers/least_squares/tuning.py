"""How much a sample and the state after a reset weigh, as parameters: the paper's gamma and p0, or standard deviations by name.

A sample adds w w' / measurement_noise^2 to the information Y, as gamma = 1 / (measurement_noise^2 Ts) would; after a reset P_o is
diag(initial_std^2) instead of p0 I. A process noise has no meaning here: the reset, every T, forgets in its place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from observers import ports, units
from observers.component import Port
from observers.linearisation import Linearisation
from observers.model import Model, ModelError
from observers.numerics.finite import HUGE

METHOD = "least_squares"
SMALLEST = 1e-12  # a weight; a standard deviation relative to the nominal value
RESET_STD = ports.Deviation("standard deviation, at the start and after each reset, of")


@dataclass(frozen=True)
class Weight:
    """Its parameters, and whether they are standard deviations by name or the paper's one scalar."""

    ports: tuple[Port, ...]
    by_name: bool


def refuse_process_noise(given: Mapping[str, float] | None) -> None:
    """Raise a ModelError if there is one: the method has no place for it."""
    if given is not None:
        raise ModelError(
            f"{METHOD}: process_noise has no meaning here: a reset every T forgets in its place; give a shorter T, or take riccati"
        )


def sample_weight(model: Model, gamma: float | None, measurement_noise: Mapping[str, float] | None) -> Weight:
    """`tuning.gamma` (1 if absent), or `tuning.measurement_noise.<output>`.

    Raises:
        ValueError: both are given; a gamma that is not positive and finite.
        ModelError: a name that is no output, a deviation out of range.
    """
    ports.refuse_both(METHOD, "gamma", gamma, "measurement_noise", measurement_noise)
    if measurement_noise is not None:
        made = ports.deviations(
            METHOD,
            "measurement_noise",
            ports.MEASUREMENT_NOISE,
            model.outputs,
            measurement_noise,
            0.1,
            smallest=SMALLEST,
        )
        return Weight(made, by_name=True)
    unit = units.product([(units.common(model.outputs), -2), ("s", -1)])
    return _scalar("gamma", gamma, "least-squares gain", unit)


def reset_weight(line: Linearisation, p0: float | None, initial_std: Mapping[str, float] | None) -> Weight:
    """`tuning.p0` (1 if absent), or `tuning.initial_std.<state or unknown parameter>`: of the guess, and again after each reset.

    Raises:
        ValueError: both are given; a p0 that is not positive and finite.
        ModelError: a name that is not estimated, a deviation out of range.
    """
    ports.refuse_both(METHOD, "p0", p0, "initial_std", initial_std)
    if initial_std is not None:
        made = ports.deviations(METHOD, "initial_std", RESET_STD, line.variables, initial_std, 1.0, smallest=SMALLEST)
        return Weight(made, by_name=True)
    return _scalar("p0", p0, "what P_o is reset to", units.power(units.common(line.variables), 2))


def _scalar(name: str, given: float | None, description: str, unit: str) -> Weight:
    start = 1.0 if given is None else given
    if not 0 < start < HUGE:
        raise ValueError(f"{METHOD}: {name} = {start:g} must be positive and finite")
    port = Port(f"tuning.{name}", description, unit, start, min=SMALLEST, variability="tunable")
    return Weight((port,), by_name=False)


def information(reset: Weight, values: Any, n: int) -> Any:
    """Y after a reset, a column (n^2): I / p0 or diag(1 / initial_std^2)."""
    if reset.by_name:
        return ca.vec(ca.densify(ca.diag(1 / values**2)))
    return ca.vec(ca.DM.eye(n).full()) / values
