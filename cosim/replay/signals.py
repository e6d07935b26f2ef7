"""Columns of a log become the signals of an FMU's inputs: which column feeds which input, its unit, and what an empty cell means."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from fmpy.model_description import ModelDescription, ModelVariable

from cosim.errors import ExperimentError, suggest
from cosim.fmu import Value, unit_of
from cosim.replay import cells, units
from cosim.replay.cells import Converter
from cosim.replay.log import Column, Log, Rows
from cosim.system.units import fmu_units

TIME = "time"
VALID = "measurement_valid."  # an input of this prefix says whether the measurement of that name counts; it starts at 1


@dataclass(frozen=True)
class Signals:
    """The values of inputs at the rows of a log.

    Attributes:
        values: (n,) by the input's name; NaN where a measurement is missing.
        missing: which cells of a known input were empty and hold the value before them (of the first ones: after), (n,) of bool.
        converted: the units from and to, by input.
        unchecked: the unit of the column, by input without one.
    """

    values: Mapping[str, np.ndarray]
    missing: Mapping[str, np.ndarray]
    converted: Mapping[str, tuple[str, str]]
    unchecked: Mapping[str, str]


def inputs_of(description: ModelDescription) -> dict[str, ModelVariable]:
    """The numeric inputs of an FMU."""
    return {v.name: v for v in description.modelVariables if v.causality == "input" and v.type != "String"}


def measured(name: str, inputs: Mapping[str, ModelVariable]) -> bool:
    """Is the input a measurement, for which NaN says that it is missing? All are where the FMU does not tell."""
    flagged = {other.removeprefix(VALID) for other in inputs if other.startswith(VALID)}
    return name in flagged if flagged else True


def columns_of(
    log: Log, inputs: Mapping[str, ModelVariable], mapping: Mapping[str, str], overrides: Mapping[str, Value]
) -> dict[str, Column]:
    """The column of each input that has one.

    Raises:
        ExperimentError: `mapping` names what is not there; an input has neither column nor value, or both; no input has a column.
    """
    for name in mapping:
        if name not in inputs and name != TIME:
            raise ExperimentError(f"there is no input '{name}' to map; {suggest(name, inputs)}")
    found = {name: log.column(mapping[name]) if name in mapping else log.find(name) for name in inputs}
    columns = {name: column for name, column in found.items() if column is not None}
    for name in inputs:
        if name not in columns and name not in overrides and not name.startswith(VALID):
            raise ExperimentError(
                f"{log.path}: there is no column for the input '{name}' among {', '.join(log.heads)}; name one by "
                f"--map {name}=COLUMN, or give a constant by --set {name}=VALUE"
            )
        if name in columns and name in overrides:
            raise ExperimentError(
                f"input '{name}' is set and has the column '{columns[name].head}': only one is possible"
            )
    if not columns:
        raise ExperimentError(f"{log.path}: no column feeds an input of the FMU")
    return columns


def time_column(log: Log, mapping: Mapping[str, str], sample_time: float | None) -> Column | None:
    """The column of the times; None where the rows are `sample_time` [s] apart.

    Raises:
        ExperimentError: neither or both, or a sample time that is none.
    """
    column = log.column(mapping[TIME]) if TIME in mapping else log.find(TIME)
    if sample_time is None:
        if column is None:
            raise ExperimentError(
                f"{log.path} has no column 'time' among {', '.join(log.heads)}: name it by --map time=COLUMN, or give the time "
                "between its rows by --sample-time"
            )
        return column
    if column is not None:
        raise ExperimentError(f"{log.path} has a column '{column.head}' of times: leave --sample-time out")
    if not (np.isfinite(sample_time) and sample_time > 0):
        raise ExperimentError(f"--sample-time {sample_time:g} must be positive and finite")
    return None


def read(log: Log, time: Column | None, kinds: Mapping[Column, Converter]) -> Rows:
    """The rows of a log: its times, and the columns `kinds`.

    Raises:
        ExperimentError: as `Log.read`; a column feeds what it cannot.
    """
    heads = {column.head: convert for column, convert in kinds.items()}
    if time is not None:
        if time.head in heads:
            raise ExperimentError(f"{log.path}: the column '{time.head}' cannot be the time and a signal")
        heads |= {time.head: cells.time(log.decimal)}
    return log.read(heads)


def times(log: Log, column: Column | None, rows: Rows, sample_time: float | None) -> np.ndarray:
    """The times of the rows, (n,) [s]: from `column` in its unit, or `sample_time` apart.

    Raises:
        ExperimentError: the unit of the column is none of time.
    """
    if column is None:
        assert sample_time is not None
        return np.arange(len(rows.lines)) * sample_time
    found = rows.values[column.head]
    if column.unit in units.NONE or column.unit == "s":
        return found
    given = units.parse(column.unit)
    if given is None or given.exponents != units.SECOND.exponents:
        raise ExperimentError(f"{log.path}: the unit '{column.unit}' of the column '{column.head}' is none of time")
    return units.converted(found, given, units.SECOND)


def signals(
    log: Log,
    description: ModelDescription,
    inputs: Mapping[str, ModelVariable],
    columns: Mapping[str, Column],
    rows: Rows,
) -> Signals:
    """The values of each input in its own unit, (n,), those of known inputs held over empty cells.

    Raises:
        ExperimentError: the unit of a column is not known or measures something else than its input; a known input has no value.
    """
    values, missing, converted, unchecked = {}, {}, {}, {}
    for name, column in columns.items():
        found, variable = rows.values[column.head], inputs[name]
        given, wanted = column.unit, unit_of(variable)
        if given and given != wanted and variable.type == "Real":
            if wanted:
                found = _converted(log, description, column, found, name, wanted)
                if given not in units.NONE or wanted not in units.NONE:
                    converted[name] = (given, wanted)
            else:
                unchecked[name] = given
        if variable.type == "Real" and not measured(name, inputs):
            empty = np.isnan(found)
            found = _held(log, column, name, found, empty)
            missing[name] = empty
        values[name] = found
    return Signals(values, missing, converted, unchecked)


def converters(log: Log, inputs: Mapping[str, ModelVariable], columns: Mapping[str, Column]) -> dict[Column, Converter]:
    """What reads each column, by the type of the input that it feeds.

    Raises:
        ExperimentError: a column feeds inputs of two types.
    """
    found: dict[Column, tuple[str, Converter]] = {}
    for name, column in columns.items():
        kind = inputs[name].type
        if found.setdefault(column, (kind, _converter(log, kind)))[0] != kind:
            raise ExperimentError(f"{log.path}: the column '{column.head}' feeds inputs of two types")
    return {column: convert for column, (_, convert) in found.items()}


def _converter(log: Log, kind: str) -> Converter:
    if kind == "Boolean":
        return cells.truth
    return log.number() if kind == "Real" else cells.whole(log.decimal, log.reading.missing)


def _converted(
    log: Log, description: ModelDescription, column: Column, values: np.ndarray, name: str, wanted: str
) -> np.ndarray:
    given = units.parse(column.unit)
    if given is None:
        raise ExperimentError(
            f"{log.path}: the unit '{column.unit}' of the column '{column.head}' is unknown; without it the numbers are taken as "
            f"they are, in {wanted}"
        )
    target = fmu_units(description).get(wanted) or units.parse(wanted)
    try:
        if target is None:
            raise ValueError
        return units.converted(values, given, target)
    except ValueError:
        raise ExperimentError(
            f"{log.path}: the column '{column.head}' is in {column.unit}, which cannot become {wanted}, the unit of the input "
            f"'{name}'"
        ) from None


def _held(log: Log, column: Column, name: str, values: np.ndarray, empty: np.ndarray) -> np.ndarray:
    """`values` with the last one before each empty cell in it; before the first value, that one."""
    if empty.all():
        raise ExperimentError(
            f"{log.path}: the column '{column.head}' of the known input '{name}' is empty throughout: give a constant by "
            f"--set {name}=VALUE, under another name of the column"
        )
    last = np.maximum.accumulate(np.where(empty, -1, np.arange(len(values))))
    return values[np.where(last < 0, int(np.argmin(empty)), last)]
