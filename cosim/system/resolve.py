"""Looks up every name of a system in its FMUs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fmpy.model_description import ModelDescription, ModelVariable

from cosim.errors import SystemFileError, suggest
from cosim.fmu import Value, read_fmu, typed_value, unit_of
from cosim.system.resolved import Connection, Exposure, ResolvedSystem, Supply, listed
from cosim.system.route import Quantity, Route, conversions, fitted
from cosim.system.ssp_reader import read_ssp
from cosim.system.system import Connector, Element, System, element_of
from cosim.system.transformation import Transformation, apply
from cosim.system.units import Unit, fmu_units

INTEGERS = ("Integer", "Enumeration")  # the two types that travel as fmi2Integer


def resolve(system: System) -> ResolvedSystem:
    """Read the FMUs of `system` and look up every name in them.

    Raises:
        SystemFileError: an FMU that cannot be used, an unknown element or variable, a parameter value of the wrong
            kind, a connection whose ends do not fit together, an input that is driven twice.
    """
    if not system.elements:
        raise SystemFileError(f"system '{system.name}' has no elements")
    _check_names(system)
    read: dict[Path, tuple[ModelDescription, dict[str, ModelVariable], dict[str, Unit]]] = {}
    stateless: set[Path] = set()
    for name, element in system.elements.items():
        if element.fmu not in read:
            made, static = read_fmu(element.fmu)
            stateless |= {element.fmu} if static else set()
            read[element.fmu] = (made, {v.name: v for v in made.modelVariables}, fmu_units(made))
        elif read[element.fmu][0].coSimulation.canBeInstantiatedOnlyOncePerProcess:
            raise SystemFileError(f"element '{name}': {element.fmu.name} can be instantiated only once per process")
    descriptions = {name: read[element.fmu][0] for name, element in system.elements.items()}
    variables = {name: read[element.fmu][1] for name, element in system.elements.items()}
    units = {name: read[element.fmu][2] for name, element in system.elements.items()}
    notes = list(system.notes)
    for name, element in system.elements.items():
        _check_connectors(name, element, variables[name])
    connections, supplies, exposures = _Ends(system, variables, units).connect()
    unknown: list[str] = []
    parameters = {
        name: _parameters(system.name, name, element, variables[name], units[name], unknown)
        for name, element in system.elements.items()
    }
    if unknown:
        notes.append(f"parameters of which the elements know nothing are left out: {listed(unknown)}")
    static_elements = frozenset(name for name, element in system.elements.items() if element.fmu in stateless)
    return ResolvedSystem(
        system, descriptions, variables, static_elements, connections, supplies, exposures, parameters, notes
    )


def resolve_ssp(path: Path, directory: Path) -> ResolvedSystem:
    """The system in the .ssp file at `path`; its FMUs are written to `directory`, of which messages do not speak.

    Raises:
        SystemFileError: as `cosim.system.read_ssp` and `resolve`.
    """
    try:
        return resolve(read_ssp(path, directory))
    except SystemFileError as error:
        raise SystemFileError(str(error).replace(f"{directory}/", f"{path}: ")) from None


def find_variable(variables: Mapping[str, Mapping[str, ModelVariable]], path: str) -> tuple[str, ModelVariable]:
    """Element name and variable of `<element>.<variable>`.

    Raises:
        ValueError: there is none; the message lists near matches.
    """
    parts = path.split(".")
    if len(parts) < 2 or not all(parts[:2]):
        raise ValueError(f"'{path}' is not of the form <element>.<variable>")
    element = element_of(path, variables)
    if element is None:
        raise ValueError(f"there is no element '{parts[0]}' ({path}); {suggest(parts[0], variables)}")
    name = path[len(element) + 1 :]
    if name not in variables[element]:
        raise ValueError(f"element '{element}' has no variable '{name}'; {suggest(name, variables[element])}")
    return element, variables[element][name]


def _check_names(system: System) -> None:
    for name in system.elements:
        parts = name.split(".")
        if not all(parts):
            raise SystemFileError(f"system '{system.name}': element name '{name}' must not be empty, nor a part of it")
        for i in range(1, len(parts)):
            if ".".join(parts[:i]) in system.elements:
                raise SystemFileError(
                    f"system '{system.name}': the names of the elements '{'.'.join(parts[:i])}' and '{name}' are ambiguous"
                )


def _check_connectors(name: str, element: Element, variables: Mapping[str, ModelVariable]) -> None:
    """What the file says of the element's connectors is what the FMU says."""
    for label, connector in element.connectors.items():
        variable = variables.get(label)
        if variable is None:
            raise SystemFileError(
                f"element '{name}': its FMU has no variable '{label}' for the connector; {suggest(label, variables)}"
            )
        if connector.kind != variable.causality:
            raise SystemFileError(
                f"element '{name}': connector '{label}' is of the kind {connector.kind}, the FMU's variable of {variable.causality}"
            )
        if connector.type is not None and not _alike(connector.type, variable.type):
            raise SystemFileError(
                f"element '{name}': connector '{label}' is of the type {connector.type}, the FMU's variable of {variable.type}"
            )


