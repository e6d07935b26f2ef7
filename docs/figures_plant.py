"""Draws the picture of docs/plant_fmu.md and prints its table: a spring pendulum that is an FMU, estimated by a filter with it inside.

python docs/figures_plant.py
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from figures import BLUE, GREY, ORANGE, save

from fmu_src import PlantFMU
from observers.instance import Instance
from observers.ukf import ukf
from reference_models.plant import plant

H, STEPS = 0.05, 400
MISSING = (120, 140)  # samples from, to
SHOWN = {"mass_r": "length [m]", "mass_phi": "angle [rad]", "spring_c": "stiffness [N/m]"}


@dataclass(frozen=True)
class Run:
    """Times (STEPS,) and, by variable, truth, estimate and standard deviation (STEPS,) each."""

    time: np.ndarray
    truth: dict[str, np.ndarray]
    estimate: dict[str, np.ndarray]
    std: dict[str, np.ndarray]


def simulated(seed: int = 0) -> Run:
    """The pendulum and its filter, coupled as FMUs are."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
    plant_fmu = import_module("plant_fmu")
    with tempfile.TemporaryDirectory() as scratch:
        path = plant_fmu.write(Path(scratch) / "pendulum.fmu", plant_fmu.compiled(Path(scratch)), "pendulum")
        model = PlantFMU(
            path,
            outputs=["mass.phi"],
            inputs=["force"],
            parameters=["mass.m"],
            unknown_parameters=["spring.c"],
            name="swing",
        )
    noisy = {"sensor.noise_std": 0.01, "sensor.sample_time": H, "sensor.seed": seed}
    true = Instance(plant(model), noisy)
    filtered = Instance(
        ukf(
            model,
            sample_time=H,
            process_noise={"spring_c": 0.05},
            measurement_noise={"mass_phi": 0.01},
            initial_std={"mass_r": 0.2, "mass_phi": 0.2, "mass_v": 0.5, "mass_w": 0.5, "spring_c": 20.0},
            guess={"spring_c": 60.0},
        )
    )
    rows = []
    for k in range(STEPS):
        phi = true.get("mass_phi")
        filtered.set("mass_phi", phi)
        filtered.set("measurement_valid.mass_phi", not MISSING[0] <= k < MISSING[1])
        true.step(k * H, H)
        filtered.step(k * H, H)
        rows.append(
            [[true.get(f"x.{v}"), filtered.get(f"estimate.{v}"), filtered.get(f"diagnostics.std.{v}")] for v in SHOWN]
        )
    values = np.array(rows)
    groups = [{v: values[:, i, j] for i, v in enumerate(SHOWN)} for j in range(3)]
    return Run(H * np.arange(1, STEPS + 1), *groups)


def figures_of(run: Run) -> dict[str, tuple[float, float]]:
    """By variable: largest error of the second half, and which part of it lies within two stated deviations."""
    late = STEPS // 2
    found = {}
    for v in SHOWN:
        error = np.abs(run.estimate[v] - run.truth[v])[late:]
        found[v] = float(error.max()), float((error <= 2 * run.std[v][late:]).mean())
    return found


def draw(run: Run) -> None:
    figure, axes = plt.subplots(3, 1, figsize=(8, 6), sharex=True)
    for axis, (v, label) in zip(axes, SHOWN.items(), strict=True):
        band = [run.estimate[v] + side * 2 * run.std[v] for side in (-1, 1)]
        axis.fill_between(run.time, *band, color=BLUE, alpha=0.2, linewidth=0)
        axis.plot(run.time, run.truth[v], color=GREY, linewidth=2.5, label="truth")
        axis.plot(run.time, run.estimate[v], color=BLUE, linewidth=1, label="estimate, ± 2 std")
        axis.axvspan(MISSING[0] * H, MISSING[1] * H, color=ORANGE, alpha=0.15, linewidth=0)
        spread = np.ptp(run.truth[v]) or 30.0
        axis.set_ylim(run.truth[v].min() - 0.8 * spread, run.truth[v].max() + 0.8 * spread)
        axis.set_ylabel(label)
    axes[0].legend(loc="upper right", ncols=2, frameon=False)
    axes[2].set_xlabel("time [s]; no sample arrives in the orange part")
    save(figure, "plant_fmu")


def main() -> None:
    run = simulated()
    draw(run)
    for v, (largest, within) in figures_of(run).items():
        print(f"{v:10} {largest:.2g}  {within:.0%}")


if __name__ == "__main__":
    main()
