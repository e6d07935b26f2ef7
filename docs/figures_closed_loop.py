"""Makes the pictures of docs/closed_loop.md from runs of the built systems: python docs/figures_closed_loop.py"""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from figures import BLUE, GREEN, GREY, ORANGE, save

from cosim.master import run
from cosim.results import Result
from observers.instance import Instance
from reference_models import gong_2007

LOOPS = {
    "pseudospectral observer": ("plant", "observer.u", BLUE, "-"),
    "UKF": ("plant_ukf", "observer_ukf.u", ORANGE, "-"),
    "true state": ("plant_true", "plant_true.u", GREEN, "--"),
}


def free(time: np.ndarray, step: float) -> np.ndarray:
    """x1 of the oscillator that nobody controls."""
    plant, values = Instance(gong_2007.duffing(), gong_2007.START), []
    for k in range(len(time)):
        values.append(plant.get("x.x1"))
        plant.step(k * step, step)
    return np.array(values)


def duffing(result: Result) -> None:
    figure, axes = plt.subplots(4, 1, figsize=(8, 8), sharex=True)
    axes[0].plot(result.time, free(result.time, result.step), ":", color=GREY, label="without control")
    for label, (plant, control, colour, style) in LOOPS.items():
        distance = np.hypot(result[f"{plant}.x.x1"], result[f"{plant}.x.x2"])
        axes[0].plot(result.time, result[f"{plant}.x.x1"], style, color=colour, label=label)
        axes[1].semilogy(result.time, distance, style, color=colour, linewidth=0.9)
        axes[2].step(result.time, result[control], style, where="post", color=colour, linewidth=0.9)
    for element, colour in (("observer", BLUE), ("observer_ukf", ORANGE)):
        axes[3].plot(result.time, result[f"{element}.estimate.theta"], color=colour, linewidth=0.9)
    axes[3].plot(result.time, result["plant.x.theta"], "--", color=GREEN)
    axes[0].set_ylim(-2, 3)
    axes[0].set_ylabel("$x_1$ [m]")
    axes[0].legend(frameon=False, fontsize=8, ncols=4, loc="upper right")
    axes[1].set_ylabel("distance from\nthe origin")
    axes[2].set_ylabel("$u$ [m/s$^2$]")
    axes[3].set_ylabel(r"$\theta$ [m/s$^2$]")
    axes[3].set_ylim(-0.3, 1.0)
    axes[3].set_xlabel("time [s]")
    axes[3].set_xlim(0, result.time[-1])
    figure.align_ylabels(axes)
    save(figure, "closed_loop_duffing")


def motor(result: Result) -> None:
    figure, axes = plt.subplots(3, 1, figsize=(8, 5.5), sharex=True)
    for label, plant, control, colour, style in (
        ("DAE observer", "plant", "observer.u", BLUE, "-"),
        ("true state", "plant_true", "plant_true.u", GREEN, "--"),
    ):
        axes[0].plot(result.time, result[f"{plant}.x.x1"], style, color=colour, label=label)
        axes[1].plot(result.time, result[f"{plant}.x.x3"], style, color=colour)
        axes[2].plot(result.time, result[control], style, color=colour, linewidth=0.9)
    axes[1].plot(result.time, result["observer.estimate.x3"], ":", color=ORANGE, label="estimate")
    for axis, label in zip(axes, ("angle $x_1$ [rad]", "field $x_3$", "$u$ [1/s]"), strict=True):
        axis.set_ylabel(label)
    axes[0].legend(frameon=False, fontsize=8)
    axes[1].legend(frameon=False, fontsize=8)
    axes[2].set_xlabel("time [s]")
    axes[2].set_xlim(0, result.time[-1])
    figure.align_ylabels(axes)
    save(figure, "closed_loop_motor")


if __name__ == "__main__":
    duffing(run("systems/closed_loop_duffing.ssp"))
    motor(run("systems/closed_loop_motor.ssp"))
