"""Nikoukhah's motor (section 5): what a sample of the canonical DAE observer costs, driven natively."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.native import Experiment, drive, unpack
from fmu_src import export
from observers.instance import Instance
from reference_models import nikoukhah_1995

# Label and FMU; the first is the one that the promise is about.
OBSERVERS = {
    "w-form, exact placement": "motor_canonical_dae",
    "w-form, regional placement": "motor_canonical_dae_regional",
    "BDF of order 2, exact placement": "motor_canonical_dae_bdf",
}
SAMPLES, RUNS = 6000, 30  # 6 s


def measurements() -> np.ndarray:
    """y1, y2 and u = 2 (1 + sin 2t) of the plant at t = 0, Ts, ..., (SAMPLES, 3)."""
    plant, Ts = Instance(nikoukhah_1995.motor()), nikoukhah_1995.SAMPLE_TIME
    rows = np.empty((SAMPLES, 3))
    for k in range(SAMPLES):
        u = 2 * (1 + np.sin(2 * k * Ts))
        plant.set("u", u)
        rows[k] = plant.get("y1"), plant.get("y2"), u
        plant.step(plant.time, Ts)
    return rows


def motor_ns(name: str, driver: Path, directory: Path) -> np.ndarray:
    """Nanoseconds for set, doStep, get of the motor's observer called `name` of the catalogue, (RUNS,).

    Raises:
        ExportError: it cannot be built.
        BenchmarkError: it fails.
    """
    fmu = unpack(export(nikoukhah_1995.FMUS[name][0](), directory), directory / name)
    outputs = [f"{group}.x{i}" for group in ("estimate", "filtered") for i in (1, 2, 3)]
    experiment = Experiment(measurements(), nikoukhah_1995.SAMPLE_TIME, ("y1", "y2", "u"), outputs, {})
    return drive(driver, fmu, experiment, RUNS).ns
