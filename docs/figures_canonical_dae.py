"""Makes the pictures of docs/canonical_dae.md from runs of the built systems: python docs/figures_canonical_dae.py"""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from figures import BLUE, GREEN, GREY, ORANGE, save

from cosim.master import run
from cosim.results import Result
from observers.canonical_dae import canonical_dae
from observers.canonical_dae.fault_detector import DETECTED
from observers.component import Component
from observers.instance import Instance
from reference_models.double_integrator import DOUBLE_INTEGRATOR

NOISE = {f"plant.sensor.noise_std.{y}": 1e-3 for y in ("y1", "y2")} | {"plant.sensor.sample_time": 1e-3}


def motor(runs: dict[str, Result]) -> None:
    """Figures 3 and 4 of the report: x3 and its estimates, their errors, lambda."""
    figure, axes = plt.subplots(3, 1, figsize=(8, 6), sharex=True)
    colours = (ORANGE, GREEN, GREY)
    first = next(iter(runs.values()))
    axes[0].plot(first.time, first["plant.x.x3"], color=BLUE, label="true")
    for (label, result), colour in zip(runs.items(), colours, strict=True):
        axes[0].plot(result.time, result["observer.estimate.x3"], "--", color=colour, label=label)
        gap = np.abs(result["observer.estimate.x3"] - result["plant.x.x3"])
        axes[1].semilogy(result.time, np.maximum(gap, 1e-12), color=colour, linewidth=0.9)
    axes[0].set_ylabel("$x_3$")
    axes[0].legend(frameon=False, fontsize=8)
    axes[1].set_ylabel("error of $x_3$")
    for i, style in ((1, "-"), (2, "--")):
        axes[2].plot(
            first.time, first[f"observer.diagnostics.lambda[{i}]"], style, color=ORANGE, label=rf"$\lambda_{i}$"
        )
    axes[2].set_ylabel(r"$\lambda$, exact placement")
    axes[2].legend(frameon=False, fontsize=8)
    axes[2].set_xlabel("time [s]")
    axes[2].set_xlim(0, first.time[-1])
    figure.align_ylabels(axes)
    save(figure, "canonical_dae_motor")


def faults(actuator: Result, sensor: Result) -> None:
    """lambda and the detector for a fault of the actuator and a bias of the sensor, from t = 4 on, with noise."""
    figure, axes = plt.subplots(1, 2, figsize=(8, 2.8), sharex=True)
    titles = ("actuator: +2 on $x_3'$", "sensor: +0.1 on $y_2$")
    for axis, result, title in zip(axes, (actuator, sensor), titles, strict=True):
        rows = (result.time >= 3.9) & (result.time <= 4.4)
        time = result.time[rows]
        for i, colour in ((1, BLUE), (2, ORANGE)):
            axis.plot(
                time,
                result[f"observer.diagnostics.lambda[{i}]"][rows],
                color=colour,
                label=rf"$\lambda_{i}$",
                linewidth=0.9,
            )
        detected = time[result["observer.diagnostics.fault"][rows] == DETECTED][0]
        axis.axvline(detected, color=GREY, linestyle=":", linewidth=0.9)
        axis.annotate(f" detected after {1e3 * (detected - 4):.0f} ms", (detected, axis.get_ylim()[0]), fontsize=8)
        axis.set_title(title, fontsize=9)
        axis.set_xlabel("time [s]")
        axis.legend(frameon=False, fontsize=8)
    axes[0].set_ylabel(r"$\lambda$")
    save(figure, "canonical_dae_faults")


def response(degrees: tuple[int, ...], pole: float = -10.0, Ts: float = 0.01) -> None:
    """Example 2.3: how far the response from y to the velocity is from (2.66), for polynomials of several degrees between samples."""
    figure, axis = plt.subplots(figsize=(8, 3))
    parts = np.geomspace(0.01, 0.1, 12)
    for degree, colour in zip(degrees, (BLUE, ORANGE, GREEN, GREY), strict=True):
        observer = canonical_dae(DOUBLE_INTEGRATOR, sample_time=Ts, poles=(pole, pole), degree=degree)
        errors = []
        for part in parts:
            omega, s = 2 * np.pi * part / Ts, 2j * np.pi * part / Ts
            errors.append(abs(_response(observer, omega, Ts) - pole**2 * s / (s - pole) ** 2))
        axis.loglog(parts, errors, ".-", color=colour, label=f"degree {degree}", linewidth=0.9)
    axis.axhline(1e-4, color=GREY, linestyle=":", linewidth=0.9)
    axis.set_xlabel("frequency over sampling frequency")
    axis.set_ylabel("error of the response")
    axis.legend(frameon=False, fontsize=8)
    save(figure, "canonical_dae_response")


def _response(observer: Component, omega: float, Ts: float) -> complex:
    """Amplitude and phase of filtered.x2 for y = sin(omega t), once the transient is over."""
    instance, times = Instance(observer, {"guess.x2": 0.0}), Ts * np.arange(900)
    found = np.empty(len(times))
    for k, t in enumerate(times):
        instance.set("y", np.sin(omega * t))
        instance.step(t, Ts)
        found[k] = instance.get("filtered.x2")
    late = times > 4
    basis = np.column_stack([np.sin(omega * times[late]), np.cos(omega * times[late])])
    return complex(*np.linalg.lstsq(basis, found[late], rcond=None)[0])


def _fault(name: str, value: float) -> Result:
    onset = {f"plant.parameter.{name}_jump_time[1]": 4.0, f"plant.parameter.{name}_jump_value[1]": value}
    return run("systems/nikoukhah_motor.ssp", overrides=NOISE | onset)


if __name__ == "__main__":
    motor(
        {
            "exact placement": run("systems/nikoukhah_motor.ssp"),
            "regional placement": run("systems/nikoukhah_motor_regional.ssp"),
            "exact placement, BDF of order 2": run("systems/nikoukhah_motor_bdf.ssp"),
        }
    )
    faults(_fault("actuator_fault", 2.0), _fault("bias_y2", 0.1))
    response((3, 5, 7, 9))
