"""Inputs whose values are given beforehand, such as recorded ones: the master sets a row of them in each instant."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from fmpy.model_description import ModelVariable

from cosim.errors import ExperimentError, suggest
from cosim.master.record import STORED, Access
from cosim.master.slave import FMI_KIND, Slave, references
from cosim.system.resolve import find_variable
from cosim.system.resolved import ResolvedSystem
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
        signals.append(_signal(element, variable, values))
    return signals


def _signal(element: str, variable: ModelVariable, values: np.ndarray) -> Signal:
    stored = np.ascontiguousarray(values, dtype=STORED[FMI_KIND[variable.type]])
    return Signal(element, variable, stored, references([variable]))


def driving(signals: Sequence[Signal], slave: Slave, row: int = 0) -> list[Access]:
    """The calls that set the inputs of `slave` from row `row` + i of the signals, which must outlive them: they hold addresses."""
    calls: list[Access] = []
    for s in signals:
        if s.element == slave.name:
            size, function = s.values.itemsize, slave.access("Set", FMI_KIND[s.variable.type])
            address = s.values.ctypes.data + row * size
            calls.append((function, slave.component, s.reference.ctypes.data, 1, address, size))
    return calls


def sampled(
    columns: Mapping[str, np.ndarray], where: str, resolved: ResolvedSystem, times: np.ndarray
) -> dict[str, np.ndarray]:
    """The columns of a file that feed inputs, at the communication points `times` [s], (n,).

    A Real is linear between two rows, other types hold the last one. `time` [s] comes first.

    Raises:
        ExperimentError: times that do not ascend or do not reach from the start to the stop time, no column for any input.
    """
    recorded = columns["time"]
    if len(recorded) < 1 or not np.isfinite(recorded).all() or (np.diff(recorded) <= 0).any():
        raise ExperimentError(f"{where}: the times must be finite and ascend")
    slack = 1e-9 * max(1.0, float(np.abs(times).max()))
    if recorded[0] > times[0] + slack or recorded[-1] < times[-1] - slack:
        raise ExperimentError(
            f"{where}: holds times from {recorded[0]:.10g} to {recorded[-1]:.10g} s, the run goes from {times[0]:.10g} to "
            f"{times[-1]:.10g} s"
        )
    inputs = {name: c.type or "Real" for name, c in resolved.system.connectors.items() if c.kind == "input"}
    drivers = resolved.drivers()
    for element, variables in resolved.variables.items():
        for variable in variables.values():
            path = f"{element}.{variable.name}"
            if variable.causality == "input" and variable.type != "String" and path not in drivers:
                inputs[path] = variable.type
    found: dict[str, np.ndarray] = {}
    for name in columns:
        if name in inputs:
            if inputs[name] == "Real":
                found[name] = np.interp(times, recorded, columns[name])
            else:
                rows = np.searchsorted(recorded, times + slack, side="right") - 1
                found[name] = columns[name][np.maximum(rows, 0)]
    if not found:
        names = [name for name in columns if name != "time"]
        raise ExperimentError(f"{where}: no column feeds an input ({', '.join(names[:6])}); {suggest('', inputs)}")
    return found
