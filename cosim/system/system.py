"""A system: FMUs under names, values for their parameters, connections, connectors of its own, and the experiment to run."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from cosim.fmu import Value
from cosim.system.route import Quantity, Route
from cosim.system.units import Unit


@dataclass(frozen=True)
class Connector:
    """What a file says of a connector, of the system or of an element.

    Attributes:
        kind: "input", "output", "parameter", "calculatedParameter", "inout", and what FMI knows besides.
        type: "Real", "Integer", "Boolean", "Enumeration", "String"; None where the file does not say.
        unit: of a Real; None where the file does not say.
    """

    kind: str
    type: str | None = None
    unit: Unit | None = None


@dataclass(frozen=True)
class Element:
    """One instance of an FMU.

    Attributes:
        fmu: its file.
        parameters: the values that its variables get before the run, by name.
        connectors: what a file says of its variables, by name: the FMU must agree.
        lenient: names in `parameters` that the FMU does not have are left out, with a note, as SSP demands of its files.
    """

    fmu: Path
    parameters: Mapping[str, Value | Quantity] = field(default_factory=dict)
    connectors: Mapping[str, Connector] = field(default_factory=dict)
    lenient: bool = False


@dataclass(frozen=True)
class System:
    """FMUs that exchange values.

    Attributes:
        name: what the system is called.
        elements: instances by name. Those of a nested system have its name before theirs, with a dot: "car.engine".
        connections: pairs `("plant.y", "observer.y")`: an output, then the input that it drives. A connector of the system
            stands by its name: `("u", "plant.u")`, `("plant.y", "y")`.
        start, stop, step: the default experiment [s]. Without a `stop` the longest of the FMUs' default experiments
            counts, without a `step` the smallest of their step sizes.
        description: one sentence for whoever opens the file.
        connectors: the system's own, by name.
        routes: what happens to values on the way, by the end of the connection; without one, units are converted.
        notes: what whoever runs it should know.
    """

    name: str
    elements: Mapping[str, Element]
    connections: Sequence[tuple[str, str]] = ()
    start: float = 0.0
    stop: float | None = None
    step: float | None = None
    description: str = ""
    connectors: Mapping[str, Connector] = field(default_factory=dict)
    routes: Mapping[str, Route] = field(default_factory=dict)
    notes: Sequence[str] = ()


def element_of(path: str, elements: Collection[str]) -> str | None:
    """The element that `<element>.<variable>` begins with; None if it is none of the `elements`.

    An element of a nested system has dots in its name; no element's name begins with another's and a dot.
    """
    parts = path.split(".")
    return next((name for i in range(1, len(parts)) if (name := ".".join(parts[:i])) in elements), None)
