"""Example 1 by three ways: the FMU natively, the FMU from Python, IPOPT; by turns, to be fair on a drifting machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.example import GUESS, SAMPLE_TIME, L, N, experiment
from benchmarks.ipopt import estimator, solve_all
from benchmarks.native import Unpacked, drive
from benchmarks.python_master import drive_from_python
from reference_models.duffing import DUFFING

ROUNDS = 15
NATIVE_RUNS, PYTHON_RUNS, IPOPT_RUNS = 50, 5, 1  # in each round


@dataclass(frozen=True)
class Comparison:
    """Nanoseconds per sample of each run of 500 samples, by way; mean iterations per sample of the FMU and of IPOPT.

    `difference`: the largest one between the FMU's `filtered.*` and IPOPT's estimate from the first full window on, for
    x1, x2, theta. `same_bits`: driven natively and from Python the FMU gave identical outputs.
    """

    native: np.ndarray
    python: np.ndarray
    ipopt: np.ndarray
    fmu_iterations: float
    ipopt_iterations: float
    difference: np.ndarray
    same_bits: bool


def compare(
    fmu: Unpacked, driver: Path, rounds: int, progress: Callable[[int], None] = lambda done: None
) -> Comparison:
    """Time the three ways in `rounds` rounds; `progress` is called after each with the number of rounds done.

    Raises:
        BenchmarkError, RunError: one of them failed.
    """
    work = experiment(SAMPLE_TIME)
    solver = estimator(DUFFING, GUESS, sample_time=SAMPLE_TIME, N=N, L=L)
    native, python, ipopt = [], [], []
    for done in range(1, rounds + 1):
        natively = drive(driver, fmu, work, NATIVE_RUNS)
        native.append(natively.ns)
        for _ in range(PYTHON_RUNS):
            from_python = drive_from_python(fmu, work)
            python.append(from_python.ns)
        for _ in range(IPOPT_RUNS):
            solved = solve_all(solver, work.samples)
            ipopt.append(solved.ns)
        progress(done)
    filtered = natively.record[L:, len(GUESS) :]
    return Comparison(
        native=np.concatenate(native),
        python=np.array(python),
        ipopt=np.array(ipopt),
        fmu_iterations=float(np.mean(from_python.iterations)),
        ipopt_iterations=float(np.mean(solved.iterations)),
        difference=np.max(np.abs(filtered - solved.estimates), axis=0),
        same_bits=np.array_equal(natively.record, from_python.record),
    )
