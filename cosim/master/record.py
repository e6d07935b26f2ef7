"""The record of a run, which is its exchange buffer too: FMUs write outputs into a row and read inputs from it."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from fmpy.model_description import ModelVariable

from cosim.fmu import enumeration_items, unit_of
from cosim.master.slave import FMI_KIND, Slave, references
from cosim.results import Given, Message, Messages, Result
from cosim.system.resolved import Connection, ResolvedSystem
from cosim.system.transformation import Transformation, apply

STORED = {"Real": np.float64, "Integer": np.int32, "Boolean": np.int32}  # fmi2Real, fmi2Integer, fmi2Boolean
DURATIONS = "durations"
_C: dict[str, Any] = {"Real": ctypes.c_double, "Integer": ctypes.c_int, "Boolean": ctypes.c_int}

# function(component, address of value references, their count, address of the values + row * stride) -> status
Access = tuple[Any, int, int, int, int, int]

Allocate = Callable[[str, tuple[int, ...], Any], np.ndarray]


def allocate(name: str, shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """An array of the record in memory, zero; another function may put it into a file that outlives the process."""
    return np.zeros(shape, dtype)


@dataclass(frozen=True)
class Outline:
    """All about a record but its numbers; it can be sent to another process.

    Attributes:
        system: the system's name.
        start, step: the times of the rows [s].
        steps: number of communication steps.
        columns: name, array and column in it of each output of an element.
        exposures: name, source and transformations of each output of the system.
        inputs: path, unit, whether it is measured, source and transformations of each connected Real input.
        recorded: the Real inputs whose values are known beforehand.
        units, descriptions, kinds, items, sources, notes: as of `Result`.
    """

    system: str
    start: float
    step: float
    steps: int
    columns: list[tuple[str, str, int]]
    exposures: list[tuple[str, str, tuple[Transformation, ...]]]
    inputs: list[tuple[str, str, bool, str, tuple[Transformation, ...]]]
    recorded: dict[str, Given]
    units: dict[str, str]
    descriptions: dict[str, str]
    kinds: dict[str, str]
    items: dict[str, dict[int, str]]
    sources: dict[str, frozenset[str]]
    notes: list[str]

    def result(self, arrays: Mapping[str, np.ndarray], rows: int, messages: Sequence[Message]) -> Result:
        """The first `rows` rows of the record in `arrays`."""
        found = {name: arrays[kind][:rows, column] for name, kind, column in self.columns}
        found |= {name: apply(steps, found[source]) for name, source, steps in self.exposures}
        values = np.empty((rows, len(found)))
        for i, column in enumerate(found.values()):
            values[:, i] = column
        return Result(
            system=self.system,
            step=self.step,
            time=self.start + np.arange(rows) * self.step,
            names=tuple(found),
            values=values,
            units=self.units,
            descriptions=self.descriptions,
            kinds=self.kinds,
            items=self.items,
            step_ns={e: np.array(arrays[DURATIONS][i, : max(rows - 1, 0)]) for i, e in enumerate(self.sources)},
            messages=messages,
            sources=self.sources,
            inputs=self._inputs(found),
            notes=self.notes,
        )

    def _inputs(self, columns: Mapping[str, np.ndarray]) -> dict[str, Given]:
        found = {
            path: Given(np.asarray(apply(steps, columns[source]), dtype=float), unit, measured)
            for path, unit, measured, source, steps in self.inputs
        }
        rows = len(next(iter(columns.values()))) if columns else 0
        return found | {path: given._replace(values=given.values[:rows]) for path, given in self.recorded.items()}


class Record:
    """Preallocated rows for all numeric outputs of a system, one array for each FMI type.

    Within an array the outputs of one element stand side by side, so that one call reads them; the result has them in the
    order of the model descriptions.

    Args:
        resolved: the system.
        start, step: the times of the rows [s].
        steps: number of communication steps; there is one row more.
        notes: what whoever reads the numbers should know.
        recorded: the values (steps + 1,) of inputs that are known beforehand, by element and variable.
        allocate: makes the arrays.
    """

    def __init__(
        self,
        resolved: ResolvedSystem,
        start: float,
        step: float,
        steps: int,
        notes: list[str],
        recorded: Sequence[tuple[str, ModelVariable, np.ndarray]] = (),
        allocate: Allocate = allocate,
    ):
        self.rows = 0  # that are complete
        self.messages = Messages()
        outputs = [
            (element, variable)
            for element, description in resolved.descriptions.items()
            for variable in description.modelVariables
            if variable.causality == "output" and variable.type in FMI_KIND and variable.type != "String"
        ]
        self._blocks: dict[str, dict[str, list[ModelVariable]]] = {}  # element -> kind -> variables
        self._column: dict[tuple[str, str], tuple[str, int]] = {}
        widths = dict.fromkeys(STORED, 0)
        for element, variable in outputs:
            kind = FMI_KIND[variable.type]
            self._blocks.setdefault(element, {}).setdefault(kind, []).append(variable)
            self._column[element, variable.name] = (kind, widths[kind])
            widths[kind] += 1
        shown = {e.connector: e for e in resolved.exposures}
        variables = {f"{element}.{variable.name}": variable for element, variable in outputs}
        variables |= {name: exposure.output for name, exposure in shown.items()}
        self.outline = Outline(
            system=resolved.system.name,
            start=start,
            step=step,
            steps=steps,
            columns=[(f"{element}.{v.name}", *self._column[element, v.name]) for element, v in outputs],
            exposures=[(name, f"{e.source}.{e.output.name}", e.steps) for name, e in shown.items()],
            inputs=_real_inputs(resolved),
            recorded={
                path: Given(values, unit, measured)
                for element, variable, values in recorded
                if variable.type == "Real"
                for path, unit, measured in (_shown(resolved, element, variable),)
            },
            units={name: shown[name].unit if name in shown else unit_of(v) for name, v in variables.items()},
            descriptions={name: v.description or "" for name, v in variables.items()},
            kinds={name: v.type for name, v in variables.items()},
            items={name: enumeration_items(v) for name, v in variables.items() if v.type == "Enumeration"},
            sources=resolved.sources(),
            notes=notes,
        )
        self._arrays = {kind: allocate(kind, (steps + 1, widths[kind]), dtype) for kind, dtype in STORED.items()}
        self._arrays[DURATIONS] = allocate(DURATIONS, (len(resolved.descriptions), steps), np.int64)
        self.step_ns = dict(zip(resolved.descriptions, self._arrays[DURATIONS], strict=True))
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
        calls: list[Access] = []
        runs: list[list[Connection]] = []  # of outputs that stand side by side: one call sets what they lead to
        last: tuple[str, int] | None = None
        for c in sorted(connections, key=lambda c: self._column[c.source, c.output.name]):
            kind, column = self._column[c.source, c.output.name]
            if c.steps:
                function, *rest = self._access(slave, "Set", kind, [c.input], (kind, column), row)
                calls.append((self._converting(function, kind, c.steps), *rest))
            elif runs and last == (kind, column - 1):
                runs[-1].append(c)
                last = (kind, column)
            else:
                runs.append([c])
                last = (kind, column)
        for together in runs:
            slot = self._column[together[0].source, together[0].output.name]
            calls.append(self._access(slave, "Set", slot[0], [c.input for c in together], slot, row))
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

    @cached_property
    def times(self) -> list[float]:
        """`time` as numbers of Python's, which a step takes faster than those of an array."""
        return self.time.tolist()

    @property
    def reals(self) -> np.ndarray:
        """The Real outputs, a row each communication point, in the order of their columns."""
        return self._arrays["Real"]

    def first_row(self) -> bytes:
        """The bytes of row 0."""
        return b"".join(self._arrays[kind][0].tobytes() for kind in STORED)

    def result(self) -> Result:
        """The complete rows."""
        return self.outline.result(self._arrays, self.rows, self.messages)


def _real_inputs(resolved: ResolvedSystem) -> list[tuple[str, str, bool, str, tuple[Transformation, ...]]]:
    """The connected ones, in the order of the FMUs, as of `Outline`."""
    into = {(c.target, c.input.name): c for c in resolved.connections if c.input.type == "Real"}
    ordered = [(element, name) for element, variables in resolved.variables.items() for name in variables]
    connections = (into[place] for place in ordered if place in into)
    return [(*_shown(resolved, c.target, c.input), f"{c.source}.{c.output.name}", c.steps) for c in connections]


def _shown(resolved: ResolvedSystem, element: str, variable: ModelVariable) -> tuple[str, str, bool]:
    """Path and unit of an input, and whether it is a measurement."""
    measured = f"measurement_valid.{variable.name}" in resolved.variables[element]
    return f"{element}.{variable.name}", unit_of(variable), measured


def grouped(connections: list[Connection]) -> Mapping[str, list[Connection]]:
    """The connections by the element that they lead to."""
    found: dict[str, list[Connection]] = {}
    for c in connections:
        found.setdefault(c.target, []).append(c)
    return found
