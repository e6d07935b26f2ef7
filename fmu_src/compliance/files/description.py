"""modelDescription.xml as the rules read it: a plain record that travels to child processes.

Read without fmpy, whose reader gives up at the first inconsistency that a rule here is about to name.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import fmpy
from lxml import etree

TYPES = ("Real", "Integer", "Boolean", "String", "Enumeration")
Value = float | int | bool | str

_IDENTIFIER = re.compile(r"[A-Za-z_]\w*\Z", re.ASCII)


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
        return self.variability != "constant" and self.initial in ("exact", "approx")

    @property
    def settable_in_steps(self) -> bool:
        return self.causality == "input" or (self.causality == "parameter" and self.variability == "tunable")


INTERFACES = {"CoSimulation": "co-simulation", "ModelExchange": "model exchange"}  # by element


@dataclass(frozen=True)
class Description:
    """What the rules need. `interfaces`: the attributes of the elements CoSimulation and ModelExchange, those that are there.

    `derivatives`, `initial_unknowns`: the indices in these lists of ModelStructure. `direct`: by the index of an output the inputs, by
    index, on which it may depend without a step; all where it does not say.
    """

    version: str  # of FMI: 2.0 or 3.0
    guid: str
    convention: str  # of variables' names: flat or structured
    interfaces: dict[str, dict[str, str]]
    source_files: tuple[str, ...]
    experiment: dict[str, float]
    categories: tuple[str, ...]
    derivatives: tuple[int, ...]
    initial_unknowns: tuple[int, ...]
    direct: dict[int, frozenset[int]]
    indicators: int  # how many event indicators there are
    variables: tuple[Variable, ...] = field(repr=False)

    @property
    def identifiers(self) -> dict[str, str]:
        """By interface."""
        return {name: attributes.get("modelIdentifier", "") for name, attributes in self.interfaces.items()}

    def says(self, flag: str, interface: str) -> bool:
        """Is this capability flag of the interface true?"""
        return self.interfaces.get(interface, {}).get(flag) in ("true", "1")


def is_identifier(text: str) -> bool:
    """Is it a C identifier? As a file's name it then leads to no other folder."""
    return bool(_IDENTIFIER.match(text))


@cache
def schema() -> etree.XMLSchema:
    """FMI 2.0's schema of modelDescription.xml, from the fmpy package."""
    return etree.XMLSchema(file=str(Path(fmpy.__file__).parent / "schema" / "fmi2" / "fmi2ModelDescription.xsd"))


def read(root: etree._Element) -> Description:
    """The record of a document that is valid against the schema."""
    elements = [element for element in root if element.tag in INTERFACES]
    experiment = root.find("DefaultExperiment")
    variables = tuple(_variables(root))
    return Description(
        version="2.0",
        guid=root.get("guid", ""),
        convention=root.get("variableNamingConvention", "flat"),
        interfaces={str(element.tag): dict(element.attrib) for element in elements},
        source_files=tuple(
            dict.fromkeys(file.get("name", "") for element in elements for file in element.iter("File"))
        ),
        experiment={} if experiment is None else {name: float(value) for name, value in experiment.attrib.items()},
        categories=tuple(element.get("name", "") for element in root.iterfind("LogCategories/Category")),
        derivatives=_listed(root, "Derivatives"),
        initial_unknowns=_listed(root, "InitialUnknowns"),
        direct=_direct(root, variables),
        indicators=int(root.get("numberOfEventIndicators", "0")),
        variables=variables,
    )


def _listed(root: etree._Element, name: str) -> tuple[int, ...]:
    """The indices in a list of ModelStructure."""
    return tuple(int(unknown.get("index", "0")) for unknown in root.iterfind(f"ModelStructure/{name}/Unknown"))


def _direct(root: etree._Element, variables: tuple[Variable, ...]) -> dict[int, frozenset[int]]:
    inputs = frozenset(variable.index for variable in variables if variable.causality == "input")
    listed = {}
    for unknown in root.iterfind("ModelStructure/Outputs/Unknown"):
        dependencies = unknown.get("dependencies")
        known = inputs if dependencies is None else inputs & frozenset(map(int, dependencies.split()))
        listed[int(unknown.get("index", "0"))] = known
    return listed


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
