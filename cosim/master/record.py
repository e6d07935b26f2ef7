"""The record of a run, which is its exchange buffer too: FMUs write outputs into a row and read inputs from it."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from cosim.fmu import enumeration_items, unit_of
from cosim.master.slave import FMI_KIND, Slave, references
from cosim.results import Message, Result
from cosim.system.resolve import Connection, ResolvedSystem
from cosim.system.transformation import Transformation, apply

STORED = {"Real": np.float64, "Integer": np.int32, "Boolean": np.int32}  # fmi2Real, fmi2Integer, fmi2Boolean
_C: dict[str, Any] = {"Real": ctypes.c_double, "Integer": ctypes.c_int, "Boolean": ctypes.c_int}

# function(component, address of value references, their count, address of the values + row * stride) -> status
Access = tuple[Any, int, int, int, int, int]

Allocate = Callable[[str, tuple[int, ...], Any], np.ndarray]


def allocate(name: str, shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """An array of the record in memory, zero; another function may put it into a file that outlives the process."""
    return np.zeros(shape, dtype)


class Record:
    """Preallocated rows for all numeric outputs of a system, one array for each FMI type.

    Within an array the outputs of one element stand side by side, so that one call reads them; the result has them in the
    order of the model descriptions.

    Args:
        resolved: the system.
        start, step: the times of the rows [s].
        steps: number of communication steps; there is one row more.
        allocate: makes the arrays.
    """

    def __init__(self, resolved: ResolvedSystem, start: float, step: float, steps: int, allocate: Allocate = allocate):
        self._resolved = resolved
        self._step = step
        self.rows = 0  # that are complete
        self.messages: list[Message] = []
        self.notes: list[str] = []
        self._outputs = [
            (element, variable)
            for element, description in resolved.descriptions.items()
            for variable in description.modelVariables
            if variable.causality == "output" and variable.type in FMI_KIND and variable.type != "String"
        ]
        self._blocks: dict[str, dict[str, list[Any]]] = {}  # element -> kind -> variables
        self._column: dict[tuple[str, str], tuple[str, int]] = {}
        widths = dict.fromkeys(STORED, 0)
        for element, variable in self._outputs:
            kind = FMI_KIND[variable.type]
            self._blocks.setdefault(element, {}).setdefault(kind, []).append(variable)
            self._column[element, variable.name] = (kind, widths[kind])
            widths[kind] += 1
        self._arrays = {kind: allocate(kind, (steps + 1, widths[kind]), dtype) for kind, dtype in STORED.items()}
        durations = allocate("durations", (len(resolved.descriptions), steps), np.int64)
        self.step_ns = dict(zip(resolved.descriptions, durations, strict=True))
        self.time = start + np.arange(steps + 1) * step
        self._references: list[Any] = []  # kept alive: the calls hold their addresses

    def reading(self, slave: Slave, row: int = 0) -> list[Access]:
        """The calls that read all outputs of an element into row `row` + i."""
        return [
            self._access(slave, "Get", kind, variables, self._column[slave.name, variables[0].name], row)
            for kind, variables in self._blocks.get(slave.name, {}).items()
        ]

    def writing(self, slave: Slave, connections: list[Connection], row: int = 0) -> list[Access]:
        """The calls that set the inputs which `connections` lead to, from row `row` + i."""
        calls = []
        for c in connections:
            slot = self._column[c.source, c.output.name]
            call = self._access(slave, "Set", slot[0], [c.input], slot, row)
            calls.append((self._converting(call[0], slot[0], c.steps), *call[1:]) if c.steps else call)
        return calls

    def _access(
        self, slave: Slave, verb: str, kind: str, variables: list[Any], slot: tuple[str, int], row: int
    ) -> Access:
        array = self._arrays[slot[0]]
        vr = references(variables)
        self._references.append(vr)
        address = array.ctypes.data + slot[1] * array.itemsize + row * array.strides[0]
        return slave.access(verb, kind), slave.component, vr.ctypes.data, len(vr), address, array.strides[0]

    def _converting(self, function: Any, kind: str, steps: tuple[Transformation, ...]) -> Any:
        """`function`, with the one value that it sets gone through `steps`."""
        made = _C[kind]()
        address = ctypes.addressof(made)
        self._references.append(made)

        def convert(component: int, vr: int, count: int, source: int) -> int:
            made.value = apply(steps, _C[kind].from_address(source).value)
            status: int = function(component, vr, count, address)
            return status

        convert.__name__ = function.__name__
        return convert

    def first_row(self) -> bytes:
        """The bytes of row 0."""
        return b"".join(array[0].tobytes() for array in self._arrays.values())

    def result(self) -> Result:
        """The complete rows."""
        rows = self.rows
        columns: dict[str, np.ndarray] = {}
        variables: dict[str, Any] = {}
        units: dict[str, str] = {}
        for element, variable in self._outputs:
            kind, column = self._column[element, variable.name]
            name = f"{element}.{variable.name}"
            columns[name], variables[name] = self._arrays[kind][:rows, column], variable
            units[name] = unit_of(variable)
        for shown in self._resolved.exposures:
            source = columns[f"{shown.source}.{shown.output.name}"]
            columns[shown.connector], variables[shown.connector] = apply(shown.steps, source), shown.output
            units[shown.connector] = shown.unit
        values = np.empty((rows, len(columns)))
        for i, column_values in enumerate(columns.values()):
            values[:, i] = column_values
        return Result(
            system=self._resolved.system.name,
            step=self._step,
            time=self.time[:rows],
            names=tuple(columns),
            values=values,
            units=units,
            descriptions={name: v.description or "" for name, v in variables.items()},
            kinds={name: v.type for name, v in variables.items()},
            items={name: enumeration_items(v) for name, v in variables.items() if v.type == "Enumeration"},
            step_ns={element: ns[: max(rows - 1, 0)] for element, ns in self.step_ns.items()},
            messages=self.messages,
            sources=self._resolved.sources(),
            notes=self.notes,
        )


def grouped(connections: list[Connection]) -> Mapping[str, list[Connection]]:
    """The connections by the element that they lead to."""
    found: dict[str, list[Connection]] = {}
    for c in connections:
        found.setdefault(c.target, []).append(c)
    return found
