"""A model's variables: what each scalar is called, and what is said of it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from numbers import Real
from typing import ClassVar

import casadi as ca

from observers.expressions import ModelError, described


@dataclass(frozen=True)
class Variable:
    """One named scalar: what it is, in which unit, where it starts and what it may be.

    `unit` is an FMI unit expression ("m/s", "rad/s", "1"), or "" for what may stand for anything; `start` is the value before
    anything is known, `nominal` its typical magnitude (> 0), `min` and `max` its bounds, all in `unit`. An output
    that is an angle has its period in `wrap` (2 pi in rad, 360 in degrees): what a sensor shows may be any number of turns off.
    """

    name: str
    description: str = ""
    unit: str = "1"
    start: float = 0.0
    nominal: float = 1.0
    min: float = -math.inf
    max: float = math.inf
    wrap: float = 0.0
    NEEDS_UNIT: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise ModelError(f"a variable's name is a text, not {described(self.name)}")
        for what in ("description", "unit"):
            if not isinstance(getattr(self, what), str):
                raise ModelError(f"variable '{self.name}': {what} is a text, not {described(getattr(self, what))}")
        for what in ("start", "nominal", "min", "max"):
            value = getattr(self, what)
            if isinstance(value, bool) or not isinstance(value, Real):
                raise ModelError(f"variable '{self.name}': {what} is a number, not {described(value)}")
        if self.NEEDS_UNIT and not self.unit:
            raise ModelError(
                f"variable '{self.name}': unit = '' is no unit expression; a number without a unit has '1'"
            )
        for what in ("start", "nominal"):
            if not math.isfinite(getattr(self, what)):
                raise ModelError(f"variable '{self.name}': {what} = {getattr(self, what)} is not finite")
        if not self.nominal > 0:
            raise ModelError(f"variable '{self.name}': nominal = {self.nominal:g} must be greater than 0")
        if not (self.wrap >= 0 and math.isfinite(self.wrap)):
            raise ModelError(f"variable '{self.name}': wrap = {self.wrap:g} must be the period of an angle, or 0")
        if self.min > self.max:
            raise ModelError(f"variable '{self.name}': min = {self.min:g} is greater than max = {self.max:g}")
        if not self.min <= self.start <= self.max:
            raise ModelError(
                f"variable '{self.name}': start = {self.start:g} lies outside [{self.min:g}, {self.max:g}]"
            )


UNSCALED = 30.0  # times a nominal value of 1 that nobody gave: a start value that is farther from it


def unscaled(variables: Iterable[Variable]) -> list[str]:
    """A sentence for each whose start value says that its nominal value is not 1."""
    return [
        f"nominal of '{v.name}' is 1 where it starts at {v.start:g}: give nominal, which tolerances, scales and default noises are in"
        for v in variables
        if v.nominal == 1 and v.start != 0 and not 1 / UNSCALED < abs(v.start) < UNSCALED
    ]


class Names:
    """The symbols of one group, by attribute (`x.x1`); an unknown name is a ModelError that lists the known ones."""

    def __init__(self, group: str, symbols: dict[str, ca.SX]):
        self._group = group
        self._symbols = symbols

    def __getattr__(self, name: str) -> ca.SX:
        try:
            return self._symbols[name]
        except KeyError:
            known = ", ".join(self._symbols) or "none"
            raise ModelError(f"there is no {self._group} '{name}'; known: {known}") from None
