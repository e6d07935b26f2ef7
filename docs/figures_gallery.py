"""Makes the pictures of the gallery's pages and prints their tables, from the systems that `observer-fmus build --file NAME.py` makes.

python docs/figures_gallery.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from figures import BLUE, GREY, ORANGE, save

from cosim.master import run
from cosim.results import Result

GYRO = {f"plant.actuator.noise_std.gyro_{axis}": 0.01 for axis in "xyz"}
ACCELEROMETER = {f"plant.sensor.noise_std.a{axis}": 0.1 for axis in "xyz"}
# The system of each model, the noise of its sensors, and what else is tried.
RUNS = {
    "stirred_tank": (
        "stirred_tank_riccati",
        {"plant.sensor.sample_time": 5.0, "plant.sensor.noise_std": 0.2},
        [{"observer.guess.cooling": 0.1}, {"plant.parameter.k0": 1.26e9}, {"plant.parameter.k0": 1.44e9}],
    ),
    "lithium_cell": (
        "lithium_cell_ukf",
        {"plant.sensor.sample_time": 1.0, "plant.sensor.noise_std": 0.002},
        [{"observer.guess.soc": 0.3}, {"plant.parameter.R1": 0.03}, {"plant.parameter.capacity": 8352.0}],
    ),
    "single_track_car": (
        "single_track_car_ukf",
        {"plant.sensor.sample_time": 0.02, "plant.sensor.noise_std.yaw_rate": 0.003, "plant.sensor.noise_std.ay": 0.1},
        [{"plant.parameter.mass": 1800.0}, {"plant.parameter.stiffness_rear": 85000.0}, {"source.slalom": 0.0}],
    ),
    "gyro_attitude": (
        "gyro_attitude_ukf",
        {"plant.sensor.sample_time": 0.02, **ACCELEROMETER, "plant.sensor.noise_std.compass": 0.05, **GYRO},
        [{"observer.guess.yaw": -0.5}, {"plant.sensor.noise_std.ax": 1.0}, {"plant.actuator.noise_std.gyro_x": 0.1}],
    ),
    "quadruple_tank": (
        "quadruple_tank_pseudospectral",
        {"plant.sensor.sample_time": 2.0, "plant.sensor.noise_std.y1": 0.1, "plant.sensor.noise_std.y2": 0.1},
        [{"observer.guess.valve1": 0.1}, {"plant.parameter.valve2": 0.55}, {"plant.parameter.a1": 0.0639}],
    ),
}


def estimated(result: Result) -> list[str]:
    return [name.removeprefix("observer.estimate.") for name in result.names if name.startswith("observer.estimate.")]


def row(result: Result, label: str) -> str:
    """The largest errors and how much is trusted, over the second half of a run."""
    late = len(result.time) // 2
    cells = [f"{result['observer.diagnostics.trusted'][late:].mean():.0%}".replace("%", " %")]
    for v in estimated(result):
        cells.append(f"{np.abs(result[f'observer.estimate.{v}'] - result[f'plant.x.{v}'])[late:].max():.2g}")
    return f"| {label} | {' | '.join(cells)} |"


def picture(result: Result, name: str) -> None:
    """Truth and estimate of everything that is estimated; grey where it is not trusted."""
    shown = estimated(result)
    figure, axes = plt.subplots(len(shown), 1, figsize=(8, 1.5 * len(shown) + 0.6), sharex=True, layout="constrained")
    trusted = result["observer.diagnostics.trusted"] > 0
    for axis, v in zip(axes, shown, strict=True):
        axis.plot(result.time, result[f"plant.x.{v}"], color=BLUE, label="true, in the plant's FMU")
        axis.plot(result.time, result[f"observer.estimate.{v}"], "--", color=ORANGE, label="estimate")
        axis.fill_between(
            result.time, 0, 1, where=~trusted, color=GREY, alpha=0.2, linewidth=0, transform=axis.get_xaxis_transform()
        )
        unit = result.units[f"plant.x.{v}"]
        axis.set_ylabel(f"{v} [{unit}]" if unit and unit != "1" else v)
    axes[0].legend(frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1, 1))
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(result.time[0], result.time[-1])
    figure.align_ylabels(axes)
    save(figure, f"gallery_{name}")


if __name__ == "__main__":
    for name, (system, noise, tried) in RUNS.items():
        path = Path("systems") / f"{system}.ssp"
        result = run(path, overrides=noise)
        picture(result, name)
        print(f"\n{name}: {', '.join(estimated(result))}")
        print(row(result, "as above"))
        for other in tried:
            ((variable, value),) = other.items()
            print(row(run(path, overrides={**noise, **other}), f"`--set {variable}={value:.10g}`"))
