"""The master: it couples the FMUs of a system by fixed communication steps and records what they put out.

In every instant all outputs are read, all inputs set, and then every element steps (Jacobi): no element sees another's
future, and the order of the elements does not matter; `cosim.master.schedule` says what FMUs without a state do instead.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cosim.errors import ExperimentError
from cosim.fmu import Value, as_number, typed_value, unpack
from cosim.master.record import Allocate, Record, allocate
from cosim.master.schedule import Schedule, schedule
from cosim.master.signals import Signal, checked, sampled
from cosim.master.slave import CALLS, TERMINATE, RunError, Slave
from cosim.master.stepping import initialise, prepared, step_all
from cosim.results import Result
from cosim.system import System
from cosim.system.resolve import find_variable, resolve, resolve_ssp
from cosim.system.resolved import ResolvedSystem
from cosim.system.transformation import apply

STEP_TOLERANCE = 1e-6  # of a step: how far the stop time may lie from a whole number of steps
MOST_STEPS = 10**8  # the record of a plant and an observer then takes 15 GB

# Rows of `Prepared.here` where no step has begun: no FMU has been called yet; some have, but row 0 is not there yet.
NOTHING, BEFORE = -2, -1

Inputs = Mapping[str, np.ndarray] | Path


def run(
    system: System | Path | str,
    *,
    stop: float | None = None,
    step: float | None = None,
    overrides: Mapping[str, Value] | None = None,
    inputs: Inputs | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Result:
    """Run a system, given as such or as an .ssp file, from its start time to `stop`, in this process.

    An FMU that crashes takes the process with it, and one whose step never ends holds it for ever:
    `cosim.master.watched.run` does the same in a process of its own.

    Args:
        system: what to run.
        stop: stop time [s]; default: the system's.
        step: communication step size [s]; default: the system's.
        overrides: start values of parameters and unconnected inputs, `{"plant.sensor.seed": 7}`, and values of the system's
            own connectors by their names; text is read as the variable's type asks.
        inputs: values of unconnected inputs and of the system's input connectors at all communication points, the last
            included; or a file as `cosim.results.write_columns` makes, with other times.
        progress: called now and then with the number of steps done and of all.

    Raises:
        SystemFileError: the system or its file is not sound.
        ExperimentError: an unknown or unfit override or input, a stop time that is no whole number of steps away from the start, more
            steps than memory has room for.
        RunError: an FMU failed; `partial` of the error has the rows up to there.
    """
    with ExitStack() as stack:
        directory = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="cosim-"))).resolve()
        made = prepare(system, directory, stop=stop, step=step, overrides=overrides, inputs=inputs)
        try:
            perform(made, directory, progress=progress)
        except RunError as error:
            error.partial = made.record.result()
            raise
        return made.record.result()


@dataclass(frozen=True)
class Prepared:
    """A run that has been checked and waits for its FMUs.

    Attributes:
        resolved: the system.
        stop, step, steps: the experiment [s].
        values: the start values, by element and variable.
        signals: the inputs given beforehand.
        order: the schedule.
        record: the record, still empty.
        here: takes what the run is at: a number as `Slave.at` notes it, and the row that the step started from.
    """

    resolved: ResolvedSystem
    stop: float
    step: float
    steps: int
    values: Mapping[str, Mapping[str, Value]]
    signals: Sequence[Signal]
    order: Schedule
    record: Record
    here: np.ndarray


def prepare(
    system: System | Path | str,
    directory: Path,
    *,
    stop: float | None = None,
    step: float | None = None,
    overrides: Mapping[str, Value] | None = None,
    inputs: Inputs | None = None,
    allocate: Allocate = allocate,
) -> Prepared:
    """Everything about a run that can be wrong before an FMU is loaded. Arguments and errors as of `run`; `directory` is for its FMUs."""
    resolved = resolve(system) if isinstance(system, System) else resolve_ssp(Path(system), directory)
    stop, step = resolved.experiment(stop, step)
    start, overrides = resolved.system.start, overrides or {}
    steps = count_steps(start, stop, step)
    values = start_values(resolved, overrides)
    times = start + np.arange(steps + 1) * step
    given = sampled(inputs, resolved, times) if isinstance(inputs, Path) else inputs or {}
    signals = checked(given, resolved, overrides, steps)
    order = schedule(resolved, [(s.element, s.variable.name) for s in signals])
    try:
        recorded = [(s.element, s.variable, s.values) for s in signals]
        record = Record(resolved, start, step, steps, [*resolved.notes, *order.notes], recorded, allocate)
        here = allocate("here", (2,), np.int64)
    except MemoryError:
        raise ExperimentError(f"the record of {steps} steps of {step:g} s does not fit into memory") from None
    here[1] = NOTHING
    return Prepared(resolved, stop, step, steps, values, signals, order, record, here)


def perform(made: Prepared, directory: Path, progress: Callable[[int, int], None] | None = None) -> None:
    """Load the FMUs, unpacked into `directory`, and run; what comes of it is in the record.

    Raises:
        SystemFileError: an FMU is damaged.
        RunError: an FMU failed; the record has the rows up to there.
    """
    with loaded(made, directory) as slaves:
        begin(made, slaves, made.values)
        work = prepared(slaves, made.resolved, made.signals, made.order, made.record)
        step_all(work, made.record, 0, made.steps, made.step, made.here.data, progress)
        end(made, slaves)


@contextmanager
def loaded(made: Prepared, directory: Path) -> Iterator[dict[str, Slave]]:
    """The FMUs of a run, unpacked into `directory` and instantiated; freed after the block."""
    resolved, here = made.resolved, made.here.data
    folders: dict[Path, Path] = {}
    for element in resolved.system.elements.values():
        if element.fmu not in folders:
            folders[element.fmu] = directory / f"fmu-{len(folders)}"
            unpack(element.fmu, folders[element.fmu])
    here[1] = BEFORE
    with ExitStack() as stack:
        slaves: dict[str, Slave] = {}
        for i, (name, element) in enumerate(resolved.system.elements.items()):
            description, folder, place = resolved.descriptions[name], folders[element.fmu], i * len(CALLS)
            messages, start = made.record.messages, resolved.system.start
            slaves[name] = Slave(name, description, folder, messages, start, here, place)
            stack.callback(slaves[name].free)
        yield slaves


def begin(made: Prepared, slaves: Mapping[str, Slave], values: Mapping[str, Mapping[str, Value]]) -> None:
    """Everything up to row 0, with the start `values`."""
    initialise(slaves, made.resolved, values, made.signals, made.order, made.record, made.stop)


def end(made: Prepared, slaves: Mapping[str, Slave]) -> None:
    """What follows the last step."""
    for slave in slaves.values():
        slave.at(TERMINATE)
        slave.call(made.stop, lambda fmu: fmu.terminate())


def count_steps(start: float, stop: float, step: float) -> int:
    """The number of steps of size `step` from `start` to `stop` [s].

    Raises:
        ExperimentError: `step` is not positive, `stop` does not lie after `start`, or not a whole number of steps, or more
            than MOST_STEPS.
    """
    if not (math.isfinite(step) and step > 0):
        raise ExperimentError(f"step size {step:g} must be positive and finite")
    if not (math.isfinite(stop) and stop > start):
        raise ExperimentError(f"stop time {stop:g} must be finite and lie after the start time {start:g}")
    count = (stop - start) / step
    if count > MOST_STEPS:
        raise ExperimentError(f"{count:.3g} steps of {step:g} s up to {stop:g} s are more than {MOST_STEPS}")
    if round(count) < 1 or abs(count - round(count)) > STEP_TOLERANCE:
        since = f" after the start time {start!r}" if start else ""
        raise ExperimentError(f"stop time {stop!r}{since} is not a multiple of the step size {step!r}")
    return round(count)


def start_values(resolved: ResolvedSystem, overrides: Mapping[str, Value]) -> dict[str, dict[str, Value]]:
    """The values to set before the run, by element and variable: the system's own and the overrides.

    Raises:
        ExperimentError: an override of an unknown or connected variable, or a value that it cannot take.
    """
    values = {element: dict(own) for element, own in resolved.parameters.items()}
    driver = resolved.drivers()
    for path, value in overrides.items():
        if path in driver:
            raise ExperimentError(f"'{path}' cannot be set: it is connected to '{driver[path]}'")
        try:
            if path in resolved.system.connectors:
                _set_connector(resolved, path, value, values)
                continue
            element, variable = find_variable(resolved.variables, path)
            values[element][variable.name] = typed_value(variable, value)
        except ValueError as error:
            raise ExperimentError(str(error)) from None
    return values


def _set_connector(resolved: ResolvedSystem, name: str, value: Value, values: dict[str, dict[str, Value]]) -> None:
    """Pass the `value` of a connector of the system on to what it supplies."""
    reached = [s for s in resolved.supplies if s.connector == name]
    if not reached:
        kind = resolved.system.connectors[name].kind
        raise ValueError(f"'{name}' cannot be set: the connector, of the kind {kind}, supplies nothing")
    for s in reached:
        given = value
        if s.steps:  # the limits of the variable are those of what comes out
            given = as_number(s.variable, value) if s.variable.type == "Real" else typed_value(s.variable, value)
        values[s.target][s.variable.name] = typed_value(s.variable, apply(s.steps, given))
