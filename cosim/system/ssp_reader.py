"""A system from a file: our own .ssp files, and those of other tools as far as they hold one flat system of FMUs."""

from __future__ import annotations

import posixpath
import zipfile
import zlib
from pathlib import Path
from urllib.parse import unquote

from lxml import etree

from cosim.errors import SystemFileError, not_a_file, suggest
from cosim.fmu import Value
from cosim.system.ssp_writer import OSP, OSP_ANNOTATION, SSC, SSD, SSV, STRUCTURE, validate
from cosim.system.system import Element, System

_NS = {"ssd": SSD, "ssc": SSC, "ssv": SSV, "osp": OSP}


def read_ssp(path: Path, directory: Path) -> System:
    """The system in the .ssp file at `path`; its FMUs are written to `directory`, where the system refers to them.

    Parameter values may be inline or in .ssv files, at components or at the system (which has precedence). Refused, not
    skipped, are transformations and parameter mappings, which would change values on their way, nested systems and
    connectors of the system. Names are looked up in the FMUs by `cosim.system.resolve`.

    Raises:
        SystemFileError: no such file, not a zip, no or invalid SystemStructure.ssd (with its line), a missing resource,
            a feature as above.
    """
    try:
        if not path.is_file():
            raise SystemFileError(not_a_file(path))
        with zipfile.ZipFile(path) as archive:
            return _read(archive, path, directory)
    except (zipfile.BadZipFile, zlib.error) as error:
        raise SystemFileError(f"{path}: not an SSP file (not a sound zip file: {error})") from None
    except OSError as error:
        raise SystemFileError(f"{path}: cannot be read and unpacked: {error.strerror or error}") from None


def _read(archive: zipfile.ZipFile, path: Path, directory: Path) -> System:
    root = _parse(archive, path, STRUCTURE)
    validate(root, "SystemStructureDescription", f"{path}: {STRUCTURE}")
    top = root.find("ssd:System", _NS)
    if top.find("ssd:Connectors", _NS) is not None:
        raise SystemFileError(f"{path}: the system has connectors of its own; a flat system of FMUs is wanted")
    fmus: dict[str, Path] = {}
    values: dict[str, dict[str, Value]] = {}
    for child in top.iterfind("ssd:Elements/*", _NS):
        name, kind = child.get("name"), etree.QName(child).localname
        if (
            kind != "Component"
            or child.get("type", "application/x-fmu-sharedlibrary") != "application/x-fmu-sharedlibrary"
        ):
            raise SystemFileError(f"{path}: element '{name}' is no FMU ({child.get('type', kind)})")
        if child.get("implementation") == "ModelExchange":
            raise SystemFileError(f"{path}: element '{name}' asks for model exchange; only co-simulation is possible")
        if name in fmus:
            raise SystemFileError(f"{path}: two elements are called '{name}'")
        member = _member(archive, path, child.get("source"))
        fmus[name] = Path(archive.extract(member, directory))
        values[name] = _bindings(archive, path, child)
    for name, value in _bindings(archive, path, top).items():
        element, _, variable = name.partition(".")
        if element not in values or not variable:
            raise SystemFileError(
                f"{path}: parameter '{name}' of the system: no such element; {suggest(element, values)}"
            )
        values[element][variable] = value
    experiment = root.find("ssd:DefaultExperiment", _NS)
    attributes = {} if experiment is None else experiment.attrib
    return System(
        name=root.get("name"),
        elements={name: Element(fmu, values[name]) for name, fmu in fmus.items()},
        connections=[_connection(path, c) for c in top.iterfind("ssd:Connections/ssd:Connection", _NS)],
        start=float(attributes.get("startTime", 0.0)),
        stop=float(attributes["stopTime"]) if "stopTime" in attributes else None,
        step=_step_size(path, experiment),
        description=top.get("description", ""),
    )


