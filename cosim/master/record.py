"""The record of a run, which is its exchange buffer too: FMUs write outputs into a row and read inputs from it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cosim.fmu import enumeration_items, unit_of
from cosim.master.slave import FMI_KIND, Slave, references
from cosim.results import Message, Result
from cosim.system.system import ResolvedSystem

STORED = {"Real": np.float64, "Integer": np.int32, "Boolean": np.int32}  # fmi2Real, fmi2Integer, fmi2Boolean

# function(component, address of value references, their count, address of the values + row * stride) -> status
Access = tuple[Any, int, int, int, int, int, str]


class Record:
    """Preallocated rows for all numeric outputs of a system, one array for each FMI type.

    Within an array the outputs of one element and level stand side by side, so that one call reads them; the result has
    them in the order of the model descriptions.

    Args:
        resolved: the system.
        levels: the outputs' levels, from `cosim.schedule.output_levels`.
        start, step: the times of the rows [s].
        steps: number of communication steps; there is one row more.
    """

    def __init__(
        self, resolved: ResolvedSystem, levels: Mapping[tuple[str, str], int], start: float, step: float, steps: int
    ):
        self._resolved = resolved
        self._step = step
        self._levels = levels
        self.rows = 0  # that are complete
        self.step_ns = {name: np.zeros(steps, dtype=np.int64) for name in resolved.descriptions}
        self.messages: list[Message] = []
        self._outputs = [
            (element, variable)
            for element, description in resolved.descriptions.items()
            for variable in description.modelVariables
            if variable.causality == "output" and variable.type in FMI_KIND and variable.type != "String"
        ]
        self._blocks: dict[tuple[int, str, str], list[Any]] = {}  # (level, element, kind) -> variables
        for element, variable in self._outputs:
            key = (levels[element, variable.name], element, FMI_KIND[variable.type])
            self._blocks.setdefault(key, []).append(variable)
        self._column: dict[tuple[str, str], tuple[str, int]] = {}
        widths = dict.fromkeys(STORED, 0)
        for (_, element, kind), variables in self._blocks.items():
            for variable in variables:
                self._column[element, variable.name] = (kind, widths[kind])
                widths[kind] += 1
        self._arrays = {kind: np.empty((steps + 1, widths[kind]), dtype) for kind, dtype in STORED.items()}
        self.time = start + np.arange(steps + 1) * step
        self._references: list[np.ndarray] = []  # kept alive: the calls hold their addresses

    def exchange(self, slaves: Mapping[str, Slave]) -> list[Access]:
        """The calls that pass all values within one instant: level by level read its outputs, set what they drive."""
        calls: list[Access] = []
        for level in sorted(set(self._levels.values())):
            for (of, element, kind), variables in self._blocks.items():
                if of == level:
                    slot = self._column[element, variables[0].name]
                    calls.append(self._access(slaves[element], "Get", kind, variables, slot))
            for c in self._resolved.connections:
                if self._levels[c.source, c.output.name] == level:
                    slot = self._column[c.source, c.output.name]
                    calls.append(self._access(slaves[c.target], "Set", slot[0], [c.input], slot))
        return calls

    def _access(self, slave: Slave, verb: str, kind: str, variables: list[Any], slot: tuple[str, int]) -> Access:
        array = self._arrays[slot[0]]
        vr = references(variables)
        self._references.append(vr)
        address = array.ctypes.data + slot[1] * array.itemsize
        function = slave.access(verb, kind)
        return function, slave.component, vr.ctypes.data, len(vr), address, array.strides[0], slave.name

    def result(self) -> Result:
        """The complete rows."""
        rows = self.rows
        names = tuple(f"{element}.{variable.name}" for element, variable in self._outputs)
        values = np.empty((rows, len(names)))
        for i, (element, variable) in enumerate(self._outputs):
            kind, column = self._column[element, variable.name]
            values[:, i] = self._arrays[kind][:rows, column]
        named = list(zip(names, (variable for _, variable in self._outputs), strict=True))
        return Result(
            system=self._resolved.system.name,
            step=self._step,
            time=self.time[:rows],
            names=names,
            values=values,
            units={name: unit_of(v) for name, v in named},
            descriptions={name: v.description or "" for name, v in named},
            kinds={name: v.type for name, v in named},
            items={name: enumeration_items(v) for name, v in named if v.type == "Enumeration"},
            step_ns={element: ns[: max(rows - 1, 0)] for element, ns in self.step_ns.items()},
            messages=self.messages,
            upstream=self._resolved.upstream(),
        )
