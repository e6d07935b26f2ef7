"""Inputs whose values are given beforehand, such as recorded ones: the master sets a row of them in each instant."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from fmpy.model_description import ModelVariable

from cosim.errors import ExperimentError
from cosim.master.record import STORED, Access
from cosim.master.slave import FMI_KIND, Slave, references
from cosim.system.system import ResolvedSystem, find_variable


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
    """The `inputs` (by path) found in the system.

    Raises:
        ExperimentError: an unknown variable, one that is no numeric input, connected or set too, or other than steps + 1 values.
    """
    drivers, signals = resolved.drivers(), []
    for path, values in inputs.items():
        try:
            element, variable = find_variable(resolved.variables, path)
        except ValueError as error:
            raise ExperimentError(str(error)) from None
        if variable.causality != "input" or variable.type == "String":
            raise ExperimentError(f"'{path}' is no numeric input (a {variable.type}, {variable.causality})")
        if path in drivers:
            raise ExperimentError(f"'{path}' cannot be given values: it is connected to '{drivers[path]}'")
        if path in overrides:
            raise ExperimentError(f"'{path}' has recorded values and is set too: only one is possible")
        if np.shape(values) != (steps + 1,):
            raise ExperimentError(f"'{path}' has {np.size(values)} values; {steps} steps take {steps + 1}")
        stored = np.ascontiguousarray(values, dtype=STORED[FMI_KIND[variable.type]])
        signals.append(Signal(element, variable, stored, references([variable])))
    return signals


def driving(signals: list[Signal], slaves: Mapping[str, Slave]) -> list[Access]:
    """The calls that set a row of all signals; `signals` must outlive them, because they hold its addresses."""
    calls: list[Access] = []
    for s in signals:
        slave, size = slaves[s.element], s.values.itemsize
        function = slave.access("Set", FMI_KIND[s.variable.type])
        calls.append((function, slave.component, s.reference.ctypes.data, 1, s.values.ctypes.data, size, slave.name))
    return calls
