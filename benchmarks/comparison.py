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

ROUNDS, NOISY_ROUNDS = 15, 2
NOISE_BOUNDS = (0.001, 0.01, 0.1)  # half-widths [m]; y itself is about 1 m
NATIVE_RUNS, PYTHON_RUNS = 50, 5  # in each round, and one of IPOPT


@dataclass(frozen=True)
class Comparison:
    """Nanoseconds per sample of each run of 500 samples, by way; mean iterations per sample of the FMU and of IPOPT.

    `failures`: samples at which the FMU did not converge, said so, and kept its prediction.

    `difference`: between the FMU's `filtered.*` and IPOPT's estimates of x1, x2, theta at the samples from the first full
    window on, (n - L, 3). `same_bits`: driven natively and from Python the FMU gave identical outputs.
    """

    native: np.ndarray
    python: np.ndarray
    ipopt: np.ndarray
    fmu_iterations: float
    failures: int
    ipopt_iterations: float
    difference: np.ndarray
    same_bits: bool


def compare(
    fmu: Unpacked,
    driver: Path,
    rounds: int,
    noise_bound: float = 0.0,
    progress: Callable[[], None] = lambda: None,
) -> Comparison:
    """Time the three ways in `rounds` rounds; `progress` is called after each.

    `noise_bound` is the half-width of the measurement's uniform noise [m].

    Raises:
        BenchmarkError, RunError: one of them failed.
    """
    work = experiment(SAMPLE_TIME, noise_bound)
    solver = estimator(DUFFING, GUESS, sample_time=SAMPLE_TIME, N=N, L=L)
    native, python, ipopt = [], [], []
    for _ in range(rounds):
        natively = drive(driver, fmu, work, NATIVE_RUNS)
        native.append(natively.ns)
        for _ in range(PYTHON_RUNS):
            from_python = drive_from_python(fmu, work)
            python.append(from_python.ns)
        solved = solve_all(solver, work.samples)
        ipopt.append(solved.ns)
        progress()
    filtered = natively.record[L:, len(GUESS) :]
    return Comparison(
        native=np.concatenate(native),
        python=np.array(python),
        ipopt=np.array(ipopt),
        fmu_iterations=from_python.iterations,
        failures=from_python.failures,
        ipopt_iterations=float(np.mean(solved.iterations)),
        difference=np.abs(filtered - solved.estimates),
        same_bits=np.array_equal(natively.record, from_python.record),
    )