def _parse(archive: zipfile.ZipFile, path: Path, member: str) -> etree._Element:
    try:
        # No entities, no network: an .ssp file may come from anywhere.
        return etree.fromstring(archive.read(member), etree.XMLParser(resolve_entities=False, no_network=True))
    except KeyError:
        raise SystemFileError(f"{path}: there is no {member} in it") from None
    except etree.XMLSyntaxError as error:
        raise SystemFileError(f"{path}: {member}, line {error.lineno}: {error.msg}") from None


def _member(archive: zipfile.ZipFile, path: Path, source: str) -> str:
    """The archive's member that a URI relative to the .ssd means."""
    member = posixpath.normpath(unquote(source))
    if member not in archive.namelist():
        raise SystemFileError(f"{path}: '{source}' is not in it; {suggest(member, archive.namelist())}")
    return member


def _bindings(archive: zipfile.ZipFile, path: Path, element: etree._Element) -> dict[str, Value]:
    """All parameter values bound at `element`; a later binding wins."""
    values: dict[str, Value] = {}
    for binding in element.iterfind("ssd:ParameterBindings/ssd:ParameterBinding", _NS):
        where = f"{path}: parameters of '{element.get('name')}'"
        if binding.find("ssd:ParameterMapping", _NS) is not None:
            raise SystemFileError(f"{where}: parameter mappings are not supported")
        if binding.get("type", "application/x-ssp-parameter-set") != "application/x-ssp-parameter-set":
            raise SystemFileError(f"{where}: parameters of type {binding.get('type')} are not supported")
        if binding.get("source"):
            if binding.get("sourceBase") == "component":
                raise SystemFileError(f"{where}: parameter files inside an FMU are not supported")
            member = _member(archive, path, binding.get("source"))
            parameters, where = _parse(archive, path, member), f"{path}: {member}"
        else:
            parameters, where = binding.find("ssd:ParameterValues/ssv:ParameterSet", _NS), f"{path}: {STRUCTURE}"
            if parameters is None:
                raise SystemFileError(f"{where}, line {binding.sourceline}: a parameter binding without parameters")
        validate(parameters, "SystemStructureParameterValues", where)
        for parameter in parameters.iterfind("ssv:Parameters/ssv:Parameter", _NS):
            values[binding.get("prefix", "") + parameter.get("name")] = _value(parameter, where)
    return values


def _value(parameter: etree._Element, where: str) -> Value:
    typed = next(parameter.iterchildren("{*}Real", "{*}Integer", "{*}Boolean", "{*}Enumeration", "{*}String"), None)
    if typed is None:
        raise SystemFileError(f"{where}, line {parameter.sourceline}: binary parameters are not supported")
    text = typed.get("value")
    match etree.QName(typed).localname:
        case "Real":
            return float(text)
        case "Integer":
            return int(text)
        case "Boolean":
            return text.strip() in ("true", "1")
    return str(text)


def _connection(path: Path, connection: etree._Element) -> tuple[str, str]:
    start, end = ((connection.get(f"{side}Element"), connection.get(f"{side}Connector")) for side in ("start", "end"))
    if start[0] is None or end[0] is None:
        raise SystemFileError(
            f"{path}: {STRUCTURE}, line {connection.sourceline}: a connection to the system's own connectors"
        )
    if any(etree.QName(child).localname.endswith("Transformation") for child in connection.iterchildren(etree.Element)):
        raise SystemFileError(
            f"{path}: connection {'.'.join(start)} -> {'.'.join(end)}: transformations are not supported"
        )
    return ".".join(start), ".".join(end)


def _step_size(path: Path, experiment: etree._Element | None) -> float | None:
    if experiment is None:
        return None
    xpath = f"ssd:Annotations/ssc:Annotation[@type='{OSP_ANNOTATION}']//osp:FixedStepAlgorithm"
    found = experiment.find(xpath, _NS)
    if found is None or found.get("baseStepSize") is None:
        return None
    try:
        return float(found.get("baseStepSize"))
    except ValueError:
        text = found.get("baseStepSize")
        raise SystemFileError(
            f"{path}: {STRUCTURE}, line {found.sourceline}: baseStepSize '{text}' is not a number"
        ) from None
