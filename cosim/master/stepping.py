"""The communication points of a run: values settle in initialization mode, then every element steps, as scheduled."""

from __future__ import annotations

import ctypes
import time as clock
from collections.abc import Callable, Mapping, Sequence
from time import perf_counter_ns
from typing import Any

from fmpy.fmi2 import fmi2DoStepStatus, fmi2OK, fmi2Pending, fmi2Warning

from cosim.fmu import Value
from cosim.master.record import Access, Record, grouped
from cosim.master.schedule import Schedule
from cosim.master.signals import Signal, driving
from cosim.master.slave import ENTER, EXIT, GET, SET, SET_UP, STEP, Slave
from cosim.system.resolved import ResolvedSystem

PROGRESS_REPORTS = 200  # per run
# Of each element: itself, the calls that set its inputs, its step, its component, durations, the calls that read it, what it is at.
Work = list[tuple[Slave, list[Access], Any, int, memoryview, list[Access], int, int, int]]
POLL = 1e-3  # [s] between two questions whether a step that is pending has ended


def initialise(
    slaves: Mapping[str, Slave],
    resolved: ResolvedSystem,
    values: Mapping[str, Mapping[str, Value]],
    signals: Sequence[Signal],
    order: Schedule,
    record: Record,
    stop: float,
) -> None:
    """Everything up to row 0: start values, initialization mode, in which inputs and outputs settle.

    FMI 2.0, 4.2.4: inputs are set in initialization mode, all else before; there an output may be read after an input was
    set, so values pass until none changes, but not more often than there are elements.
    """
    start = resolved.system.start
    for name, slave in slaves.items():
        slave.at(SET_UP)
        variables = resolved.variables[name]
        for label, value in values[name].items():
            if variables[label].causality != "input":
                slave.set(variables[label], value, start)
        experiment = resolved.descriptions[name].defaultExperiment
        tolerance = experiment.tolerance if experiment is not None else None
        tolerance = float(tolerance) if tolerance is not None else None
        slave.call(start, lambda fmu, t=tolerance: fmu.setupExperiment(tolerance=t, startTime=start, stopTime=stop))  # type: ignore[misc]
        slave.at(ENTER)
        slave.call(start, lambda fmu: fmu.enterInitializationMode())
        slave.at(SET)
        for label, value in values[name].items():
            if variables[label].causality == "input":
                slave.set(variables[label], value, start)
    into = grouped(resolved.connections)
    for name in order.settling:
        _perform(record.reading(slaves[name]), 0, slaves[name], GET, start)
    passing = {
        name: (
            driving(signals, slaves[name]) + record.writing(slaves[name], into.get(name, [])),
            record.reading(slaves[name]),
        )
        for name in order.settling
    }
    before = None
    for _ in slaves:
        now = record.first_row()
        if now == before:
            break
        before = now
        for name, (sets, gets) in passing.items():
            _perform(sets, 0, slaves[name], SET, start)
            _perform(gets, 0, slaves[name], GET, start)
    for slave in slaves.values():
        slave.at(EXIT)
        slave.call(start, lambda fmu: fmu.exitInitializationMode())
    for name in order.settling:
        _perform(record.reading(slaves[name]), 0, slaves[name], GET, start)
    record.rows = 1


def prepared(
    slaves: Mapping[str, Slave], resolved: ResolvedSystem, signals: Sequence[Signal], order: Schedule, record: Record
) -> Work:
    """The calls that each element's step takes, in their order."""
    into = grouped(resolved.connections)
    work: Work = []
    for name in order.stepping:
        slave, row = slaves[name], int(name in order.following)
        sets = driving(signals, slave, row) + record.writing(slave, into.get(name, []), row)
        # A memoryview stores a number faster than an array does.
        durations = record.step_ns[name].data
        marks = (slave.place + SET, slave.place + STEP, slave.place + GET)
        work.append((slave, sets, slave.do_step, slave.component, durations, record.reading(slave, 1), *marks))
    return work


def step_all(
    work: Work,
    record: Record,
    first: int,
    steps: int,
    step: float,
    here: memoryview,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """The steps from row `first` of the record to row `steps`, of size `step` [s].

    `here` takes what is being done: a number as `Slave.at` notes it, and the row that a step starts from.
    """
    times = record.times
    report = max(1, steps // PROGRESS_REPORTS)
    now, warning = perf_counter_ns, fmi2Warning  # local names are found faster
    for i in range(first, steps):
        time = times[i]
        here[1] = i
        for slave, sets, do_step, component, durations, gets, setting, stepping, getting in work:
            here[0] = setting
            for function, owner, refs, count, address, stride in sets:
                status = function(owner, refs, count, address + i * stride)
                if status > warning:
                    raise slave.failure(function.__name__, status, time)
            here[0] = stepping
            begin = now()
            status = do_step(component, time, step, 1)
            durations[i] = now() - begin
            if status > warning:
                _finish(slave, status, time)
            here[0] = getting
            for function, owner, refs, count, address, stride in gets:
                status = function(owner, refs, count, address + i * stride)
                if status > warning:
                    raise slave.failure(function.__name__, status, times[i + 1])
        record.rows = i + 2
        if progress is not None and (i + 1) % report == 0:
            progress(i + 1, steps)
    here[1] = steps


def _perform(calls: list[Access], row: int, slave: Slave, call: int, time: float) -> None:
    slave.at(call)
    for function, owner, refs, count, address, stride in calls:
        status = function(owner, refs, count, address + row * stride)
        if status > fmi2Warning:
            raise slave.failure(function.__name__, status, time)


def _finish(slave: Slave, status: int, time: float) -> None:
    """Wait for a step that the FMU does in the background.

    Raises:
        RunError: it failed.
    """
    now = ctypes.c_int(status)
    while now.value == fmi2Pending:
        clock.sleep(POLL)
        if slave.get_status(slave.component, fmi2DoStepStatus, ctypes.byref(now)) != fmi2OK:
            break
    if now.value > fmi2Warning:
        raise slave.failure("fmi2DoStep", now.value, time)
