"""A parameter set as a file of its own (.ssv): values for one FMU's variables by their names, as SSP tools exchange them."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path

from fmpy.model_description import ModelDescription, ModelVariable
from lxml import etree

from cosim.archive import parsed_file
from cosim.errors import ExperimentError, SystemFileError, suggest
from cosim.fmu import Value, unit_of
from cosim.system.resolve import parameter_value, resolve_ssp
from cosim.system.ssp_files import SSC, SSV, validate
from cosim.system.ssp_parameters import Values, values_of
from cosim.system.ssp_writer import add, base_of, list_units, literal
from cosim.system.units import Unit, fmu_units
from cosim.whole import whole


def read_parameter_set(path: Path) -> Values:
    """The values in a file, by name, some with a unit.

    Raises:
        SystemFileError: no such file, no parameter set, or one without a value.
    """
    root = parsed_file(path)
    if etree.QName(root).localname != "ParameterSet":
        raise SystemFileError(f"{path}: holds a {etree.QName(root).localname}, where a ParameterSet (.ssv) is wanted")
    validate(root, "SystemStructureParameterValues", str(path))
    values = values_of(root, str(path))
    if not values:
        raise SystemFileError(f"{path}: has no values")
    return values


def parameters_of(path: Path, description: ModelDescription) -> dict[str, Value]:
    """The values in a file for an FMU, each in the unit of its variable.

    Raises:
        SystemFileError: as `read_parameter_set`.
        ExperimentError: a name that the FMU does not have, a value that its variable does not take.
    """
    variables = {v.name: v for v in description.modelVariables}
    return _suited(path, read_parameter_set(path), variables, fmu_units(description), description.modelName)


def parameters_in_system(path: Path, system: Path) -> dict[str, Value]:
    """The values in a file, by `<element>.<name>`, for the one element of the .ssp file `system` that has all these names.

    Raises:
        SystemFileError: as `read_parameter_set`; the system is not sound.
        ExperimentError: no element has them all, or several do; a value that its variable does not take.
    """
    values = read_parameter_set(path)
    with tempfile.TemporaryDirectory(prefix="cosim-") as folder:
        resolved = resolve_ssp(system, Path(folder).resolve())
    element = the_one_with(path, values, {name: list(known) for name, known in resolved.variables.items()})
    units = fmu_units(resolved.descriptions[element])
    suited = _suited(path, values, resolved.variables[element], units, f"element '{element}'")
    return {f"{element}.{name}": value for name, value in suited.items()}


def the_one_with(path: Path, values: Mapping[str, object], known: Mapping[str, list[str]]) -> str:
    """Which of those in `known` has all the names of `values`.

    Raises:
        ExperimentError: none, or several.
    """
    fitting = [owner for owner, names in known.items() if values.keys() <= set(names)]
    if len(fitting) > 1:
        raise ExperimentError(f"{path}: fits {' and '.join(fitting)} alike: name the variables by --set instead")
    if not fitting:
        best = max(known, key=lambda owner: len(values.keys() & set(known[owner])))
        missing = next(name for name in values if name not in known[best])
        raise ExperimentError(f"{path}: nothing has all of its variables; '{best}' has no '{missing}'")
    return fitting[0]


def _suited(
    path: Path, values: Values, variables: Mapping[str, ModelVariable], units: Mapping[str, Unit], owner: str
) -> dict[str, Value]:
    found = {}
    for name, given in values.items():
        if name not in variables:
            raise ExperimentError(f"{path}: {owner} has no variable '{name}'; {suggest(name, variables)}")
        try:
            found[name] = parameter_value(variables[name], given, units)
        except (ValueError, OverflowError) as error:
            raise ExperimentError(f"{path}: {error}") from None
    return found


def write_parameter_set(path: Path, values: Mapping[str, float], description: ModelDescription) -> None:
    """Write values of an FMU's Real variables, with their units, to `path`, in a folder that is made where there is none.

    Raises:
        OSError: the file cannot be written; what was there before is unchanged.
    """
    variables = {v.name: v for v in description.modelVariables}
    defined = {u.name: u.baseUnit for u in description.unitDefinitions if u.baseUnit is not None}
    root = etree.Element(
        f"{{{SSV}}}ParameterSet", nsmap={"ssv": SSV, "ssc": SSC}, version="1.0", name=description.modelName
    )
    parameters = add(root, SSV, "Parameters")
    used: dict[str, dict[str, str]] = {}
    for name, value in values.items():
        unit = unit_of(variables[name])
        said = {"unit": unit} if unit in defined else {}
        used |= {unit: base_of(defined[unit])} if said else {}
        add(add(parameters, SSV, "Parameter", name=name), SSV, "Real", value=literal(float(value)), **said)
    list_units(root, SSV, used)
    validate(root, "SystemStructureParameterValues", str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole(path) as partial:
        partial.write_bytes(etree.tostring(root, encoding="UTF-8", xml_declaration=True, pretty_print=True))
