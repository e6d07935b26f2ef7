"""A run that is made many times with other start values: its FMUs stay loaded, and each time are reset.

On the way it can make detours: from every n-th row on the FMUs take n steps with other inputs, what they then put out is kept, and they
come back to the state in which they left.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cosim.errors import ExperimentError
from cosim.fmu import Value
from cosim.master.record import Allocate
from cosim.master.run import NOTHING, Prepared, begin, end, loaded, start_values
from cosim.master.signals import checked
from cosim.master.slave import SET_UP, Slave
from cosim.master.stepping import prepared, step_all

ENDS = "ends"  # the array of what detours lead to: a row each, the columns of the record's Reals


@dataclass(frozen=True)
class Detour:
    """`every` so many rows, for so many steps, with these `inputs` at all rows, by path, in place of the run's."""

    every: int
    inputs: Mapping[str, np.ndarray]


class Repetition:
    """A prepared run, loaded in `folder`; `inputs` and `overrides` are those that it was prepared with."""

    def __init__(
        self,
        made: Prepared,
        folder: Path,
        inputs: Mapping[str, np.ndarray],
        overrides: Mapping[str, Value],
        detour: Detour | None,
        allocate: Allocate,
    ):
        self.made, self._overrides, self._folder, self._detour = made, dict(overrides), folder, detour
        if detour is not None:
            for name, description in made.resolved.descriptions.items():
                if not description.coSimulation.canGetAndSetFMUstate:
                    raise ExperimentError(
                        f"element '{name}': its FMU cannot save its state (canGetAndSetFMUstate), so nothing ahead can be tried"
                    )
            self._elsewhere = checked(dict(inputs) | dict(detour.inputs), made.resolved, overrides, made.steps)
            try:
                self.ends = allocate(ENDS, (made.steps // detour.every, made.record.reals.shape[1]), np.float64)
            except MemoryError:
                raise ExperimentError(
                    f"the ends of {made.steps // detour.every} detours do not fit into memory"
                ) from None

    def load(self) -> None:
        """Load the FMUs; they stay until the process ends."""
        made = self.made
        self._stack = ExitStack()  # kept: what it holds is freed with it
        self._slaves = self._stack.enter_context(loaded(made, self._folder))
        self._work = prepared(self._slaves, made.resolved, made.signals, made.order, made.record)
        if self._detour is not None:
            self._wandering = prepared(self._slaves, made.resolved, self._elsewhere, made.order, made.record)

    def again(self, overrides: Mapping[str, Value], steps: int) -> None:
        """The first `steps` steps with these start values beside the run's own."""
        made, here = self.made, self.made.here.data
        here[1] = NOTHING
        os.chdir(self._folder / "scratch")
        values = start_values(made.resolved, self._overrides | dict(overrides))
        for slave in self._slaves.values():
            slave.at(SET_UP)
            slave.call(made.resolved.system.start, lambda fmu: fmu.reset())
        made.record.rows = 0
        begin(made, self._slaves, values)
        if self._detour is None:
            step_all(self._work, made.record, 0, steps, made.step, here)
        else:
            self._with_detours(steps, self._detour.every)
        end(made, self._slaves)

    def _with_detours(self, steps: int, every: int) -> None:
        made, here = self.made, self.made.here.data
        for count, first in enumerate(range(0, steps, every)):
            last = min(first + every, steps)
            if first + every <= steps:
                time = made.resolved.system.start + first * made.step
                states = {name: _saved(slave, time) for name, slave in self._slaves.items()}
                step_all(self._wandering, made.record, first, last, made.step, here)
                self.ends[count] = made.record.reals[last]
                for name, slave in self._slaves.items():
                    slave.call(time, _restoring(states[name]))
            step_all(self._work, made.record, first, last, made.step, here)


def _saved(slave: Slave, time: float) -> Any:
    found: list[Any] = []
    slave.call(time, lambda fmu: found.append(fmu.getFMUState()))
    return found[0]


def _restoring(state: Any) -> Callable[[Any], None]:
    def restore(fmu: Any) -> None:
        fmu.setFMUState(state)
        fmu.freeFMUState(state)

    return restore
