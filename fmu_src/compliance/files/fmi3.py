"""An FMU of FMI 3.0 by the same rules of the file, where they have a meaning there; its library is not driven."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import fmpy
from lxml import etree

from fmu_src.compliance.files.description import Description, Variable
from fmu_src.compliance.files.package import Package
from fmu_src.compliance.finding import Finding
from fmu_src.compliance.rules import finding

INTERFACES = ("ModelExchange", "CoSimulation", "ScheduledExecution")
BUILD_DESCRIPTION = "sources/buildDescription.xml"
# Further documents of an FMU, with their schemas in the fmpy package.
DOCUMENTS = {
    BUILD_DESCRIPTION: "fmi3BuildDescription.xsd",
    "terminalsAndIcons/terminalsAndIcons.xml": "fmi3TerminalsAndIcons.xsd",
}
_FLOATS = ("Float32", "Float64")
_UNKNOWNS = ("Output", "ContinuousStateDerivative", "ClockedState", "InitialUnknown", "EventIndicator")


@cache
def schema(name: str = "fmi3ModelDescription.xsd") -> etree.XMLSchema:
    """A schema of FMI 3.0, from the fmpy package."""
    return etree.XMLSchema(file=str(Path(fmpy.__file__).parent / "schema" / "fmi3" / name))


def read(root: etree._Element) -> Description:
    """The record of a document that is valid against the schema; start values are not in it, see `check_ranges`."""
    elements = [element for element in root if element.tag in INTERFACES]
    experiment = root.find("DefaultExperiment")
    types = _types(root)
    return Description(
        version="3.0",
        guid=root.get("instantiationToken", ""),
        convention=root.get("variableNamingConvention", "flat"),
        interfaces={str(element.tag): dict(element.attrib) for element in elements},
        source_files=(),
        experiment={} if experiment is None else {name: float(value) for name, value in experiment.attrib.items()},
        categories=tuple(element.get("name", "") for element in root.iterfind("LogCategories/Category")),
        derivatives=(),
        initial_unknowns=(),
        direct={},
        indicators=0,
        variables=tuple(_variable(index, element, types) for index, element in enumerate(_elements(root), start=1)),
    )


def names(root: etree._Element) -> list[str]:
    """Of variables and their aliases."""
    return [
        element.get("name", "") for variable in _elements(root) for element in (variable, *variable.iterfind("Alias"))
    ]


def _elements(root: etree._Element) -> list[etree._Element]:
    return list(root.iterfind("ModelVariables/*"))


def _types(root: etree._Element) -> dict[str, etree._Element]:
    return {element.get("name", ""): element for element in root.iterfind("TypeDefinitions/*")}


def _variable(index: int, element: etree._Element, types: dict[str, etree._Element]) -> Variable:
    declared = types.get(element.get("declaredType", ""))

    def attribute(name: str) -> str | None:
        value = element.get(name)
        return declared.get(name) if value is None and declared is not None else value

    low, high = attribute("min"), attribute("max")
    return Variable(
        index=index,
        name=element.get("name", ""),
        reference=int(element.get("valueReference", "0")),
        type=str(element.tag),
        causality=element.get("causality", "local"),
        variability=element.get("variability", "continuous" if element.tag in _FLOATS else "discrete"),
        initial=element.get("initial"),
        start=None,
        min=-math.inf if low is None else _number(element, low),
        max=math.inf if high is None else _number(element, high),
        nominal=float(attribute("nominal") or 1.0),
        unit=attribute("unit") or "",
        declared_type=element.get("declaredType"),
        derivative=None,
    )


def _number(element: etree._Element, text: str) -> float:
    """Integers stay integers: those of 64 bits do not fit a double."""
    return float(text) if element.tag in _FLOATS else int(text)


def check_documents(package: Package) -> Iterator[Finding]:
    """xml-schema, of the documents beside modelDescription.xml; source-files. The archive is sound."""
    for name, schema_name in DOCUMENTS.items():
        if name not in package.names:
            continue
        try:
            root = etree.fromstring(package.read(name))
        except etree.XMLSyntaxError as error:
            yield finding("xml-schema", name, "well-formed XML", f"line {error.lineno}: {error.msg}")
            continue
        validator = schema(schema_name)
        if not validator.validate(root):
            for problem in validator.error_log:
                yield finding("xml-schema", f"{name}, line {problem.line}", "a valid document", problem.message)
        elif name == BUILD_DESCRIPTION:
            for source in dict.fromkeys(f"sources/{file.get('name', '')}" for file in root.iter("SourceFile")):
                if source not in package.names:
                    yield finding("source-files", source, "the listed file", "none")


def check_definitions(root: etree._Element) -> Iterator[Finding]:
    """unit-name, type-name, enumeration-items, declared-type, enumeration-start."""
    yield from _repeated("unit-name", [unit.get("name", "") for unit in root.iterfind("UnitDefinitions/Unit")], "unit")
    types = list(root.iterfind("TypeDefinitions/*"))
    yield from _repeated("type-name", [element.get("name", "") for element in types], "type")
    for element in types:
        for attribute in ("name", "value"):
            items = [item.get(attribute, "") for item in element.iterfind("Item")]
            for value in (value for value, count in Counter(items).items() if count > 1):
                name = element.get("name", "")
                yield finding("enumeration-items", name, f"different {attribute}s", f"'{value}' more than once")
    items_of = {
        element.get("name", ""): [int(item.get("value", "0")) for item in element.iterfind("Item")] for element in types
    }
    kinds = {element.get("name", ""): str(element.tag).removesuffix("Type") for element in types}
    for variable in _elements(root):
        declared = kinds.get(variable.get("declaredType", ""), variable.tag)
        if declared != variable.tag:
            yield finding("declared-type", variable.get("name", ""), f"a type of {variable.tag}", f"one of {declared}")
        elif variable.tag == "Enumeration":
            known = items_of.get(variable.get("declaredType", ""), [])
            for text in (text for text in (variable.get("start") or "").split() if int(text) not in known):
                expected = f"a start value of {', '.join(map(str, known))}"
                yield finding("enumeration-start", variable.get("name", ""), expected, text)
                break


def _repeated(rule: str, words: list[str], what: str) -> Iterator[Finding]:
    for word in (word for word, count in Counter(words).items() if count > 1):
        yield finding(rule, word, f"one {what} of this name", "several")


def check_ranges(root: etree._Element, description: Description) -> Iterator[Finding]:
    """min-max and start-range; an array's start values each."""
    for element, variable in zip(_elements(root), description.variables, strict=True):
        if variable.min > variable.max:
            yield finding("min-max", variable.name, f"min not above max = {variable.max}", f"{variable.min}")
        elif (variable.min, variable.max) != (-math.inf, math.inf):
            for text in (element.get("start") or "").split():
                if not variable.min <= _number(element, text) <= variable.max:
                    limits = f"[{variable.min}, {variable.max}]"
                    yield finding("start-range", variable.name, f"a start value in {limits}", text)
                    break


def check_structure(root: etree._Element, description: Description) -> Iterator[Finding]:
    """structure-index and structure-duplicate: value references take the place of FMI 2.0's indices."""
    by_reference = {variable.reference: variable.name for variable in description.variables}
    expected = "value references of variables"
    for element, variable in zip(_elements(root), description.variables, strict=True):
        derivative = element.get("derivative")
        if derivative is not None and int(derivative) not in by_reference:
            yield finding("structure-index", f"derivative of {variable.name}", expected, derivative)
    for kind in _UNKNOWNS:
        unknowns = root.findall(f"ModelStructure/{kind}")
        for reference, count in Counter(int(unknown.get("valueReference", "0")) for unknown in unknowns).items():
            if reference not in by_reference:
                yield finding("structure-index", kind, expected, str(reference))
            elif count > 1:
                yield finding("structure-duplicate", by_reference[reference], f"it once as {kind}", f"{count} times")
        for unknown in unknowns:
            for known in map(int, (unknown.get("dependencies") or "").split()):
                if known not in by_reference:
                    subject = by_reference.get(int(unknown.get("valueReference", "0")), "an unknown")
                    yield finding("structure-index", f"{kind}: {subject}", expected, str(known))
