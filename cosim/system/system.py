"""A system: FMUs under plain names, values for their parameters, connections, and the experiment to run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from fmpy.model_description import ModelDescription, ModelVariable

from cosim.errors import ExperimentError, SystemFileError, suggest
from cosim.fmu import Value, read_description, typed_value, unit_of

INTEGERS = ("Integer", "Enumeration")  # the two types that travel as fmi2Integer
BASE_UNIT = ("kg", "m", "s", "A", "K", "mol", "cd", "rad", "factor", "offset")
_DIMENSIONLESS = (0.0,) * 8 + (1.0, 0.0)


@dataclass(frozen=True)
class Element:
    """One instance of an FMU, and the values that its variables get before initialisation, by name."""

    fmu: Path
    parameters: Mapping[str, Value] = field(default_factory=dict)


@dataclass(frozen=True)
class System:
    """FMUs that exchange values.

    Attributes:
        name: what the system is called.
        elements: instances by name; a name holds no dot.
        connections: pairs `("plant.y", "observer.y")`: an output, then the input that it drives.
        start, stop, step: the default experiment [s]. Without a `stop` the longest of the FMUs' default experiments
            counts, without a `step` the smallest of their step sizes.
        description: one sentence for whoever opens the file.
    """

    name: str
    elements: Mapping[str, Element]
    connections: Sequence[tuple[str, str]] = ()
    start: float = 0.0
    stop: float | None = None
    step: float | None = None
    description: str = ""


@dataclass(frozen=True)
class Connection:
    """An output of one element that drives an input of another."""

    source: str
    output: ModelVariable
    target: str
    input: ModelVariable

    def __str__(self) -> str:
        return f"{self.source}.{self.output.name} -> {self.target}.{self.input.name}"


@dataclass(frozen=True)
class ResolvedSystem:
    """A system whose every name has been found in its FMUs.

    Attributes:
        system: what was resolved.
        descriptions: the model description of each element.
        variables: the variables of each element by name.
        connections: the connections, in the system's order.
        parameters: each element's parameter values, typed as their variables are.
    """

    system: System
    descriptions: dict[str, ModelDescription]
    variables: dict[str, dict[str, ModelVariable]]
    connections: list[Connection]
    parameters: dict[str, dict[str, Value]]

    def drivers(self) -> dict[str, str]:
        """The path of the output that drives each connected input, by the input's path."""
        return {f"{c.target}.{c.input.name}": f"{c.source}.{c.output.name}" for c in self.connections}

    def upstream(self) -> dict[str, frozenset[str]]:
        """For each element those whose outputs reach its inputs, directly or through others."""
        found = {name: {c.source for c in self.connections if c.target == name} for name in self.system.elements}
        for _ in found:  # the longest way passes each once
            for name, sources in found.items():
                found[name] = sources.union(*(found[source] for source in sources))
        return {name: frozenset(sources) for name, sources in found.items()}

    def experiment(self, stop: float | None = None, step: float | None = None) -> tuple[float, float]:
        """Stop time and step [s]: as given, else as the system says, else as its FMUs' default experiments say.

        Raises:
            ExperimentError: nobody says.
        """
        defaults = [d.defaultExperiment for d in self.descriptions.values() if d.defaultExperiment is not None]
        stops = [float(d.stopTime) for d in defaults if d.stopTime is not None]
        steps = [float(d.stepSize) for d in defaults if d.stepSize is not None]
        return (
            self._first("stop time", stop, self.system.stop, max(stops, default=None)),
            self._first("step size", step, self.system.step, min(steps, default=None)),
        )

    def _first(self, what: str, *candidates: float | None) -> float:
        for value in candidates:
            if value is not None:
                return value
        raise ExperimentError(f"system '{self.system.name}' and its FMUs name no {what}: give one")


