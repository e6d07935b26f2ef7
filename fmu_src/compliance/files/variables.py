"""Rules of variables and types that no schema can state: ranges, aliases, declared types, enumerations."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator

from lxml import etree

from fmu_src.compliance.files.description import Description, Variable
from fmu_src.compliance.finding import Finding
from fmu_src.compliance.rules import finding


def check_variables(root: etree._Element, description: Description) -> Iterator[Finding]:
    """The rules of ModelVariables, TypeDefinitions and UnitDefinitions."""
    yield from _types(root, description)
    for variable in description.variables:
        yield from _range(variable)
    yield from _aliases(description)
    independent = [variable for variable in description.variables if variable.causality == "independent"]
    for variable in independent[1:]:
        yield finding("independent", variable.name, f"only one, {independent[0].name}", "another")
    for variable in independent:
        if variable.type != "Real":
            yield finding("independent", variable.name, "a Real", variable.type)


def _repeated(names: list[str]) -> list[str]:
    return [name for name, count in Counter(names).items() if count > 1]


def _types(root: etree._Element, description: Description) -> Iterator[Finding]:
    for name in _repeated([unit.get("name", "") for unit in root.iterfind("UnitDefinitions/Unit")]):
        yield finding("unit-name", name, "one unit of this name", "several")
    types = {str(element.get("name")): element for element in root.iterfind("TypeDefinitions/SimpleType")}
    for name in _repeated([str(element.get("name")) for element in root.iterfind("TypeDefinitions/SimpleType")]):
        yield finding("type-name", name, "one type of this name", "several")
    for variable in description.variables:
        if variable.name in types:
            yield finding("type-name", variable.name, "a name that no variable has", "a type and a variable")
    for name, element in types.items():
        items = element.findall("Enumeration/Item")
        for value in _repeated([item.get("value", "") for item in items]):
            yield finding("enumeration-items", name, "different values", f"{value} more than once")
        for item_name in _repeated([item.get("name", "") for item in items]):
            yield finding("enumeration-items", name, "different names", f"'{item_name}' more than once")
    for variable in description.variables:
        if variable.declared_type is not None:
            yield from _declared_type(variable, types.get(variable.declared_type))


def _declared_type(variable: Variable, declared: etree._Element | None) -> Iterator[Finding]:
    if declared is None:  # then fmpy says so
        return
    base = next(str(child.tag) for child in declared if isinstance(child.tag, str))
    if base != variable.type:
        yield finding("declared-type", variable.name, f"a type of {variable.type}", f"one of {base}")
    elif base == "Enumeration" and variable.start is not None:
        values = [int(item.get("value", "0")) for item in declared.iterfind("Enumeration/Item")]
        if variable.start not in values:
            known = ", ".join(map(str, values))
            yield finding("enumeration-start", variable.name, f"a start value of {known}", str(variable.start))


def _range(variable: Variable) -> Iterator[Finding]:
    if variable.min > variable.max:
        yield finding("min-max", variable.name, f"min not above max = {variable.max:.10g}", f"{variable.min:.10g}")
    elif (
        isinstance(variable.start, (int, float))
        and not isinstance(variable.start, bool)
        and not variable.min <= variable.start <= variable.max
    ):
        limits = f"[{variable.min:.10g}, {variable.max:.10g}]"
        yield finding("start-range", variable.name, f"a start value in {limits}", f"{variable.start:.10g}")


def _aliases(description: Description) -> Iterator[Finding]:
    """In FMI 2.0 variables of one base type with one value reference are aliases; then they must agree."""
    sets: defaultdict[tuple[str, int], list[Variable]] = defaultdict(list)
    for variable in description.variables:
        sets[variable.kind, variable.reference].append(variable)
    for (_, reference), aliases in sets.items():
        if len(aliases) < 2:
            continue
        subject = ", ".join(variable.name for variable in aliases)
        settable = [v.name for v in aliases if v.settable_before_initialization or v.settable_in_steps]
        if len(settable) > 1:
            found = f"value reference {reference} for {', '.join(map(repr, settable))}"
            yield finding("alias-settable", subject, "different value references of settable variables", found)
        constants = [variable for variable in aliases if variable.variability == "constant"]
        if constants and len(constants) < len(aliases):
            found = f"value reference {reference} for a constant and another"
            yield finding("alias-constant", subject, "constants only", found)
        elif len({variable.start for variable in constants}) > 1:
            starts = ", ".join(str(variable.start) for variable in constants)
            yield finding("alias-constant", subject, "equal start values of aliased constants", starts)
        units = sorted({variable.unit for variable in aliases})
        if len(units) > 1:
            yield finding(
                "alias-unit", subject, "one unit", " and ".join(f"'{unit}'" if unit else "none" for unit in units)
            )
