"""Parameter values in an .ssp file: bindings, parameter sets (.ssv) and mappings (.ssm), inline or in files."""

from __future__ import annotations

from lxml import etree

from cosim.errors import SystemFileError
from cosim.fmu import Value
from cosim.system.route import Hop, Quantity, Route
from cosim.system.ssp_files import NAMESPACES, Package, validate
from cosim.system.transformation import ItemTable, Linear, Table, Transformation
from cosim.system.units import ssp_units

Values = dict[str, Value | Quantity]


def bindings(package: Package, base: str, element: etree._Element) -> Values:
    """All parameter values bound at `element` of the file `base`, by the names that they have there; a later one wins.

    Raises:
        SystemFileError: a file that is missing or invalid, parameters or mappings of another type.
    """
    values: Values = {}
    for binding in element.iterfind("ssd:ParameterBindings/ssd:ParameterBinding", NAMESPACES):
        where = f"{package.label}: parameters of '{element.get('name')}'"
        if binding.get("type", "application/x-ssp-parameter-set") != "application/x-ssp-parameter-set":
            raise SystemFileError(f"{where}: parameters of type {binding.get('type')} are not supported")
        inline = binding.find("ssd:ParameterValues/*", NAMESPACES)
        given, where = _content(package, base, binding, inline, "Values", "ParameterSet", where)
        # The prefix comes before all else: the sources of a mapping have it, its targets do not.
        found = {binding.get("prefix", "") + name: value for name, value in values_of(given, where).items()}
        mapping = binding.find("ssd:ParameterMapping", NAMESPACES)
        if mapping is not None:
            if mapping.get("type", "application/x-ssp-parameter-mapping") != "application/x-ssp-parameter-mapping":
                raise SystemFileError(f"{where}: mappings of type {mapping.get('type')} are not supported")
            inner = next(mapping.iterchildren(etree.Element), None)
            entries, where = _content(package, base, mapping, inner, "Mapping", "ParameterMapping", where)
            found = _mapped(found, entries)
        values |= found
    return values


def _content(
    package: Package,
    base: str,
    element: etree._Element,
    inline: etree._Element | None,
    schema: str,
    tag: str,
    where: str,
) -> tuple[etree._Element, str]:
    """The ParameterSet or ParameterMapping that `element` refers to or holds, and how messages call its place."""
    if element.get("source"):
        if element.get("sourceBase") == "component":
            raise SystemFileError(f"{where}: parameter files inside a component are not supported")
        member = package.member(element.get("source"), base)
        root, where = package.xml(member, f"SystemStructureParameter{schema}"), f"{package.label}: {member}"
    else:
        where = f"{package.label}: {base}, line {element.sourceline}"
        if inline is None:
            raise SystemFileError(f"{where}: a parameter binding without a {tag}")
        validate(inline, f"SystemStructureParameter{schema}", where)
        root = inline
    if etree.QName(root).localname != tag:
        raise SystemFileError(f"{where}: {etree.QName(root).localname}, where a {tag} is wanted")
    return root, where


def values_of(parameters: etree._Element, where: str) -> Values:
    """The values of a ParameterSet, which messages call `where`.

    Raises:
        SystemFileError: a binary one, or a unit that is not defined.
    """
    units = ssp_units(parameters)
    values: Values = {}
    for parameter in parameters.iterfind("ssv:Parameters/ssv:Parameter", NAMESPACES):
        typed = next(parameter.iterchildren("{*}Real", "{*}Integer", "{*}Boolean", "{*}Enumeration", "{*}String"), None)
        if typed is None:
            raise SystemFileError(f"{where}, line {parameter.sourceline}: binary parameters are not supported")
        value = _value(typed)
        unit = typed.get("unit")
        if unit is not None and unit not in units:
            raise SystemFileError(
                f"{where}, line {typed.sourceline}: the unit '{unit}' is not defined in the parameter set"
            )
        values[parameter.get("name")] = value if unit is None else Quantity(value, Route(units[unit]))
    return values


def _value(typed: etree._Element) -> Value:
    text = typed.get("value")
    match etree.QName(typed).localname:
        case "Real":
            return float(text)
        case "Integer":
            return int(text)
        case "Boolean":
            return text.strip() in ("true", "1")
    return str(text)


def _mapped(values: Values, mapping: etree._Element) -> Values:
    """The values that `mapping` names, under their new names; SSP: the others are not applied."""
    found: Values = {}
    for entry in mapping.iterfind("ssm:MappingEntry", NAMESPACES):
        value = values.get(entry.get("source"))
        if value is None:
            continue
        hop = Hop(None, flag(entry, "suppressUnitConversion"), transformation(entry))
        plain, unit = (value.value, value.route.unit) if isinstance(value, Quantity) else (value, None)
        trivial = unit is None and hop == Hop()
        found[entry.get("target")] = plain if trivial else Quantity(plain, Route(unit, (hop,)))
    return found


def transformation(element: etree._Element) -> Transformation | None:
    """What a connection or a mapping entry does to values; None: nothing."""
    for child in element.iterchildren(etree.Element):
        entries = [(entry.get("source"), entry.get("target")) for entry in child.iterfind("{*}MapEntry")]
        match etree.QName(child).localname:
            case "LinearTransformation":
                return Linear(float(child.get("factor", 1)), float(child.get("offset", 0)))
            case "BooleanMappingTransformation":
                return Table({_truth(a): _truth(b) for a, b in entries}, boolean=True)
            case "IntegerMappingTransformation":
                return Table({int(a): int(b) for a, b in entries})
            case "EnumerationMappingTransformation":
                return ItemTable(dict(entries))
    return None


def flag(element: etree._Element, name: str) -> bool:
    """A Boolean attribute that is false unless it is there."""
    return bool(_truth(element.get(name, "false")))


def _truth(text: str) -> int:
    return int(text.strip() in ("true", "1"))
