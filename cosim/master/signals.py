"""Inputs whose values are given beforehand, such as recorded ones: the master sets a row of them in each instant."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fmpy.model_description import ModelVariable

from cosim.errors import ExperimentError
from cosim.fmu import INTEGER_LIMIT, enumeration_items
from cosim.master.record import STORED, Access
from cosim.master.slave import FMI_KIND, Slave, references
from cosim.results import read_csv
from cosim.system.resolve import find_variable
from cosim.system.resolved import ResolvedSystem, listed
from cosim.system.transformation import apply


@dataclass(frozen=True)
class Signal:
    """The values (n,) of one input at the communication points, as its type stores them, and its value reference (1,)."""

    element: str
    variable: ModelVariable
    values: np.ndarray
    reference: np.ndarray


def checked(
    inputs: Mapping[str, np.ndarray], resolved: ResolvedSystem, overrides: Collection[str], steps: int
) -> list[Signal]:
    """The `inputs`, by the paths of inputs or the names of the system's input connectors, found in the system.

    Raises:
        ExperimentError: an unknown variable, one that is no numeric input, connected or set too, or other than steps + 1 values.
    """
    drivers, signals = resolved.drivers(), []
    for path, values in inputs.items():
        if path in overrides:
            raise ExperimentError(f"'{path}' has recorded values and is set too: only one is possible")
        if np.shape(values) != (steps + 1,):
            raise ExperimentError(f"'{path}' has {np.size(values)} values; {steps} steps take {steps + 1}")
        if path in resolved.system.connectors:
            kind = resolved.system.connectors[path].kind
            if kind != "input":
                raise ExperimentError(f"'{path}' is no input of the system (its kind is {kind})")
            for s in resolved.supplies:
                if s.connector == path:
                    if s.variable.type != "Real":
                        _check_whole(path, np.asarray(values))
                    signals.append(_signal(s.target, s.variable, apply(s.steps, np.asarray(values))))
            continue
        try:
            element, variable = find_variable(resolved.variables, path)
        except ValueError as error:
            raise ExperimentError(str(error)) from None
        if variable.causality != "input" or variable.type == "String":
            raise ExperimentError(f"'{path}' is no numeric input (a {variable.type}, {variable.causality})")
        if path in drivers:
            raise ExperimentError(f"'{path}' cannot be given values: it is connected to '{drivers[path]}'")
        signals.append(_signal(element, variable, np.asarray(values)))
    return signals


def _signal(element: str, variable: ModelVariable, values: np.ndarray) -> Signal:
    path = f"{element}.{variable.name}"
    if variable.type == "Boolean":
        _check(path, values, np.isin(values, (0, 1)), "neither 0 nor 1")
    elif variable.type == "Enumeration":
        items = list(enumeration_items(variable))
        _check(path, values, np.isin(values, items), f"none of {', '.join(map(str, items))}")
    elif variable.type == "Integer":
        _check_whole(path, values)
    stored = np.ascontiguousarray(values, dtype=STORED[FMI_KIND[variable.type]])
    return Signal(element, variable, stored, references([variable]))


def _check_whole(path: str, values: np.ndarray) -> None:
    fit = (values == np.rint(values)) & (values >= -INTEGER_LIMIT) & (values < INTEGER_LIMIT)
    _check(path, values, fit, "no whole number of 32 bits")


def _check(path: str, values: np.ndarray, fit: np.ndarray, wrong: str) -> None:
    if not fit.all():
        raise ExperimentError(f"'{path}' cannot take {values[int(np.argmin(fit))]:g}: it is {wrong}")


def driving(signals: Sequence[Signal], slave: Slave, row: int = 0) -> list[Access]:
    """The calls that set the inputs of `slave` from row `row` + i of the signals, which must outlive them: they hold addresses."""
    calls: list[Access] = []
    for s in signals:
        if s.element == slave.name:
            size, function = s.values.itemsize, slave.access("Set", FMI_KIND[s.variable.type])
            address = s.values.ctypes.data + row * size
            calls.append((function, slave.component, s.reference.ctypes.data, 1, address, size))
    return calls


def sampled(file: Path, resolved: ResolvedSystem, times: np.ndarray) -> dict[str, np.ndarray]:
    """The columns of a file that feed inputs, at the communication points `times` [s], (n,).

    A Real is linear between two rows, other types hold the last one.

    Raises:
        ExperimentError: a file that cannot be read, times that do not ascend or do not reach from the start to the stop time, no
            column for any input.
    """
    connectors = resolved.system.connectors
    inputs = {s.connector: s.variable.type for s in resolved.supplies if connectors[s.connector].kind == "input"}
    drivers = resolved.drivers()
    for element, variables in resolved.variables.items():
        for variable in variables.values():
            path = f"{element}.{variable.name}"
            if variable.causality == "input" and variable.type != "String" and path not in drivers:
                inputs[path] = variable.type
    try:
        columns = read_csv(file, inputs)
    except OSError as error:
        raise ExperimentError(f"{file}: {error.strerror or error}") from None
    except ValueError as error:
        raise ExperimentError(str(error)) from None
    recorded = columns.pop("time")
    if not columns:
        raise ExperimentError(f"{file}: no column feeds an input; there are {listed(list(inputs)) or 'none'}")
    if len(recorded) < 1 or not np.isfinite(recorded).all() or (np.diff(recorded) <= 0).any():
        raise ExperimentError(f"{file}: the times must be finite and ascend")
    slack = 1e-9 * max(1.0, float(np.abs(times).max()))
    if recorded[0] > times[0] + slack or recorded[-1] < times[-1] - slack:
        raise ExperimentError(
            f"{file}: holds times from {recorded[0]:.10g} to {recorded[-1]:.10g} s, the run goes from {times[0]:.10g} to "
            f"{times[-1]:.10g} s"
        )
    rows = np.maximum(np.searchsorted(recorded, times + slack, side="right") - 1, 0)
    return {
        name: np.interp(times, recorded, values) if inputs[name] == "Real" else values[rows]
        for name, values in columns.items()
    }
