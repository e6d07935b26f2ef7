"""modelDescription.xml of a component, as FMI 2.0.4 wants it for co-simulation."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lxml import etree

from fmu_src.description import units
from fmu_src.description.dependencies import dependencies
from fmu_src.errors import ExportError
from observers import __version__
from observers.component import Component, Enumeration, Port, bounds

TOOL = f"observer-fmus {__version__}"
LICENSE = "BSD-2-Clause"
LOG_CATEGORIES = {
    "logStatusError": "calls that were refused, each with the variable, value and limit",
    "logStatusWarning": "steps in which a counter of troubles rose",
    "logStatusDiscard": "status queries that have no answer",
    "logEvents": "initialization, termination and reset",
    "logAll": "all of these",
}

_NAME = re.compile(r"[A-Za-z_]\w*(\[\d+(,\d+)*\])?(\.[A-Za-z_]\w*(\[\d+(,\d+)*\])?)*\Z", re.ASCII)
_IDENTIFIER = re.compile(r"[A-Za-z_]\w*\Z", re.ASCII)
_CONTROL = re.compile(r"[^\t\n\r\x20-\uD7FF\uE000-\uFFFD\U00010000-\U0010FFFF]")  # what XML 1.0 cannot hold
_VARIABILITIES = {
    "input": ("continuous", "discrete"),
    "parameter": ("fixed", "tunable"),
    "output": ("continuous", "discrete"),
    "constant": ("constant",),
}


@dataclass(frozen=True)
class Entry:
    """A port and what it is in the FMU; the value reference is its place among the entries."""

    port: Port
    group: str  # input, parameter, output or constant

    @property
    def causality(self) -> str:
        return "local" if self.group == "constant" or self.port.local else self.group

    @property
    def initial(self) -> str | None:
        return {"input": None, "parameter": "exact", "output": "calculated", "constant": "exact"}[self.group]


def entries(component: Component) -> list[Entry]:
    """All variables in the order of their value references."""
    groups = {
        "input": component.inputs,
        "parameter": component.parameters,
        "output": component.outputs,
        "constant": component.constants,
    }
    return [Entry(port, group) for group, ports in groups.items() for port in ports]


def describe(
    component: Component, guid: str, source_files: Sequence[str] = (), capabilities: Mapping[str, str] | None = None
) -> bytes:
    """The XML document; `capabilities` are attributes of CoSimulation that differ from the native FMU's.

    Raises:
        ExportError: a name, unit, type or variability that FMI does not allow; the message names the variable.
    """
    variables = entries(component)
    _check(component, variables)
    root = etree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=component.name,
        guid=guid,
        description=component.description,
        author="observer-fmus",
        version=__version__,
        license=LICENSE,
        generationTool=TOOL,
        variableNamingConvention="structured",
    )
    slave = etree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=component.name,
        needsExecutionTool="false",
        canHandleVariableCommunicationStepSize="true",
        canInterpolateInputs="true",
        maxOutputDerivativeOrder="0",
        canRunAsynchronuously="false",
        canBeInstantiatedOnlyOncePerProcess="false",
        canNotUseMemoryManagementFunctions="false",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
        providesDirectionalDerivative="false",
    )
    slave.attrib.update(capabilities or {})
    if source_files:
        files = etree.SubElement(slave, "SourceFiles")
        for name in source_files:
            etree.SubElement(files, "File", name=name)
    _unit_definitions(root, component, variables)
    _type_definitions(root, component, variables)
    categories = etree.SubElement(root, "LogCategories")
    for name, description in LOG_CATEGORIES.items():
        etree.SubElement(categories, "Category", name=name, description=description)
    etree.SubElement(
        root,
        "DefaultExperiment",
        startTime="0",
        stopTime=_real(component.stop_time),
        stepSize=_real(component.step_size),
    )
    if component.start.size1_out(0) == 0:
        # FMI has no word for it: outputs that follow from inputs, parameters and time alone. A master that knows can make this
        # FMU step last, with the others' newest outputs, and so lose no step on the way (cosim.master.schedule).
        annotations = etree.SubElement(root, "VendorAnnotations")
        etree.SubElement(etree.SubElement(annotations, "Tool", name="observer-fmus"), "Static")
    model_variables = etree.SubElement(root, "ModelVariables")
    for reference, entry in enumerate(variables):
        _scalar_variable(model_variables, reference, entry)
    _model_structure(root, component, variables)
    document: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return document


def _check(component: Component, variables: list[Entry]) -> None:
    where = f"component '{component.name}'"
    if not _IDENTIFIER.match(component.name):
        raise ExportError(f"{where}: the name must be a C identifier, it names the FMU's files and functions")
    if not variables:
        raise ExportError(f"{where} has no variables")
    if _CONTROL.search(component.description):
        raise ExportError(f"{where}: its description {component.description!r} holds control characters")
    for entry in variables:
        port = entry.port
        if _CONTROL.search(port.description):
            raise ExportError(
                f"{where}: the description {port.description!r} of '{port.name}' holds control characters"
            )
        if not _NAME.match(port.name):
            raise ExportError(f"{where}: '{port.name}' is no structured variable name such as a.b[1]")
        if port.kind not in ("Real", "Integer", "Boolean", "Enumeration") or (port.kind == "Enumeration") != (
            port.enumeration is not None
        ):
            raise ExportError(
                f"{where}: '{port.name}' is of kind '{port.kind}'; known: Real, Integer, Boolean, "
                "Enumeration (with its enumeration)"
            )
        if entry.group == "input" and port.kind not in ("Real", "Boolean"):
            raise ExportError(
                f"{where}: the input '{port.name}' is of kind '{port.kind}', inputs must be Real or Boolean"
            )
        if entry.group != "constant" and port.variability not in _VARIABILITIES[entry.group]:
            allowed = " or ".join(_VARIABILITIES[entry.group])
            raise ExportError(
                f"{where}: the {entry.group} '{port.name}' has the variability '{port.variability}', "
                f"it must be {allowed}"
            )
        if port.kind != "Real" and port.variability == "continuous":
            raise ExportError(f"{where}: '{port.name}' is of kind '{port.kind}' and hence cannot be continuous")
        low, high = bounds(port)
        if entry.initial == "exact" and not (
            low <= port.start <= high and (port.kind == "Real" or float(port.start).is_integer())
        ):
            raise ExportError(
                f"{where}: the start value {port.start:g} of '{port.name}' is no {port.kind} in [{low:g}, {high:g}]"
            )


def _unit_definitions(root: etree._Element, component: Component, variables: list[Entry]) -> None:
    definitions = etree.SubElement(root, "UnitDefinitions")
    for name, user in sorted(_real_units(variables).items()):
        try:
            unit = units.parse(name)
        except ValueError as error:
            raise ExportError(
                f"component '{component.name}': the unit '{name}' of '{user}' cannot be understood: {error}"
            ) from None
        element = etree.SubElement(etree.SubElement(definitions, "Unit", name=name), "BaseUnit")
        for base in units.BASE:
            if base in unit.exponents:
                element.set(base, str(unit.exponents[base]))
        if unit.factor != 1:
            element.set("factor", _real(unit.factor))
        if unit.offset != 0:
            element.set("offset", _real(unit.offset))
    if len(definitions) == 0:
        root.remove(definitions)


def _real_units(variables: list[Entry]) -> dict[str, str]:
    """Each unit with the first variable that uses it; "" is none."""
    found: dict[str, str] = {}
    for entry in variables:
        if entry.port.kind == "Real" and entry.port.unit:
            found.setdefault(entry.port.unit, entry.port.name)
    return found


def type_name(unit: str) -> str:
    """A name for the type of all Reals in `unit`: identifiers only, tools make declarations of them."""
    words = unit.replace("%", "percent").replace("-", "minus").replace("+", "").replace("/", "_per_")
    words = "dimensionless" if unit == "1" else re.sub(r"\W+", "_", words).strip("_")
    return f"Real_{words}"


def _type_definitions(root: etree._Element, component: Component, variables: list[Entry]) -> None:
    definitions = etree.SubElement(root, "TypeDefinitions")
    taken = {entry.port.name for entry in variables}
    for unit in sorted(_real_units(variables)):
        simple = etree.SubElement(definitions, "SimpleType", name=type_name(unit), description=f"Real in {unit}")
        etree.SubElement(simple, "Real", unit=unit)
        taken.add(type_name(unit))
    for enumeration in _enumerations(component, variables):
        if enumeration.name in taken:
            raise ExportError(
                f"component '{component.name}': the enumeration '{enumeration.name}' has the name of a variable or type"
            )
        simple = etree.SubElement(definitions, "SimpleType", name=enumeration.name)
        element = etree.SubElement(simple, "Enumeration")
        for value, (item, description) in enumerate(enumeration.items, start=1):
            etree.SubElement(element, "Item", name=item, value=str(value), description=description)
    if len(definitions) == 0:
        root.remove(definitions)


def _enumerations(component: Component, variables: list[Entry]) -> list[Enumeration]:
    found: dict[str, Enumeration] = {}
    for entry in variables:
        enumeration = entry.port.enumeration
        if enumeration is not None and found.setdefault(enumeration.name, enumeration) != enumeration:
            raise ExportError(f"component '{component.name}': two enumerations are called '{enumeration.name}'")
    return list(found.values())


def _scalar_variable(parent: etree._Element, reference: int, entry: Entry) -> None:
    port = entry.port
    variable = etree.SubElement(
        parent,
        "ScalarVariable",
        name=port.name,
        valueReference=str(reference),
        description=port.description or port.name,
        causality=entry.causality,
    )
    variable.set("variability", "constant" if entry.group == "constant" else port.variability)
    if entry.initial is not None:
        variable.set("initial", entry.initial)
    write = {"Real": _real, "Boolean": _boolean}.get(port.kind, _integer)
    element = etree.SubElement(variable, port.kind)
    if port.enumeration is not None:
        element.set("declaredType", port.enumeration.name)
    if port.kind == "Real" and port.unit:
        element.set("declaredType", type_name(port.unit))
        element.set("unit", port.unit)
    low, high = bounds(port)
    if math.isfinite(low):
        element.set("min", write(low))
    if math.isfinite(high):
        element.set("max", write(high))
    if port.kind == "Real":
        element.set("nominal", _real(port.nominal))
    if entry.initial != "calculated":
        element.set("start", write(port.start))


def _model_structure(root: etree._Element, component: Component, variables: list[Entry]) -> None:
    structure = etree.SubElement(root, "ModelStructure")
    outputs = [(row, k) for row, k in enumerate(_indices(variables, "output")) if variables[k].causality == "output"]
    if not outputs:
        return
    inputs, parameters = _indices(variables, "input"), _indices(variables, "parameter")
    found = dependencies(component)
    element = etree.SubElement(structure, "Outputs")
    for row, index in outputs:
        _unknown(element, index, [inputs[k] for k in found.on_inputs[row]])
    element = etree.SubElement(structure, "InitialUnknowns")
    for row, index in outputs:
        known = [inputs[k] for k in found.initially_on_inputs[row]]
        _unknown(element, index, known + [parameters[k] for k in found.initially_on_parameters[row]])


def _indices(variables: list[Entry], group: str) -> list[int]:
    return [index for index, entry in enumerate(variables) if entry.group == group]


def _unknown(parent: etree._Element, index: int, known: list[int]) -> None:
    """An output and the variables it depends on; FMI counts them from 1."""
    numbers = " ".join(str(k + 1) for k in known)
    kinds = " ".join(["dependent"] * len(known))
    etree.SubElement(parent, "Unknown", index=str(index + 1), dependencies=numbers, dependenciesKind=kinds)


def _real(value: float) -> str:
    return repr(float(value))


def _integer(value: float) -> str:
    return str(int(value))


def _boolean(value: float) -> str:
    return "true" if value else "false"
