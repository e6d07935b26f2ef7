"""What a sample costs for other orders, windows and sample times."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import callgrind
from benchmarks.example import experiment
from benchmarks.flops import ideal_flops
from benchmarks.native import drive, unpack
from benchmarks.python_master import drive_from_python
from fmu_src import export
from observers.pseudospectral import pseudospectral
from reference_models.duffing import DUFFING

# (N, L, Ts): Example 1, Examples 3a and 3b, and the long window of Examples 4 and 5.
STRUCTURES = ((15, 8, 0.1), (15, 80, 0.01), (50, 10, 0.5), (50, 50, 0.1))
RUNS = 15  # of the whole 50 s


@dataclass(frozen=True)
class Cost:
    """Per sample: nanoseconds (median over RUNS), Gauss-Newton iterations, ideal flops, instructions.

    `instructions` is None where valgrind is missing. `library_bytes`: the size of the shared library.
    """

    ns: float
    iterations: float
    flops: float
    instructions: float | None
    library_bytes: int


def cost(N: int, L: int, sample_time: float, driver: Path, directory: Path) -> Cost:
    """Build the observer of this structure into `directory` and drive it for the 50 s of Example 1, start included.

    Raises:
        ExportError: it cannot be built.
        BenchmarkError, RunError: it fails.
    """
    component = pseudospectral(DUFFING, sample_time=sample_time, N=N, L=L, name=f"observer_{N}_{L}")
    fmu = unpack(export(component, directory), directory / component.name)
    work = experiment(sample_time)
    iterations = drive_from_python(fmu, work).iterations
    return Cost(
        ns=float(np.median(drive(driver, fmu, work, RUNS).ns)),
        iterations=iterations,
        flops=ideal_flops(N, L, iterations),
        instructions=callgrind.per_sample(driver, fmu, work) if callgrind.is_installed() else None,
        library_bytes=fmu.library.stat().st_size,
    )
