"""A system as a file: SSP 1.0 (.ssp), a zip with SystemStructure.ssd and the FMUs in resources/.

SSP 1.0 has no place for the communication step size. It travels in the annotation that the Open Simulation Platform
defined for it (`osp:FixedStepAlgorithm` in the default experiment), which libcosim reads too.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

from fmpy.model_description import BaseUnit, ModelVariable
from lxml import etree

from cosim.errors import SystemFileError
from cosim.fmu import Value, enumeration_items, unit_of
from cosim.system.resolve import resolve
from cosim.system.resolved import ResolvedSystem
from cosim.system.ssp_files import OSP, OSP_ANNOTATION, SSC, SSD, SSV, STRUCTURE, validate
from cosim.system.system import System
from cosim.system.units import EXPONENTS
from cosim.whole import whole

# Ecos and libcosim group parameter sets by this name, and their own examples call it so.
PARAMETER_SET = "initialValues"

_PREFIXES = {"ssd": SSD, "ssc": SSC, "ssv": SSV, "osp": OSP}  # literal: several tools match prefixes, not namespaces


def write_ssp(system: System, path: Path) -> None:
    """Write `system` to `path`, in a folder that is made where there is none: the same system and FMUs give the same bytes.

    Inputs and outputs of the elements become connectors (enumerations only if connected), and so do the parameters that
    have a value. An FMU that several elements use is stored once.

    Raises:
        SystemFileError: the system contradicts its FMUs (see `cosim.system.resolve`), two FMUs share a file name, or it is
            nested or has connectors or transformations, which only files of other tools have.
        OSError: the file cannot be written; what was there before is unchanged.
    """
    resolved = resolve(system)
    plain = resolve(replace(system, routes={})) if system.routes else resolved
    steps = [[c.steps for c in one.connections] for one in (plain, resolved)]
    if system.connectors or steps[0] != steps[1] or any("." in name for name in system.elements):
        raise SystemFileError(
            f"system '{system.name}': only flat systems without connectors and transformations of their own are written"
        )
    files: dict[str, Path] = {}
    for element in system.elements.values():
        kept = files.setdefault(element.fmu.name, element.fmu)
        if kept.resolve() != element.fmu.resolve():
            raise SystemFileError(
                f"system '{system.name}': {kept} and {element.fmu} would both be resources/{kept.name}"
            )
    content = {STRUCTURE: _structure(resolved)}
    content |= {f"resources/{name}": file.read_bytes() for name, file in files.items()}
    _write_archive(content, path)


def _write_archive(content: Mapping[str, bytes], path: Path) -> None:
    """Never half a file. (fmu_src writes FMUs likewise; cosim does not import it.)"""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole(path) as partial, zipfile.ZipFile(partial, "w", zipfile.ZIP_STORED) as archive:
        for name in sorted(content):
            entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
            entry.external_attr = 0o644 << 16
            entry.create_system = 3  # as on Unix, wherever it is written
            archive.writestr(entry, content[name])


def _structure(resolved: ResolvedSystem) -> bytes:
    system = resolved.system
    root = etree.Element(f"{{{SSD}}}SystemStructureDescription", nsmap=_PREFIXES, version="1.0", name=system.name)
    top = add(root, SSD, "System", name=system.name, description=system.description)
    elements = add(top, SSD, "Elements")
    for name in system.elements:
        _add_component(elements, resolved, name)
    if resolved.connections:
        connections = add(top, SSD, "Connections")
        for c in resolved.connections:
            ends = {"startElement": c.source, "startConnector": c.output.name}
            ends |= {"endElement": c.target, "endConnector": c.input.name}
            add(connections, SSD, "Connection", **ends)
    _add_enumerations(root, resolved)
    _add_units(root, resolved)
    stop, step = resolved.experiment()
    experiment = add(root, SSD, "DefaultExperiment", startTime=literal(system.start), stopTime=literal(stop))
    annotation = add(add(experiment, SSD, "Annotations"), SSC, "Annotation", type=OSP_ANNOTATION)
    add(add(annotation, OSP, "Algorithm"), OSP, "FixedStepAlgorithm", baseStepSize=literal(step))
    validate(root, "SystemStructureDescription", f"system '{system.name}': {STRUCTURE}")
    for parameters in root.iter(f"{{{SSV}}}ParameterSet"):
        validate(parameters, "SystemStructureParameterValues", f"system '{system.name}': {STRUCTURE}")
    return etree.tostring(root, encoding="UTF-8", xml_declaration=True, pretty_print=True)


def add(parent: etree._Element, namespace: str, tag: str, **attributes: str) -> etree._Element:
    return etree.SubElement(parent, f"{{{namespace}}}{tag}", **attributes)


def literal(value: Value) -> str:
    """`value` as XML Schema writes it; doubles in the shortest form that reads back exactly."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "INF" if value > 0 else "-INF"
    return repr(value) if isinstance(value, float) else str(value)


