"""What the co-simulation reads from an FMU's modelDescription.xml, and which values its variables take."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import fmpy
from fmpy.model_description import ModelDescription, ModelVariable, read_model_description
from lxml import etree

from cosim.archive import opened, parsed
from cosim.errors import SystemFileError, number

Value = float | int | bool | str

DESCRIPTION = "modelDescription.xml"
# What this project's FMUs say of themselves where their outputs follow from inputs, parameters and time alone.
STATIC = "VendorAnnotations/Tool[@name='observer-fmus']/Static"
INTEGER_LIMIT = 2**31  # fmi2Integer is a C int


def read_description(fmu: Path) -> ModelDescription:
    """The model description of an FMU, as of `read_fmu`."""
    return read_fmu(fmu)[0]


def read_fmu(fmu: Path) -> tuple[ModelDescription, bool]:
    """The model description of the FMI 2.0 co-simulation FMU at `fmu`, and whether it says that it has no state (STATIC).

    It must be valid against FMI's schema. The standard's further rules are left to a compliance check: FMUs by common
    tools break some of them and run well.

    Raises:
        SystemFileError: no such file, not an FMU, invalid XML (with its line), another FMI version, no co-simulation.
    """
    with opened(fmu, "an FMU") as archive:
        tree = parsed(archive, DESCRIPTION, f"{fmu}")
    version = tree.get("fmiVersion")
    if version != "2.0":
        raise SystemFileError(f"{fmu}: is an FMU of FMI version {version}; FMI 2.0 is wanted")
    if tree.find("CoSimulation") is None:
        raise SystemFileError(f"{fmu}: is no co-simulation FMU ({DESCRIPTION} has no CoSimulation element)")
    schema = _fmi2_schema()
    if not schema.validate(tree):
        problem = schema.error_log[0]
        raise SystemFileError(f"{fmu}: {DESCRIPTION}, line {problem.line}: {problem.message}")
    identifier = tree.find("CoSimulation").get("modelIdentifier")
    if not identifier.isidentifier():
        raise SystemFileError(f"{fmu}: the modelIdentifier '{identifier}' is no C identifier")
    try:
        description = read_model_description(str(fmu), validate=False)
    except Exception as error:  # fmpy raises whatever comes where numbers or indices of a valid document make no sense
        raise SystemFileError(f"{fmu}: {DESCRIPTION}: {' '.join(str(error).split())}") from None
    return description, tree.find(STATIC) is not None  # fmpy keeps no vendor annotations


def unpack(fmu: Path, directory: Path) -> None:
    """Extract the FMU into `directory`; names that would lead out of it are cut to stay inside.

    Raises:
        SystemFileError: a damaged file, or one that is too large.
    """
    with opened(fmu, "an FMU") as archive:
        archive.extractall(directory)


@cache
def _fmi2_schema() -> etree.XMLSchema:
    return etree.XMLSchema(file=str(Path(fmpy.__file__).parent / "schema" / "fmi2" / "fmi2ModelDescription.xsd"))


def enumeration_items(variable: ModelVariable) -> dict[int, str]:
    """The item names of an enumeration by their integers; empty for other types."""
    if variable.type != "Enumeration" or variable.declaredType is None:
        return {}
    return {int(item.value): item.name for item in variable.declaredType.items}


def unit_of(variable: ModelVariable) -> str:
    """The unit of a Real variable, its own or its type's; "" if it has none."""
    declared = variable.declaredType
    return variable.unit or (declared.unit if declared is not None else None) or ""


def typed_value(variable: ModelVariable, value: Value) -> Value:
    """`value` as `variable` takes it before initialisation: float, int (Integer, Enumeration), bool or str.

    Text is read as the variable's type asks: "7", "true", the name of an enumeration's item.

    Raises:
        ValueError: the variable cannot be set, or the value is of the wrong kind or outside [min, max].
    """
    if variable.causality != "input" and (
        variable.variability == "constant" or variable.initial not in ("exact", "approx")
    ):
        raise ValueError(
            f"'{variable.name}' is {_article(variable.causality)} that is calculated or constant: it cannot be set"
        )
    match variable.type:
        case "Real":
            made: Value = as_number(variable, value)
        case "Integer":
            made = _whole(variable, value)
        case "Enumeration":
            made = _item(variable, value)
        case "Boolean":
            made = _boolean(variable, value)
        case _:
            return str(value)
    _check_range(variable, made)
    return made


def _article(word: str) -> str:
    return f"an {word}" if word[0] in "aeiou" else f"a {word}"


def as_number(variable: ModelVariable, value: Value) -> float:
    """`value` as a number for `variable`, whatever its limits.

    Raises:
        ValueError: it is none.
    """
    try:
        return number(value) if isinstance(value, str) else float(value)
    except ValueError:
        raise ValueError(f"'{variable.name}' is {_article(variable.type)}: '{value}' is not a number") from None


def _whole(variable: ModelVariable, value: Value) -> int:
    found = as_number(variable, value)
    if not found.is_integer():  # NaN and infinities neither
        raise ValueError(f"'{variable.name}' is an Integer: {value} is not a whole number")
    if not -INTEGER_LIMIT <= found < INTEGER_LIMIT:
        raise ValueError(f"'{variable.name}' is an Integer: {value} is beyond 32 bits")
    return int(found)


def _item(variable: ModelVariable, value: Value) -> int:
    items = enumeration_items(variable)
    for item, name in items.items():
        if value in (name, item, str(item)):
            return item
    known = ", ".join(f"{name} ({item})" for item, name in items.items())
    raise ValueError(f"'{variable.name}' is an Enumeration: '{value}' is none of {known}")


def _boolean(variable: ModelVariable, value: Value) -> bool:
    text = str(value).lower()
    if text in ("true", "1", "1.0"):
        return True
    if text in ("false", "0", "0.0"):
        return False
    raise ValueError(f"'{variable.name}' is a Boolean: '{value}' is neither true nor false")


def limits(variable: ModelVariable) -> tuple[float, float]:
    """[min, max] of a variable, its own or its type's; infinite where it has none."""
    declared = variable.declaredType
    low = variable.min or (declared.min if declared else None)
    high = variable.max or (declared.max if declared else None)
    return float(low) if low else -math.inf, float(high) if high else math.inf


def _check_range(variable: ModelVariable, value: Value) -> None:
    least, most = limits(variable)
    if value < least or value > most:  # type: ignore[operator]  # a number here; NaN passes, the FMU decides on it
        raise ValueError(f"'{variable.name}' = {value} lies outside [{least:.10g}, {most:.10g}]")
