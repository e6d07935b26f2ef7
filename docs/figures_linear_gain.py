"""Makes the pictures of james_baras.md and chen_yen.md from the built systems, and prints what they measure.

python docs/figures_linear_gain.py
"""

from __future__ import annotations

import math

import matplotlib.pyplot as plt
import numpy as np
from figures import BLUE, GREEN, GREY, ORANGE, save

from cosim.master import run
from cosim.results import Result
from observers.chen_yen import chen_yen
from observers.instance import Instance
from observers.james_baras import james_baras
from reference_models.chen_yen import CHEN_YEN
from reference_models.james_baras_5_2 import JAMES_BARAS_5_2
from reference_models.plant import plant

TIMES = (1, 2, 3, 5, 10, 20)


def error(result: Result) -> np.ndarray:
    """|e| of the current estimate."""
    states = [name.removeprefix("observer.estimate.") for name in result.names if "estimate." in name]
    return np.linalg.norm([result[f"observer.estimate.{s}"] - result[f"plant.x.{s}"] for s in states], axis=0)


def norms_of_Q(result: Result) -> tuple[float, float]:
    """The largest |Q| and |P| = |Q^-1| along a run."""
    entries = [result[name] for name in result.names if name.startswith("observer.diagnostics.Q[")]
    n = math.isqrt(len(entries))
    eigenvalues = np.linalg.eigvalsh(np.array(entries).T.reshape(-1, n, n))
    return float(eigenvalues.max()), float(1 / eigenvalues.min())


def riccati_errors(runs: dict[str, Result]) -> None:
    figure, axis = plt.subplots(figsize=(7, 3))
    for (label, result), colour in zip(runs.items(), (GREEN, BLUE, ORANGE), strict=True):
        axis.semilogy(result.time, error(result), color=colour, label=label)
    axis.set_xlabel("time [s]")
    axis.set_ylabel("|e|")
    axis.legend(frameon=False)
    save(figure, "james_baras_errors")


def riccati_order() -> None:
    """Example 5.2: the estimate at t = 1 s against the one at a sample time a hundredth as long."""

    def estimate(Ts: float) -> np.ndarray:
        design = dict(sample_time=Ts, N=math.sqrt(0.2), R=3.0, Q0=0.01, guess={"x1": 0.0, "x2": 0.0})
        observer, true = Instance(james_baras(JAMES_BARAS_5_2, **design)), Instance(plant(JAMES_BARAS_5_2))
        for k in range(round(1 / Ts)):
            observer.set("y", true.get("y"))
            for one in (observer, true):
                one.step(k * Ts, Ts)
        return np.array([observer.get("estimate.x1"), observer.get("estimate.x2")])

    fine = 2 * estimate(0.0005) - estimate(0.001)
    sample_times = np.array([0.1, 0.05, 0.02, 0.01, 0.005])
    gaps = np.array([np.linalg.norm(estimate(Ts) - fine) for Ts in sample_times])
    slope = np.polyfit(np.log(sample_times), np.log(gaps), 1)[0]
    print(f"5.2, distance to the continuous observer at t = 1 s: order {slope:.2f}, {gaps[3]:.1e} at Ts = 0.01")
    figure, axis = plt.subplots(figsize=(4.5, 3))
    axis.loglog(sample_times, gaps, "o-", color=BLUE, markersize=3)
    axis.set_xlabel("sample time [s]")
    axis.set_ylabel("distance to the continuous observer")
    save(figure, "james_baras_order")


def least_squares(short: Result, long: Result) -> None:
    figure, (above, below) = plt.subplots(2, 1, figsize=(7, 4.5), sharex=True)
    for result, label, colour in ((short, "T = 0.25 s", BLUE), (long, "T = 2 s", ORANGE)):
        above.semilogy(result.time, error(result), color=colour, label=label)
        for name, style in (("contraction", "-"), ("certified_contraction", ":")):
            values = result[f"observer.diagnostics.{name}"]
            below.step(result.time[values > 0], values[values > 0], style, where="post", color=colour, linewidth=1)
    below.axhline(1.0, color=GREY, linewidth=0.8)
    above.set_ylabel("|e|")
    above.legend(frameon=False)
    below.set_ylabel("contraction of an interval")
    below.set_xlabel("time [s]   (solid: actual, dotted: certified)")
    save(figure, "chen_yen_errors")


def needed_gain(T: float) -> float:
    """The smallest gamma p0 at which every interval of [0, 20 s] is certified to contract."""

    def worst(product: float) -> float:
        observer = Instance(chen_yen(CHEN_YEN, sample_time=0.01, T=T, gamma=product / 0.1, p0=0.1))
        found = 0.0
        for k in range(2001):
            observer.step(0.01 * k, 0.01)
            found = max(found, observer.get("diagnostics.certified_contraction"))
        return found

    low, high = 0.01, 1e5
    for _ in range(18):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if worst(middle) < 1 else (middle, high)
    return high


def noisy_rms(products: tuple[float, ...]) -> dict[float, float]:
    """rms of both states' errors from t = 10 s on with Gaussian noise of 0.1, Ts = 0.05, against gamma p0."""
    found = {}
    for product in products:
        noisy = {
            "plant.sensor.noise_std": 0.1,
            "plant.sensor.sample_time": 0.05,
            "observer.sample_time": 0.05,
            "observer.tuning.gamma": product / 0.1,
        }
        squares = []
        for seed in range(4):
            result = run("systems/chen_yen_short.ssp", step=0.05, overrides=noisy | {"plant.sensor.seed": seed})
            gaps = [result[f"observer.estimate.{s}"] - result[f"plant.x.{s}"] for s in ("x1", "x2")]
            squares.append(np.mean(np.square(gaps)[:, result.time >= 10]))
        found[product] = math.sqrt(float(np.mean(squares)))
    return found


if __name__ == "__main__":
    systems = ("james_baras_5_1", "james_baras_5_2", "james_baras_5_2_far", "chen_yen_short", "chen_yen_long")
    results = {name: run(f"systems/{name}.ssp") for name in systems}
    for name, result in results.items():
        rows = [int(np.argmin(np.abs(result.time - t))) for t in TIMES if t <= result.time[-1] + 1e-9]
        print(name, "|e| at", ", ".join(f"{result.time[row]:g}: {error(result)[row]:.3g}" for row in rows))
    for name in systems[:3]:
        print(name, "largest |Q|, |P| along the run: {:.4g}, {:.4g}".format(*norms_of_Q(results[name])))
    for name in systems[3:]:
        factors = [results[name][f"observer.diagnostics.{f}contraction"].max() for f in ("", "certified_")]
        print(name, "largest contraction, actual and certified: {:.3f}, {:.3f}".format(*factors))
    print("gamma p0 that certifies every interval:", {T: f"{needed_gain(T):.3g}" for T in (0.25, 2.0)})
    print("noise 0.1, rms error against gamma p0:", {k: f"{v:.4f}" for k, v in noisy_rms((0.5, 1, 2, 4, 8)).items()})
    labels = ("5.1", "5.2, x0 = (1, -1), m0 = 0", "5.2, x0 = (3, 2), m0 = (-3, -2)")
    riccati_errors(dict(zip(labels, (results[name] for name in systems[:3]), strict=True)))
    riccati_order()
    least_squares(results["chen_yen_short"], results["chen_yen_long"])
