"""The way of a value from one variable to another: connectors with units, connections with transformations."""

from __future__ import annotations

from dataclasses import dataclass

from fmpy.model_description import ModelVariable

from cosim.fmu import Value, enumeration_items
from cosim.system.transformation import ItemTable, Linear, Transformation, merged
from cosim.system.units import Unit, conversion


@dataclass(frozen=True)
class Hop:
    """One connection (or mapping of a parameter) and the connector that it leads to.

    Attributes:
        unit: of that connector; None: that of what it stands for.
        suppressed: values keep their number, whatever the units.
        transformation: after the conversion of units.
    """

    unit: Unit | None = None
    suppressed: bool = False
    transformation: Transformation | None = None


@dataclass(frozen=True)
class Route:
    """A way: the unit of the connector that it starts from (None: that of what it stands for), and its hops."""

    unit: Unit | None = None
    hops: tuple[Hop, ...] = (Hop(),)


@dataclass(frozen=True)
class Quantity:
    """The value of a parameter as a file gives it: in a unit, and with a way of its own to the variable."""

    value: Value
    route: Route


def conversions(route: Route, source: Unit | None, target: Unit | None) -> list[Transformation]:
    """What happens along `route` from a variable in `source` to one in `target` (units; None: not known, fits any).

    Raises:
        ValueError: units of other dimensions meet.
    """
    steps: list[Transformation] = []
    if route.unit is not None:
        steps.append(conversion(source, route.unit))
    unit = route.unit or source
    for i, hop in enumerate(route.hops):
        goal = hop.unit or (target if i == len(route.hops) - 1 else None)
        if not hop.suppressed:
            steps.append(conversion(unit, goal))
        if hop.transformation is not None:
            steps.append(hop.transformation)
        unit = goal or unit
    last = route.hops[-1].unit if route.hops else route.unit
    if last is not None:
        steps.append(conversion(last, target))
    return steps


def fitted(
    steps: list[Transformation], source: ModelVariable | None, target: ModelVariable
) -> tuple[Transformation, ...]:
    """`steps`, if they suit the variables' types; tables of item names by numbers. Without a `source` it is a parameter.

    Raises:
        ValueError: a linear transformation of what is no Real, a table of what is no whole number.
    """
    made: list[Transformation] = []
    for step in merged(steps):
        if isinstance(step, ItemTable) and source is not None:
            step = step.numbered(enumeration_items(source), enumeration_items(target))
        kinds = _kinds(step)
        for variable in (target, source or target):
            if variable.type not in kinds:
                raise ValueError(
                    f"a transformation for {' and '.join(kinds)} meets the {variable.type} '{variable.name}'"
                )
        made.append(step)
    return tuple(made)


def _kinds(step: Transformation) -> tuple[str, ...]:
    """The types of variables that `step` suits."""
    if isinstance(step, Linear):
        return ("Real",)
    if isinstance(step, ItemTable):
        return ("Enumeration",)
    return ("Boolean",) if step.boolean else ("Integer", "Enumeration")
