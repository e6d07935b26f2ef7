"""Rules of the document around the variables: validity, ModelStructure, default experiment, flags, log categories."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Container, Iterator

from fmpy import read_model_description
from fmpy.model_description import ValidationError
from lxml import etree

from fmu_src.compliance.files.description import Description, is_identifier
from fmu_src.compliance.files.package import Package
from fmu_src.compliance.finding import Finding
from fmu_src.compliance.rules import finding

_LISTS = ("Outputs", "Derivatives", "InitialUnknowns")


def check_schema(root: etree._Element, validator: etree.XMLSchema) -> Iterator[Finding]:
    """The rule xml-schema: the other rules can read a valid document only."""
    if not validator.validate(root):
        for problem in validator.error_log:
            yield finding("xml-schema", f"line {problem.line}", "a valid document", problem.message)


def check_fmpy(package: Package, names: Container[str], already_found: bool) -> Iterator[Finding]:
    """fmpy's validation but for names, which `names.py` looks after; `names` are those of the variables.

    fmpy's reader stumbles over what other rules name; then it has no message of its own worth showing.
    """
    for problem in _problems(package):
        named = next((word for word in re.findall(r'"([^"]+)"', problem) if word in names), "modelDescription.xml")
        is_sentence = " " in problem
        if is_sentence and "index out of range" not in problem:
            expected = "a description that fmpy accepts"
            yield finding("fmpy-validation", named, expected, re.sub(r" \(line \d+\)", "", problem))
        elif not already_found:
            yield finding("fmpy-validation", named, "a description that fmpy can read", problem)


def _problems(package: Package) -> list[str]:
    try:
        read_model_description(str(package.path), validate_variable_names=False, validate_model_structure=True)
    except ValidationError as error:
        # fmpy 0.3.32 takes the aliases of FMI 3.0 for variables of their own there.
        has_aliases = package.root.find("ModelVariables/*/Alias") is not None
        return [text for text in error.problems if not (has_aliases and "ModelStructure/InitialUnknowns" in text)]
    except Exception as error:  # of whatever kind: its reader takes a consistent description for granted
        return [str(error) or type(error).__name__]
    return []


def check_document(description: Description) -> Iterator[Finding]:
    """guid, model-identifier, state-flags, default-experiment, log-category."""
    if not description.guid.strip():
        name = "guid" if description.version == "2.0" else "instantiationToken"
        yield finding("guid", name, "one that tells this FMU from others", "none")
    for element, identifier in description.identifiers.items():
        if not is_identifier(identifier):
            yield finding("model-identifier", element, "a C identifier", f"'{identifier}'")
    state = "FMUstate" if description.version == "2.0" else "FMUState"
    for interface in description.interfaces:
        if description.says(f"canSerialize{state}", interface) and not description.says(
            f"canGetAndSet{state}", interface
        ):
            yield finding("state-flags", f"canSerialize{state}", f"canGetAndSet{state} = true too", "false")
    for name, count in Counter(description.categories).items():
        if count > 1:
            yield finding("log-category", name, "one category of this name", str(count))
    yield from _check_experiment(description.experiment)


def _check_experiment(experiment: dict[str, float]) -> Iterator[Finding]:
    for name, value in experiment.items():
        if not math.isfinite(value):
            yield finding("default-experiment", name, "a finite number", f"{value}")
    finite = {name: value for name, value in experiment.items() if math.isfinite(value)}
    start = finite.get("startTime", 0.0)
    if "stopTime" in finite and finite["stopTime"] < start:
        found = f"{finite['stopTime']:.10g}"
        yield finding("default-experiment", "stopTime", f"a time not before startTime = {start:.10g}", found)
    for name in ("stepSize", "tolerance"):
        if name in finite and not finite[name] > 0:
            yield finding("default-experiment", name, "a positive number", f"{finite[name]:.10g}")


def check_structure(root: etree._Element, description: Description) -> Iterator[Finding]:
    """structure-index, structure-duplicate, dependency-known."""
    variables = description.variables
    states = {variable.derivative for variable in variables} - {None}
    for variable in variables:
        if variable.derivative is not None and not 1 <= variable.derivative <= len(variables):
            expected = f"an index in 1..{len(variables)}"
            yield finding("structure-index", f"derivative of {variable.name}", expected, str(variable.derivative))
    for name in _LISTS:
        unknowns = root.findall(f"ModelStructure/{name}/Unknown")
        indices = [int(unknown.get("index", "0")) for unknown in unknowns]
        for index, count in Counter(indices).items():
            if not 1 <= index <= len(variables):
                yield finding("structure-index", name, f"indices in 1..{len(variables)}", str(index))
            elif count > 1:
                yield finding("structure-duplicate", variables[index - 1].name, f"it once in {name}", f"{count} times")
        for index, unknown in zip(indices, unknowns, strict=True):
            subject = variables[index - 1].name if 1 <= index <= len(variables) else f"index {index}"
            for known in map(int, (unknown.get("dependencies") or "").split()):
                if not 1 <= known <= len(variables):
                    expected = f"dependencies in 1..{len(variables)}"
                    yield finding("structure-index", f"{name}: {subject}", expected, str(known))
                elif not _is_known(description, states, name, known):
                    kind = f"the {variables[known - 1].causality} '{variables[known - 1].name}'"
                    yield finding("dependency-known", f"{name}: {subject}", "dependencies on knowns", kind)


def _is_known(description: Description, states: set[int | None], name: str, index: int) -> bool:
    """Section 2.2.8: inputs, continuous states and time are known; for InitialUnknowns also what starts exactly."""
    variable = description.variables[index - 1]
    if variable.causality in ("input", "independent"):
        return True
    if name == "InitialUnknowns":
        return variable.initial == "exact"
    return index in states or variable.causality == "parameter"  # tunable ones act between steps: tools list them
