"""libcosim of the Open Simulation Platform (PyPI: libcosimpy) runs an .ssp file.

libcosim knows no enumerations: outputs of that type are left out, and an enumeration as a connector ends the process. Its
times and steps are whole nanoseconds.
"""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from libcosimpy._internal import get_last_error_message
from libcosimpy.CosimEnums import CosimVariableType
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimObserver import CosimObserver

from cosim.masters.experiment import Experiment, MasterError, Recording
from cosim.system.ssp_files import STRUCTURE

NANOSECOND = 1e9  # in a second
# libcosim's time series hold no other types.
KINDS = {"Real": CosimVariableType.REAL, "Integer": CosimVariableType.INTEGER}

Read = Callable[[int, int, int, int], tuple[list[int], list[int], list[float]]]


def record(experiment: Experiment, stepped: Callable[[], object]) -> Recording:
    """The columns of all Real and Integer outputs; calls `stepped` after each step.

    Raises:
        MasterError: libcosim cannot load the system, or an FMU failed.
    """
    log_output_level(CosimLogLevel.ERROR)
    with tempfile.TemporaryDirectory(prefix="cosim-") as directory:
        with zipfile.ZipFile(experiment.path) as archive:
            archive.extractall(directory)
        try:
            execution = CosimExecution.from_ssp_file(
                str(Path(directory) / STRUCTURE), round(experiment.step * NANOSECOND)
            )
        except AssertionError as error:  # libcosimpy's only sign of failure
            raise MasterError(get_last_error_message()) from error
        indices = {slave.name.decode(): slave.index for slave in execution.slave_infos()}
        references = {
            (element, variable.name.decode()): variable.reference
            for element, index in indices.items()
            for variable in execution.slave_variables(index)
        }
        outputs = [output for output in experiment.outputs if output.kind in KINDS]
        keys = [(indices[o.element], references[o.element, o.variable], KINDS[o.kind]) for o in outputs]
        observer = CosimObserver.create_time_series(experiment.steps + 1)
        execution.add_observer(observer)
        for key in keys:
            observer.start_time_series(*key)
        for _ in range(experiment.steps):
            if not execution.step(1):
                raise MasterError(get_last_error_message())
            stepped()
        recording: Recording = {}
        for output, (index, reference, kind) in zip(outputs, keys, strict=True):
            real = kind is CosimVariableType.REAL
            read = observer.time_series_real_samples if real else observer.time_series_integer_samples
            times, values = _series(read, index, reference, experiment.steps)
            recording.setdefault("time", times)
            recording[output.column] = values
        return recording


def _series(read: Read, index: int, reference: int, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and values, both (steps + 1,).

    libcosimpy takes a sample whose step number is 0 for none and returns one sample less: the first is read by itself, with
    room for another.
    """
    first, rest = read(index, reference, 0, 2), read(index, reference, 1, steps)
    times, values = first[0] + rest[0], first[2] + rest[2]
    return np.array(times) / NANOSECOND, np.array(values, dtype=float)
