"""Drives an FMU from Python through fmpy as this project's master does: preallocated buffers, plain addresses."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter_ns

import numpy as np
from fmpy.fmi2 import fmi2OK

from benchmarks.errors import BenchmarkError
from benchmarks.native import Experiment, Unpacked
from cosim.results import Message
from cosim.slave import Slave

ITERATIONS = "diagnostics.iterations"


@dataclass(frozen=True)
class PythonRun:
    """`ns` per sample; `record`: the outputs after each step, (n, outputs); `iterations` at each sample, (n,)."""

    ns: float
    record: np.ndarray
    iterations: np.ndarray


def drive_from_python(fmu: Unpacked, experiment: Experiment) -> PythonRun:
    """One run of `experiment`. The iterations are read outside the measured time.

    Raises:
        BenchmarkError: a call of the FMU did not return fmi2OK.
    """
    messages: list[Message] = []
    slave = Slave("driven", fmu.description, fmu.directory, messages, 0.0)
    try:
        for name, value in experiment.start.items():
            slave.set(fmu.variable(name), value, 0.0)
        slave.call(0.0, lambda f: f.setupExperiment(startTime=0.0))
        slave.call(0.0, lambda f: f.enterInitializationMode())
        slave.call(0.0, lambda f: f.exitInitializationMode())
        run = _step(slave, fmu, experiment)
    finally:
        slave.free()
    if run is None:
        raise BenchmarkError(f"the FMU failed: {messages[-1].text if messages else 'it says no more'}")
    return run


def _step(slave: Slave, fmu: Unpacked, experiment: Experiment) -> PythonRun | None:
    """All steps, or None if one failed."""
    count, n = len(experiment.samples), len(experiment.outputs)
    samples, record = np.ascontiguousarray(experiment.samples, dtype=float), np.empty((count, n))
    iterations = np.empty(count, dtype=np.int32)
    references = [
        np.array(fmu.references(names), dtype=np.uint32)
        for names in ([experiment.input], experiment.outputs, [ITERATIONS])
    ]
    input_reference, output_references, iterations_reference = (r.ctypes.data for r in references)
    set_real, get_real, get_integer = (
        slave.access("Set", "Real"),
        slave.access("Get", "Real"),
        slave.access("Get", "Integer"),
    )
    component, do_step, h = slave.component, slave.do_step, experiment.step
    sample_address, record_address, iterations_address = samples.ctypes.data, record.ctypes.data, iterations.ctypes.data
    total = 0
    for k in range(count):
        begin = perf_counter_ns()
        status = set_real(component, input_reference, 1, sample_address + 8 * k)
        status |= do_step(component, k * h, h, 1)
        status |= get_real(component, output_references, n, record_address + 8 * n * k)
        total += perf_counter_ns() - begin
        status |= get_integer(component, iterations_reference, 1, iterations_address + 4 * k)
        if status != fmi2OK:
            return None
    return PythonRun(total / count, record, iterations)
