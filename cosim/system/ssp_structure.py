"""The structure of an .ssp file as a tree: systems in systems, FMUs at its ends."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from lxml import etree

from cosim.archive import opened
from cosim.errors import SystemFileError
from cosim.system.route import Hop
from cosim.system.ssp_files import DEEPEST, MOST_ELEMENTS, NAMESPACES, STRUCTURE, Package
from cosim.system.ssp_parameters import Values, bindings, flag, transformation
from cosim.system.system import Connector
from cosim.system.units import Unit, ssp_units

FMU = "application/x-fmu-sharedlibrary"
DEFINITION = "application/x-ssp-definition"
PACKAGE = "application/x-ssp-package"


@dataclass(frozen=True)
class End:
    """An end of a connection: a connector of an element, or of the system itself (`element` is None)."""

    element: str | None
    connector: str

    def __str__(self) -> str:
        return self.connector if self.element is None else f"{self.element}.{self.connector}"


@dataclass(frozen=True)
class Wire:
    """A connection as it stands in the file: its direction is that of the connectors; `hop` has no unit yet."""

    start: End
    end: End
    hop: Hop


@dataclass
class Node:
    """A system, or an FMU (`fmu`), with what is bound to it."""

    connectors: dict[str, Connector] = field(default_factory=dict)
    values: Values = field(default_factory=dict)
    fmu: Path | None = None
    children: dict[str, Node] = field(default_factory=dict)
    wires: list[Wire] = field(default_factory=list)


def read_structure(package: Package, member: str = STRUCTURE) -> tuple[etree._Element, Node]:
    """The root of the .ssd file `member`, and its system.

    Raises:
        SystemFileError: no or an invalid file, an element that is not supported, a missing resource.
    """
    root = package.xml(member, "SystemStructureDescription")
    return root, _system(_File(package, member, ssp_units(root)), root.find("ssd:System", NAMESPACES))


@dataclass(frozen=True)
class _File:
    """An .ssd file that is being read."""

    package: Package
    member: str
    units: Mapping[str, Unit]

    def refuse(self, element: etree._Element, reason: str) -> SystemFileError:
        return SystemFileError(f"{self.package.label}: {self.member}, line {element.sourceline}: {reason}")


def _system(file: _File, element: etree._Element) -> Node:
    node = Node(_connectors(file, element), bindings(file.package, file.member, element))
    dictionaries = element.find("ssd:SignalDictionaries", NAMESPACES)
    if dictionaries is not None:
        raise file.refuse(dictionaries, "SignalDictionaries are not supported")
    for child in element.iterfind("ssd:Elements/*", NAMESPACES):
        name = child.get("name")
        if name in node.children:
            raise file.refuse(child, f"two elements are called '{name}'")
        file.package.elements[0] += 1
        if file.package.elements[0] > MOST_ELEMENTS:
            raise file.refuse(child, f"more than {MOST_ELEMENTS} elements, those of nested systems included")
        match etree.QName(child).localname:
            case "Component":
                node.children[name] = _component(file, child)
            case "System":
                node.children[name] = _system(file, child)
            case other:
                raise file.refuse(child, f"element '{name}': a {other} is not supported")
    for connection in element.iterfind("ssd:Connections/ssd:Connection", NAMESPACES):
        start, end = (
            End(connection.get(f"{side}Element"), connection.get(f"{side}Connector")) for side in ("start", "end")
        )
        hop = Hop(None, flag(connection, "suppressUnitConversion"), transformation(connection))
        node.wires.append(Wire(start, end, hop))
    return node


def _connectors(file: _File, element: etree._Element) -> dict[str, Connector]:
    found: dict[str, Connector] = {}
    for connector in element.iterfind("ssd:Connectors/ssd:Connector", NAMESPACES):
        typed = next(
            connector.iterchildren("{*}Real", "{*}Integer", "{*}Boolean", "{*}String", "{*}Enumeration", "{*}Binary"),
            None,
        )
        unit = typed.get("unit") if typed is not None else None
        if unit is not None and unit not in file.units:
            raise file.refuse(
                connector, f"connector '{connector.get('name')}': the unit '{unit}' is not defined in the file"
            )
        found[connector.get("name")] = Connector(
            connector.get("kind"),
            etree.QName(typed).localname if typed is not None else None,
            file.units[unit] if unit is not None else None,
        )
    return found


def _component(file: _File, element: etree._Element) -> Node:
    name, kind, source = element.get("name"), element.get("type", FMU), element.get("source")
    if kind == FMU:
        if element.get("implementation") == "ModelExchange":
            raise file.refuse(element, f"element '{name}' asks for model exchange; only co-simulation is possible")
        fmu = file.package.extract(file.package.member(source, file.member))
        return Node(_connectors(file, element), bindings(file.package, file.member, element), fmu)
    if kind == DEFINITION:
        made = _definition(file, element, source)
    elif kind == PACKAGE:
        made = _package(file, element, source)
    else:
        raise file.refuse(element, f"element '{name}' is no FMU and no system ({kind})")
    # SSP: what is bound here counts as if it stood at the end of the system's own bindings.
    made.values |= bindings(file.package, file.member, element)
    return made


def _definition(file: _File, element: etree._Element, source: str) -> Node:
    if source.startswith("#"):
        found = (
            element.getroottree().getroot().find(f".//{{*}}System[@id='{source[1:]}']") if "'" not in source else None
        )
        if found is None:
            raise file.refuse(element, f"element '{element.get('name')}': no system has the id '{source[1:]}'")
        if found in element.iterancestors():
            raise file.refuse(element, f"element '{element.get('name')}': the system '{source[1:]}' holds itself")
        return _nested(
            file, element, file.package, lambda package: _system(_File(package, file.member, file.units), found)
        )
    member = file.package.member(source.partition("#")[0], file.member)
    return _nested(file, element, file.package, lambda package: read_structure(package, member)[1])


def _package(file: _File, element: etree._Element, source: str) -> Node:
    uri, _, chosen = source.partition("#")
    package = file.package
    path = package.extract(package.member(uri, file.member))
    with opened(path, "an SSP file") as archive:
        folder = path.with_name(f"{path.name}.unpacked")
        label = f"{package.label}: {uri}"
        inner = Package(archive, label, folder, package.depth, package.inflated, package.elements)
        return _nested(file, element, inner, lambda deeper: read_structure(deeper, chosen or STRUCTURE)[1])


def _nested(file: _File, element: etree._Element, package: Package, read: Callable[[Package], Node]) -> Node:
    if package.depth >= DEEPEST:
        raise file.refuse(
            element, f"element '{element.get('name')}' lies in more than {DEEPEST} systems: does one hold itself?"
        )
    return read(replace(package, depth=package.depth + 1))