def resolve(system: System) -> ResolvedSystem:
    """Read the FMUs of `system` and look up every name in them.

    Raises:
        SystemFileError: an FMU that cannot be used, an unknown element or variable, a parameter value of the wrong
            kind, a connection whose ends do not fit together, an input that is driven twice.
    """
    if not system.elements:
        raise SystemFileError(f"system '{system.name}' has no elements")
    read: dict[Path, ModelDescription] = {}
    for name, element in system.elements.items():
        if not name or "." in name:
            raise SystemFileError(f"system '{system.name}': element name '{name}' must not be empty or hold a dot")
        if element.fmu not in read:
            read[element.fmu] = read_description(element.fmu)
        elif read[element.fmu].coSimulation.canBeInstantiatedOnlyOncePerProcess:
            raise SystemFileError(f"element '{name}': {element.fmu.name} can be instantiated only once per process")
    descriptions = {name: read[element.fmu] for name, element in system.elements.items()}
    variables = {name: {v.name: v for v in d.modelVariables} for name, d in descriptions.items()}
    connections = _connect(system, descriptions, variables)
    parameters: dict[str, dict[str, Value]] = {name: {} for name in system.elements}
    for name, element in system.elements.items():
        for variable, value in element.parameters.items():
            try:
                found = find_variable(variables, f"{name}.{variable}")[1]
                parameters[name][variable] = typed_value(found, value)
            except ValueError as error:
                raise SystemFileError(f"system '{system.name}', parameters of '{name}': {error}") from None
    return ResolvedSystem(system, descriptions, variables, connections, parameters)


def find_variable(variables: Mapping[str, Mapping[str, ModelVariable]], path: str) -> tuple[str, ModelVariable]:
    """Element name and variable of `<element>.<variable>`.

    Raises:
        ValueError: there is none; the message lists near matches.
    """
    element, dot, name = path.partition(".")
    if not dot or not name:
        raise ValueError(f"'{path}' is not of the form <element>.<variable>")
    if element not in variables:
        raise ValueError(f"there is no element '{element}' ({path}); {suggest(element, variables)}")
    if name not in variables[element]:
        raise ValueError(f"element '{element}' has no variable '{name}'; {suggest(name, variables[element])}")
    return element, variables[element][name]


def _connect(
    system: System, descriptions: Mapping[str, ModelDescription], variables: Mapping[str, Mapping[str, ModelVariable]]
) -> list[Connection]:
    connections: list[Connection] = []
    drivers: dict[str, str] = {}
    for start, end in system.connections:
        try:
            (source, output), (target, goal) = find_variable(variables, start), find_variable(variables, end)
        except ValueError as error:
            raise SystemFileError(f"system '{system.name}', connection {start} -> {end}: {error}") from None
        connection = Connection(source, output, target, goal)
        if output.causality != "output":
            raise SystemFileError(
                f"connection {connection}: '{start}' is no output (its causality is {output.causality})"
            )
        if goal.causality != "input":
            raise SystemFileError(f"connection {connection}: '{end}' is no input (its causality is {goal.causality})")
        if output.type != goal.type and not (output.type in INTEGERS and goal.type in INTEGERS):
            raise SystemFileError(f"connection {connection}: the types {output.type} and {goal.type} differ")
        if output.type == "String":
            raise SystemFileError(f"connection {connection}: text cannot be exchanged")
        if end in drivers:
            raise SystemFileError(
                f"system '{system.name}': input '{end}' is driven by '{drivers[end]}' and by '{start}'"
            )
        drivers[end] = start
        _check_units(connection, descriptions)
        connections.append(connection)
    return connections


def _check_units(connection: Connection, descriptions: Mapping[str, ModelDescription]) -> None:
    """Values pass unconverted, so ends that declare different units must be refused.

    An end without a unit fits any other: a generic source (a sine, a ramp) does not know what it stands for. So does a
    dimensionless one: sources of other tools say so and mean the same.
    """
    ends = ((connection.source, connection.output), (connection.target, connection.input))
    units = [_base_unit(descriptions[element], unit_of(variable)) for element, variable in ends]
    if None in units or _DIMENSIONLESS in units or units[0] == units[1]:
        return
    output, goal = unit_of(connection.output), unit_of(connection.input)
    raise SystemFileError(f"connection {connection}: the units '{output}' and '{goal}' differ; nothing converts them")


def _base_unit(description: ModelDescription, unit: str) -> tuple[float, ...] | None:
    """SI exponents, factor and offset of a unit; None if the FMU does not define it."""
    base = next((u.baseUnit for u in description.unitDefinitions if u.name == unit), None)
    return None if base is None else tuple(float(getattr(base, key)) for key in BASE_UNIT)
