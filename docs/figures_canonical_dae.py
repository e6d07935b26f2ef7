"""Makes the pictures of docs/canonical_dae.md from runs of the built systems: python docs/figures_canonical_dae.py"""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from figures import BLUE, GREEN, GREY, ORANGE, save
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import place_poles

from cosim.master import run
from cosim.results import Result
from observers.canonical_dae import canonical_dae
from observers.canonical_dae.fault_detector import DETECTED
from observers.component import Component
from observers.instance import Instance
from reference_models.chua import CHUA
from reference_models.double_integrator import DOUBLE_INTEGRATOR
from reference_models.nikoukhah_1995 import CHUA_POLES

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


def linear_error(sizes: tuple[float, ...]) -> None:
    """Example 2.2: errors of x3 over their size at the start, the linear equation's, and those of the usual explicit observer."""
    alpha, beta, _, linear = (p.start for p in CHUA.parameters)
    A = np.array([[-alpha * linear, alpha, 0], [1, -1, 1], [0, -beta, 0]])
    J = place_poles(A.T, np.eye(3)[:, :1], CHUA_POLES).gain_matrix.T
    figure, axes = plt.subplots(1, 2, figsize=(8, 3), sharey=True)
    for size, colour in zip(sizes, (BLUE, ORANGE, GREEN), strict=True):
        guess = {"observer.guess.x1": max(size, 1), "observer.guess.x2": 0.0, "observer.guess.x3": size}
        result = run("systems/nikoukhah_example_2_2.ssp", overrides=guess, stop=6.0)
        gap = result["observer.filtered.x3"][1:] - result["plant.x.x3"][:-1]
        width = 3 if size == sizes[0] else 1
        axes[0].plot(result.time[:-1], gap / size, color=colour, label=f"{size:g}", linewidth=width)
        time, gap = _explicit(A, J, size)
        axes[1].plot(time, gap / size, color=colour, linewidth=width)
    times = result.time[:-1]
    exact = [(expm((A - J @ np.eye(3)[:1]) * t) @ [0, 0, 1])[2] for t in times]
    for axis, title in zip(axes, ("canonical DAE observer", "explicit observer of the same poles"), strict=True):
        axis.plot(times, exact, ":", color=GREY, label="linear equation")
        axis.set_title(title, fontsize=9)
        axis.set_xlabel("time [s]")
    axes[0].set_ylabel("error of $x_3$ over its size")
    axes[0].legend(frameon=False, fontsize=8, title="error at the start", title_fontsize=8)
    axes[0].set_ylim(-0.2, 1.2)
    save(figure, "canonical_dae_linear_error")


def _explicit(A: np.ndarray, J: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """(t, error of x3) of x^' = f(x^) + J(x^) (y - x1^) with A - J(x^) C of the same poles at every x^, up to where it escapes."""
    alpha, _, cubic, _ = (p.start for p in CHUA.parameters)

    def rates(t: float, z: np.ndarray) -> np.ndarray:
        x, e = z[:3], z[3:]
        bent, also = ([alpha * cubic * v[0] ** 3, 0, 0] for v in (x, e))
        gain = J[:, 0] - [3 * alpha * cubic * e[0] ** 2, 0, 0]
        return np.concatenate([A @ x - bent, A @ e - also + gain * (x[0] - e[0])])

    def escaped(t: float, z: np.ndarray) -> float:
        return 10 * max(size, 1) - float(np.abs(z[3:]).max())

    escaped.terminal = True  # type: ignore[attr-defined]
    start = [0.1, 0, 0, 0.1, 0, size]
    found = solve_ivp(rates, (0, 6), start, "LSODA", rtol=1e-8, atol=1e-10, events=escaped)
    return found.t, found.y[5] - found.y[2]


def noise(pole: float = -10.0, Ts: float = 0.01) -> None:
    """(2.61) to (2.66): how noise of one frequency reaches the velocity in the report's four observers, and in ours as measured."""
    figure, axis = plt.subplots(figsize=(8, 3))
    g1, g2, s = -2 * pole, pole**2, 1j * np.geomspace(1, np.pi / Ts, 200)
    lines = {
        "derivative (2.65)": s,
        "reduced-order (2.62)": -pole * s / (s - pole),
        "full-order (2.61), canonical (2.66)": g2 * s / (s**2 + g1 * s + g2),
    }
    for (label, response), colour in zip(lines.items(), (GREY, ORANGE, BLUE), strict=True):
        axis.loglog(s.imag, np.abs(response), color=colour, label=label, linewidth=1)
    parts = np.geomspace(0.005, 0.49, 14)
    for degree, mark in ((3, "."), (9, "x")):
        observer = canonical_dae(DOUBLE_INTEGRATOR, sample_time=Ts, poles=(pole, pole), degree=degree)
        found = [abs(_response(observer, 2 * np.pi * part / Ts, Ts)) for part in parts]
        axis.loglog(2 * np.pi * parts / Ts, found, mark, color=GREEN, label=f"measured, degree {degree}")
    axis.set_xlabel("frequency of the noise [rad/s]")
    axis.set_ylabel("velocity's error over the noise [1/s]")
    axis.legend(frameon=False, fontsize=8)
    save(figure, "canonical_dae_noise")


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
    linear_error((0.01, 1.0, 100.0))
    noise()
