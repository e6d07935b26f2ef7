"""The master: it couples the FMUs of a system by fixed communication steps and records what they put out.

In every instant all outputs are read, all inputs set, and then every element steps (Jacobi): no element sees another's
future, and the order of the elements does not matter. Outputs that depend directly on inputs are read after those.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from time import perf_counter_ns

import numpy as np
from fmpy.fmi2 import fmi2Warning

from cosim.errors import ExperimentError
from cosim.fmu import Value, typed_value, unpack
from cosim.master.record import Access, Record
from cosim.master.schedule import output_levels
from cosim.master.signals import checked, driving
from cosim.master.slave import RunError, Slave
from cosim.results import Result
from cosim.system import System, read_ssp
from cosim.system.system import ResolvedSystem, find_variable, resolve

STEP_TOLERANCE = 1e-6  # of a step: how far the stop time may lie from a whole number of steps
PROGRESS_REPORTS = 200  # per run
MOST_STEPS = 10**8  # the record of a plant and an observer then takes 15 GB


def run(
    system: System | Path | str,
    *,
    stop: float | None = None,
    step: float | None = None,
    overrides: Mapping[str, Value] | None = None,
    inputs: Mapping[str, np.ndarray] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Result:
    """Run a system, given as such or as an .ssp file, from its start time to `stop`.

    Args:
        system: what to run.
        stop: stop time [s]; default: the system's.
        step: communication step size [s]; default: the system's.
        overrides: start values of parameters and unconnected inputs, `{"plant.sensor.seed": 7}`; text is read as the
            variable's type asks.
        inputs: values of unconnected inputs at all communication points, the last included, by path.
        progress: called now and then with the number of steps done and of all steps.

    Raises:
        SystemFileError: the system or its file is not sound.
        ExperimentError: an unknown or unfit override or input, a stop time that is no whole number of steps away from the start, more
            steps than memory has room for.
        RunError: an FMU failed; `partial` of the error has the rows up to there.
    """
    with ExitStack() as stack:
        directory = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="cosim-"))).resolve()
        if not isinstance(system, System):
            system = read_ssp(Path(system), directory)
        resolved = resolve(system)
        stop, step = resolved.experiment(stop, step)
        steps = count_steps(system.start, stop, step)
        values = start_values(resolved, overrides or {})
        signals = checked(inputs or {}, resolved, overrides or {}, steps)
        try:
            record = Record(resolved, output_levels(resolved), system.start, step, steps)
        except MemoryError:
            raise ExperimentError(f"the record of {steps} steps of {step:g} s does not fit into memory") from None
        try:
            slaves = _instantiate(resolved, directory, record, stack)
            # What is given beforehand is set first, so that outputs that depend on it directly are read after it.
            exchange = [*driving(signals, slaves), *record.exchange(slaves)]
            _initialise(slaves, resolved, values, exchange, stop)
            _step_all(slaves, exchange, record, steps, step, progress)
            for slave in slaves.values():
                slave.call(stop, lambda fmu: fmu.terminate())
        except RunError as error:
            error.partial = record.result()
            raise
        return record.result()


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
    """The values to set before initialisation, by element and variable: the system's own and the overrides.

    Raises:
        ExperimentError: an override of an unknown or connected variable, or a value that it cannot take.
    """
    values = {element: dict(own) for element, own in resolved.parameters.items()}
    driver = resolved.drivers()
    for path, value in overrides.items():
        if path in driver:
            raise ExperimentError(f"'{path}' cannot be set: it is connected to '{driver[path]}'")
        try:
            element, variable = find_variable(resolved.variables, path)
            values[element][variable.name] = typed_value(variable, value)
        except ValueError as error:
            raise ExperimentError(str(error)) from None
    return values


def _instantiate(resolved: ResolvedSystem, directory: Path, record: Record, stack: ExitStack) -> dict[str, Slave]:
    """Unpack each FMU once and instantiate the elements; `stack` frees them in the end."""
    unpacked: dict[Path, Path] = {}
    slaves: dict[str, Slave] = {}
    for name, element in resolved.system.elements.items():
        if element.fmu not in unpacked:
            target = directory / f"fmu-{len(unpacked)}"
            unpack(element.fmu, target)
            unpacked[element.fmu] = target
        slaves[name] = Slave(
            name, resolved.descriptions[name], unpacked[element.fmu], record.messages, resolved.system.start
        )
        stack.callback(slaves[name].free)
    return slaves


def _initialise(
    slaves: Mapping[str, Slave],
    resolved: ResolvedSystem,
    values: Mapping[str, Mapping[str, Value]],
    exchange: list[Access],
    stop: float,
) -> None:
    start = resolved.system.start
    for name, slave in slaves.items():
        for variable, value in values[name].items():
            slave.set(resolved.variables[name][variable], value, start)
        slave.call(start, lambda fmu: fmu.setupExperiment(startTime=start, stopTime=stop))
        slave.call(start, lambda fmu: fmu.enterInitializationMode())
    _exchange(exchange, 0, slaves, start)
    for slave in slaves.values():
        slave.call(start, lambda fmu: fmu.exitInitializationMode())


def _step_all(
    slaves: Mapping[str, Slave],
    exchange: list[Access],
    record: Record,
    steps: int,
    step: float,
    progress: Callable[[int, int], None] | None,
) -> None:
    times = record.time.tolist()
    # A memoryview stores a number faster than an array does.
    stepping = [(name, s.do_step, s.component, record.step_ns[name].data) for name, s in slaves.items()]
    report = max(1, steps // PROGRESS_REPORTS)
    for i in range(steps):
        _exchange(exchange, i, slaves, times[i])
        record.rows = i + 1
        for name, do_step, component, durations in stepping:
            begin = perf_counter_ns()
            status = do_step(component, times[i], step, 1)
            durations[i] = perf_counter_ns() - begin
            if status > fmi2Warning:
                raise slaves[name].failure("fmi2DoStep", status, times[i])
        if progress is not None and (i + 1) % report == 0:
            progress(i + 1, steps)
    _exchange(exchange, steps, slaves, times[steps])
    record.rows = steps + 1


def _exchange(exchange: list[Access], row: int, slaves: Mapping[str, Slave], time: float) -> None:
    for function, component, refs, count, address, stride, name in exchange:
        status = function(component, refs, count, address + row * stride)
        if status > fmi2Warning:
            raise slaves[name].failure(function.__name__, status, time)
