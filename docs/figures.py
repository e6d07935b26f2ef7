"""Makes the pictures of README and docs from runs of the built systems: python docs/figures.py"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

sys.path.append(str(Path(__file__).parents[1]))  # for demo.py, which is no part of the package

from cosim.master import run
from cosim.results import Result
from demo import errors
from observers.instance import Instance
from observers.pseudospectral import pseudospectral
from observers.status import STATUS
from reference_models.duffing import DUFFING
from reference_models.plant import plant

ESTIMATED = ("x1", "x2", "theta")
IMAGES = Path(__file__).parent / "images"
BLUE, ORANGE, GREEN, GREY = "#0072b2", "#d55e00", "#009e73", "#555555"
LABELS = {"x1": "$x_1$ [m]", "x2": "$x_2$ [m/s]", "theta": r"$\theta$ [m/s$^2$]"}

plt.rcParams.update(
    {
        "svg.hashsalt": "observer-fmus",
        "font.size": 9,
        "axes.grid": True,
        "grid.color": "#e5e5e5",
        "axes.edgecolor": GREY,
    }
)


def save(figure: plt.Figure, name: str) -> None:
    IMAGES.mkdir(exist_ok=True)
    figure.savefig(IMAGES / f"{name}.svg", bbox_inches="tight", metadata={"Date": None})
    plt.close(figure)


def jumping_theta(result: Result) -> None:
    """Example 2: states, theta and error of the current estimate, status."""
    figure, axes = plt.subplots(5, 1, figsize=(8, 7.5), sharex=True, height_ratios=[2, 2, 2, 2, 1.2])
    for axis, v in zip(axes, ESTIMATED, strict=False):
        axis.plot(result.time, result[f"plant.x.{v}"], color=BLUE, label="true, in the plant's FMU")
        axis.plot(
            result.time, result[f"observer.estimate.{v}"], "--", color=ORANGE, label="estimate, from the observer's FMU"
        )
        axis.set_ylabel(LABELS[v])
    axes[0].legend(ncols=2, loc="lower right", bbox_to_anchor=(1, 1), frameon=False)
    axes[2].set_ylim(-1.4, 1.0)
    for v, colour in zip(ESTIMATED, (BLUE, ORANGE, GREEN), strict=True):
        gap = np.abs(result[f"observer.estimate.{v}"] - result[f"plant.x.{v}"])
        axes[3].semilogy(result.time, np.maximum(gap, 1e-17), color=colour, label=LABELS[v].split(" ")[0])
    axes[3].set_ylabel("error")
    axes[3].legend(ncols=3, frameon=False, loc="upper right", fontsize=8)
    status = result["observer.diagnostics.status"].astype(int)
    present = sorted(set(status))
    axes[4].step(result.time, [present.index(s) for s in status], where="post", color=GREY)
    axes[4].set_yticks(range(len(present)), [STATUS.items[s - 1][0] for s in present], fontsize=7)
    axes[4].set_xlabel("time [s]")
    axes[4].set_xlim(result.time[0], result.time[-1])
    figure.align_ylabels(axes[:4])
    save(figure, "gong_example_2")


def two_costs(sampled: Result, spline: Result) -> None:
    """Example 1: the error at the sample instants with the sampled cost and with the paper's spline."""
    figure, axes = plt.subplots(1, 2, figsize=(8, 3), sharey=True)
    for axis, result, title in zip(
        axes, (sampled, spline), ("cost at the samples", "the paper's spline cost"), strict=True
    ):
        found = np.maximum(errors(result), 1e-17)
        for i, (v, colour) in enumerate(zip(ESTIMATED, (BLUE, ORANGE, GREEN), strict=True)):
            axis.semilogy(result.time[:-1], found[:, i], color=colour, label=LABELS[v].split(" ")[0], linewidth=0.9)
        axis.axhline(1e-4, color=GREY, linewidth=0.8, linestyle=":")
        axis.set_title(title, fontsize=9)
        axis.set_xlabel("time [s]")
    axes[0].text(50, 1.5e-4, "the paper's claim for the states", fontsize=7, ha="right", color=GREY)
    axes[0].set_ylabel("|filtered - true|")
    axes[0].legend(frameon=False, ncols=3, fontsize=8)
    save(figure, "gong_example_1_costs")


def spectral(orders: range) -> None:
    """The largest error over 10 s of Example 1 (L = 8, Ts = 0.1) against N."""
    true = Instance(plant(DUFFING))
    y, x = [], []
    for k in range(100):
        y.append(true.get("y"))
        x.append([true.get(f"x.{v}") for v in ESTIMATED])
        true.step(0.1 * k, 0.1)
    largest = []
    for order in orders:
        observer = Instance(pseudospectral(DUFFING, sample_time=0.1, N=order, L=8), {"guess.theta": 0.1})
        gaps = []
        for k in range(100):
            observer.set("y", y[k])
            observer.step(0.1 * k, 0.1)
            gaps.append(np.abs([observer.get(f"filtered.{v}") for v in ESTIMATED] - np.array(x[k])))
        largest.append(np.array(gaps)[20:].max(axis=0))
    figure, axis = plt.subplots(figsize=(5, 3))
    for i, (v, colour) in enumerate(zip(ESTIMATED, (BLUE, ORANGE, GREEN), strict=True)):
        axis.semilogy(
            list(orders), np.array(largest)[:, i], "o-", color=colour, label=LABELS[v].split(" ")[0], markersize=3
        )
    axis.set_xlabel("order N")
    axis.set_ylabel("largest error, t = 2 to 10 s")
    axis.legend(frameon=False)
    save(figure, "spectral_convergence")


if __name__ == "__main__":
    jumping_theta(run("systems/gong_example_2.ssp"))
    two_costs(run("systems/gong_example_1.ssp"), run("systems/gong_example_1_spline.ssp"))
    spectral(range(4, 21, 2))