def _connectors(resolved: ResolvedSystem, name: str) -> list[tuple[str, ModelVariable]]:
    """Kind and variable of each connector of element `name`.

    An enumeration is declared only where the standard demands it (it is connected or has a value): libcosim ends the
    process at the sight of one.
    """
    used = set(resolved.parameters[name])
    for c in resolved.connections:
        used |= {variable.name for element, variable in ((c.source, c.output), (c.target, c.input)) if element == name}
    return [
        (v.causality, v)
        for v in resolved.descriptions[name].modelVariables
        if v.causality in ("input", "output", "parameter")
        and (v.name in used or (v.causality != "parameter" and v.type != "Enumeration"))
    ]


def _add_component(elements: etree._Element, resolved: ResolvedSystem, name: str) -> None:
    element = resolved.system.elements[name]
    source = "resources/" + quote(element.fmu.name)
    component = add(elements, SSD, "Component", name=name, type="application/x-fmu-sharedlibrary", source=source)
    declared = _connectors(resolved, name)
    if declared:
        connectors = add(component, SSD, "Connectors")
        for kind, variable in declared:
            connector = add(connectors, SSD, "Connector", name=variable.name, kind=kind)
            add(connector, SSC, variable.type, **_type_attributes(resolved, name, variable))
    if resolved.parameters[name]:
        binding = add(add(component, SSD, "ParameterBindings"), SSD, "ParameterBinding")
        values = add(add(binding, SSD, "ParameterValues"), SSV, "ParameterSet", version="1.0", name=PARAMETER_SET)
        parameters = add(values, SSV, "Parameters")
        for variable_name, value in resolved.parameters[name].items():
            variable = resolved.variables[name][variable_name]
            if variable.type == "Enumeration":
                value = enumeration_items(variable)[int(value)]
            parameter = add(parameters, SSV, "Parameter", name=variable_name)
            add(parameter, SSV, variable.type, value=literal(value))


def _type_attributes(resolved: ResolvedSystem, name: str, variable: ModelVariable) -> dict[str, str]:
    if variable.type == "Enumeration":
        return {"name": variable.declaredType.name}
    unit = unit_of(variable)
    defined = {u.name for u in resolved.descriptions[name].unitDefinitions if u.baseUnit is not None}
    return {"unit": unit} if unit in defined else {}


def _add_enumerations(root: etree._Element, resolved: ResolvedSystem) -> None:
    found: dict[str, dict[int, str]] = {}
    for name in resolved.system.elements:
        for _, variable in _connectors(resolved, name):
            if variable.type == "Enumeration":
                items, enumeration = enumeration_items(variable), variable.declaredType.name
                if found.setdefault(enumeration, items) != items:
                    raise SystemFileError(
                        f"element '{name}': another FMU defines the enumeration '{enumeration}' differently"
                    )
    if found:
        enumerations = add(root, SSD, "Enumerations")
        for enumeration in sorted(found):
            listed = add(enumerations, SSC, "Enumeration", name=enumeration)
            for number, item in sorted(found[enumeration].items()):
                add(listed, SSC, "Item", name=item, value=str(number))


def _add_units(root: etree._Element, resolved: ResolvedSystem) -> None:
    found: dict[str, dict[str, str]] = {}
    for name, description in resolved.descriptions.items():
        used = {unit_of(variable) for _, variable in _connectors(resolved, name)}
        for unit in description.unitDefinitions:
            if unit.name in used and unit.baseUnit is not None:
                base = base_of(unit.baseUnit)
                if found.setdefault(unit.name, base) != base:
                    raise SystemFileError(f"element '{name}': another FMU defines the unit '{unit.name}' differently")
    list_units(root, SSD, found)


def base_of(unit: BaseUnit) -> dict[str, str]:
    """The attributes of a BaseUnit, as an FMU's."""
    return {key: literal(getattr(unit, key)) for key in (*EXPONENTS, "factor", "offset")}


def list_units(root: etree._Element, namespace: str, found: Mapping[str, Mapping[str, str]]) -> None:
    """The definitions of units, attributes of a BaseUnit by name, at the end of `root`; nothing where there are none."""
    if found:
        units = add(root, namespace, "Units")
        for name in sorted(found):
            add(add(units, SSC, "Unit", name=name), SSC, "BaseUnit", **found[name])
