"""Drives an FMU from Python through fmpy as this project's master does: preallocated buffers, plain addresses."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter_ns

import numpy as np
from fmpy.fmi2 import fmi2Warning

from benchmarks.native import Experiment, Unpacked
from cosim.master.slave import Slave

COUNTED = ("diagnostics.iterations", "diagnostics.solver_failures")


@dataclass(frozen=True)
class PythonRun:
    """`ns` per sample; `record`: the outputs after each step, (n, outputs).

    `iterations`: mean per sample. `failures`: solves that did not converge.
    """

    ns: float
    record: np.ndarray
    iterations: float
    failures: int


def drive_from_python(fmu: Unpacked, experiment: Experiment) -> PythonRun:
    """One run of `experiment`. The diagnostics are read outside the measured time.

    Raises:
        RunError: the FMU failed.
    """
    with begun(fmu, experiment) as slave:
        return _step_all(slave, fmu, experiment)


@contextmanager
def begun(fmu: Unpacked, experiment: Experiment) -> Iterator[Slave]:
    """An instance with the experiment's parameters, at its first step.

    Raises:
        RunError: the FMU failed.
    """
    slave = Slave("driven", fmu.description, fmu.directory, [], 0.0)
    try:
        for name, value in experiment.start.items():
            slave.set(fmu.variable(name), value, 0.0)
        slave.call(0.0, lambda f: f.setupExperiment(startTime=0.0))
        slave.call(0.0, lambda f: f.enterInitializationMode())
        slave.call(0.0, lambda f: f.exitInitializationMode())
        yield slave
    finally:
        slave.free()


def _step_all(slave: Slave, fmu: Unpacked, experiment: Experiment) -> PythonRun:
    count, n, h = len(experiment.samples), len(experiment.outputs), experiment.step
    samples, record = np.ascontiguousarray(experiment.samples, dtype=float), np.empty((count, n))
    counts = np.empty((count, len(COUNTED)), dtype=np.int32)
    names = (experiment.inputs, experiment.outputs, COUNTED)
    references = [np.array(fmu.references(group), dtype=np.uint32) for group in names]
    input_at, outputs_at, counted_at = (array.ctypes.data for array in references)
    set_real, get_real = slave.access("Set", "Real"), slave.access("Get", "Real")
    get_integer = slave.access("Get", "Integer")
    component, do_step = slave.component, slave.do_step
    samples_at, record_at, counts_at = samples.ctypes.data, record.ctypes.data, counts.ctypes.data
    width, total = len(experiment.inputs), 0
    for k in range(count):
        begin = perf_counter_ns()
        status = max(
            set_real(component, input_at, width, samples_at + 8 * width * k),
            do_step(component, k * h, h, 1),
            get_real(component, outputs_at, n, record_at + 8 * n * k),
        )
        total += perf_counter_ns() - begin
        status = max(status, get_integer(component, counted_at, len(COUNTED), counts_at + k * counts.strides[0]))
        if status > fmi2Warning:
            raise slave.failure("set, doStep or get", status, k * h)
    return PythonRun(total / count, record, float(np.mean(counts[:, 0])), int(counts[-1, 1]))