def _alike(one: str, other: str) -> bool:
    return one == other or (one in INTEGERS and other in INTEGERS)


def _parameters(
    system: str,
    name: str,
    element: Element,
    variables: Mapping[str, ModelVariable],
    units: Mapping[str, Unit],
    unknown: list[str],
) -> dict[str, Value]:
    found: dict[str, Value] = {}
    for label, given in element.parameters.items():
        if label not in variables and element.lenient:
            unknown.append(f"{name}.{label}")
            continue
        try:
            variable = find_variable({name: variables}, f"{name}.{label}")[1]
            found[label] = parameter_value(variable, given, units)
        except (ValueError, OverflowError) as error:
            raise SystemFileError(f"system '{system}', parameters of '{name}': {error}") from None
    return found


def parameter_value(variable: ModelVariable, given: Value | Quantity, units: Mapping[str, Unit]) -> Value:
    """What a file gives `variable`, in the unit that it has among the `units` of its FMU.

    Raises:
        ValueError, OverflowError: it cannot be set, or not to this.
    """
    if not isinstance(given, Quantity):
        return typed_value(variable, given)
    steps = fitted(conversions(given.route, None, units.get(unit_of(variable))), None, variable)
    value = apply(steps, float(given.value) if variable.type == "Real" and steps else given.value)
    return typed_value(variable, value)


class _Ends:
    """The ends of the system's connections, found in its FMUs and connectors."""

    def __init__(
        self,
        system: System,
        variables: Mapping[str, Mapping[str, ModelVariable]],
        units: Mapping[str, Mapping[str, Unit]],
    ):
        self._system, self._variables, self._units = system, variables, units
        self._drivers: dict[str, str] = {}

    def connect(self) -> tuple[list[Connection], list[Supply], list[Exposure]]:
        connections, supplies, exposures = [], [], []
        own = self._system.connectors
        for start, end in self._system.connections:
            label = f"connection {start} -> {end}"
            try:
                if start in own:
                    target, variable = find_variable(self._variables, end)
                    if own[start].kind != variable.causality or variable.type == "String":
                        raise ValueError(
                            f"'{start}' is an {own[start].kind}, '{end}' a {variable.causality} ({variable.type})"
                        )
                    steps = self._steps(end, own[start].unit, self._unit(target, variable), None, variable)
                    self._check_type(start, own[start], variable)
                    supplies.append(Supply(start, target, variable, steps))
                elif end in own:
                    source, output = self._output(start)
                    unit = own[end].unit or self._unit(source, output)
                    steps = self._steps(end, self._unit(source, output), unit, output, output)
                    self._check_type(end, own[end], output)
                    exposures.append(Exposure(end, source, output, steps, unit.name if unit else ""))
                else:
                    connections.append(self._connection(start, end))
            except ValueError as error:
                if isinstance(error, SystemFileError):
                    raise
                raise SystemFileError(f"system '{self._system.name}', {label}: {error}") from None
            if end in self._drivers:
                raise SystemFileError(
                    f"system '{self._system.name}': input '{end}' is driven by '{self._drivers[end]}' and by '{start}'"
                )
            self._drivers[end] = start
        return connections, supplies, exposures

    def _connection(self, start: str, end: str) -> Connection:
        (source, output), (target, goal) = self._output(start), find_variable(self._variables, end)
        if goal.causality != "input":
            raise ValueError(f"'{end}' is no input (its causality is {goal.causality})")
        if not _alike(output.type, goal.type):
            raise ValueError(f"the types {output.type} and {goal.type} differ")
        steps = self._steps(end, self._unit(source, output), self._unit(target, goal), output, goal)
        return Connection(source, output, target, goal, steps)

    def _output(self, path: str) -> tuple[str, ModelVariable]:
        element, variable = find_variable(self._variables, path)
        if variable.causality != "output":
            raise ValueError(f"'{path}' is no output (its causality is {variable.causality})")
        if variable.type == "String":
            raise ValueError("text cannot be exchanged")
        return element, variable

    def _unit(self, element: str, variable: ModelVariable) -> Unit | None:
        return self._units[element].get(unit_of(variable))

    def _steps(
        self, end: str, source: Unit | None, target: Unit | None, output: ModelVariable | None, goal: ModelVariable
    ) -> tuple[Transformation, ...]:
        return fitted(conversions(self._system.routes.get(end, Route()), source, target), output, goal)

    def _check_type(self, name: str, connector: Connector, variable: ModelVariable) -> None:
        if connector.type is not None and not _alike(connector.type, variable.type):
            raise ValueError(f"the connector '{name}' is of the type {connector.type}, the variable of {variable.type}")
