"""Units as FMI and SSP declare them: exponents of SI units, a factor, an offset. All that a conversion needs is in the files.

A library of unit names would add nothing: names mean what the file says, and only that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from fmpy.model_description import ModelDescription
from lxml import etree

from cosim.system.transformation import Linear

EXPONENTS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


@dataclass(frozen=True)
class Unit:
    """A unit: value in SI units = factor * value + offset (FMI 2.0, 2.2.2); exponents of `EXPONENTS`, (8,)."""

    name: str
    exponents: tuple[int, ...]
    factor: float = 1.0
    offset: float = 0.0

    @property
    def neutral(self) -> bool:
        """Dimensionless: fits any, because generic sources of several tools say so and stand for anything."""
        return not any(self.exponents) and (self.factor, self.offset) == (1.0, 0.0)


def conversion(source: Unit | None, target: Unit | None) -> Linear:
    """What makes a value in `source` one in `target`. No unit, and a dimensionless one, fits any other and changes nothing.

    Raises:
        ValueError: other exponents, or a factor that is no number to divide by.
    """
    if source is None or target is None or source.neutral or target.neutral:
        return Linear()
    if source.exponents != target.exponents:
        raise ValueError(
            f"the units '{source.name}' and '{target.name}' differ, and not by a factor and an offset only"
        )
    for unit in (source, target):
        if unit.factor == 0 or not (math.isfinite(unit.factor) and math.isfinite(unit.offset)):
            raise ValueError(f"the unit '{unit.name}' has the factor {unit.factor:g} and the offset {unit.offset:g}")
    if (source.factor, source.offset) == (target.factor, target.offset):
        return Linear()
    return Linear(source.factor / target.factor, (source.offset - target.offset) / target.factor)


def fmu_units(description: ModelDescription) -> dict[str, Unit]:
    """The units that an FMU defines, by name; without those of which it says nothing but the name."""
    return {
        u.name: Unit(
            u.name,
            tuple(int(getattr(u.baseUnit, key)) for key in EXPONENTS),
            float(u.baseUnit.factor),
            float(u.baseUnit.offset),
        )
        for u in description.unitDefinitions
        if u.baseUnit is not None
    }


def ssp_units(parent: etree._Element) -> dict[str, Unit]:
    """The units that the Units element under `parent` defines, by name."""
    found = {}
    for unit in parent.iterfind("{*}Units/{*}Unit"):
        base = unit.find("{*}BaseUnit")
        exponents = tuple(int(base.get(key, 0)) for key in EXPONENTS)
        found[unit.get("name")] = Unit(
            unit.get("name"), exponents, float(base.get("factor", 1)), float(base.get("offset", 0))
        )
    return found
