"""modelDescription.xml as the rules read it: a plain record that travels to child processes.

Read without fmpy, whose reader gives up at the first inconsistency that a rule here is about to name.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import fmpy
from lxml import etree

TYPES = ("Real", "Integer", "Boolean", "String", "Enumeration")
Value = float | int | bool | str


@dataclass(frozen=True)
class Variable:
    """A ScalarVariable with the standard's defaults filled in; `index` counts from 1, as in ModelStructure.

    min, max, nominal and unit are the variable's own or its type's. An Enumeration is of the `kind` Integer.
    """

    index: int
    name: str
    reference: int
    type: str
    causality: str
    variability: str
    initial: str | None
    start: Value | None
    min: float
    max: float
    nominal: float
    unit: str
    declared_type: str | None
    derivative: int | None

    @property
    def kind(self) -> str:
        return "Integer" if self.type == "Enumeration" else self.type

    @property
    def settable_before_initialization(self) -> bool:
        return self.causality == "input" or (self.variability != "constant" and self.initial in ("exact", "approx"))

    @property
    def settable_in_steps(self) -> bool:
        return self.causality == "input" or (self.causality == "parameter" and self.variability == "tunable")


@dataclass(frozen=True)
class Description:
    """What the rules need. `identifier` and `flags` are of co-simulation; where there is none, of model exchange."""

    guid: str
    is_cosimulation: bool
    identifiers: dict[str, str]  # by element, CoSimulation and ModelExchange
    flags: dict[str, str]
    source_files: tuple[str, ...]
    experiment: dict[str, float]
    categories: tuple[str, ...]
    variables: tuple[Variable, ...] = field(repr=False)

    @property
    def identifier(self) -> str:
        return self.identifiers["CoSimulation" if self.is_cosimulation else "ModelExchange"]

    def says(self, flag: str) -> bool:
        """Is this capability flag true?"""
        return self.flags.get(flag) in ("true", "1")


@cache
def schema() -> etree.XMLSchema:
    """FMI 2.0's schema of modelDescription.xml, from the fmpy package."""
    return etree.XMLSchema(file=str(Path(fmpy.__file__).parent / "schema" / "fmi2" / "fmi2ModelDescription.xsd"))


def read(root: etree._Element) -> Description:
    """The record of a document that is valid against the schema."""
    interfaces = {name: root.find(name) for name in ("CoSimulation", "ModelExchange")}
    present = {name: element for name, element in interfaces.items() if element is not None}
    main = present.get("CoSimulation", present.get("ModelExchange"))
    assert main is not None  # the schema asks for one
    experiment = root.find("DefaultExperiment")
    return Description(
        guid=root.get("guid", ""),
        is_cosimulation="CoSimulation" in present,
        identifiers={name: element.get("modelIdentifier", "") for name, element in present.items()},
        flags=dict(main.attrib),
        source_files=tuple(
            dict.fromkeys(file.get("name", "") for element in present.values() for file in element.iter("File"))
        ),
        experiment={} if experiment is None else {name: float(value) for name, value in experiment.attrib.items()},
        categories=tuple(element.get("name", "") for element in root.iterfind("LogCategories/Category")),
        variables=tuple(_variables(root)),
    )


def _variables(root: etree._Element) -> list[Variable]:
    types = {element.get("name"): element for element in root.iterfind("TypeDefinitions/SimpleType")}
    return [
        _variable(index, element, types)
        for index, element in enumerate(root.iterfind("ModelVariables/ScalarVariable"), start=1)
    ]


def _variable(index: int, element: etree._Element, types: dict[str | None, etree._Element]) -> Variable:
    own = next(child for child in element if child.tag in TYPES)
    declared = types.get(own.get("declaredType"))
    inherited = None if declared is None else declared.find(str(own.tag))

    def attribute(name: str) -> str | None:
        value = own.get(name)
        return inherited.get(name) if value is None and inherited is not None else value

    causality = element.get("causality", "local")
    variability = element.get("variability", "continuous" if own.tag == "Real" else "discrete")
    start = own.get("start")
    low, high, derivative = attribute("min"), attribute("max"), own.get("derivative")
    return Variable(
        index=index,
        name=element.get("name", ""),
        reference=int(element.get("valueReference", "0")),
        type=str(own.tag),
        causality=causality,
        variability=variability,
        initial=element.get("initial") or _default_initial(causality, variability),
        start=None if start is None else value_of(str(own.tag), start),
        min=-math.inf if low is None else float(low),
        max=math.inf if high is None else float(high),
        nominal=float(attribute("nominal") or 1.0),
        unit=attribute("unit") or "",
        declared_type=own.get("declaredType"),
        derivative=None if derivative is None else int(derivative),
    )


def value_of(kind: str, text: str) -> Value:
    """`text` as the schema's type for `kind` reads it."""
    if kind == "Real":
        return float(text)
    if kind in ("Integer", "Enumeration"):
        return int(text)
    if kind == "Boolean":
        return text.strip() in ("true", "1")
    return text


def _default_initial(causality: str, variability: str) -> str | None:
    """The table of defaults in section 2.2.7."""
    if causality in ("input", "independent"):
        return None
    if causality == "parameter" or variability == "constant":
        return "exact"
    return "calculated"
