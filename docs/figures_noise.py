"""Makes the picture of Example 4 in pseudospectral.md from the built systems, and prints the table over ten seeds.

python docs/figures_noise.py
"""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from figures import BLUE, GREY, ORANGE, save
from rich.console import Console
from rich.table import Table

from cosim.master import run
from cosim.results import Result

SEEDS = range(10)
SHOWN = 5  # the seed of the picture: a plain estimate neither of the best nor of the worst, no bound that is wrong
LATE = 15.0  # [s]: from here on the errors count


def clean(result: Result, group: str) -> np.ndarray:
    """h(x) = x1 + x2 / 2 of `observer.filtered`, `plant.x`, ...: an output without its noise [m]."""
    return result[f"{group}.x1"] + 0.5 * result[f"{group}.x2"]


def output_error(result: Result) -> np.ndarray:
    """Estimated minus true clean output at the sample instants (n - 1,) [m]: row k + 1 filters the sample of row k."""
    return clean(result, "observer.filtered")[1:] - clean(result, "plant.x")[:-1]


def late_rms(result: Result) -> float:
    """rms of the output error from LATE on [m]."""
    return float(np.sqrt(np.mean(output_error(result)[result.time[:-1] >= LATE] ** 2)))


def wrong_bounds(result: Result) -> tuple[int, float]:
    """How many bounds exclude the true output of their sample, and by how much at most [m]."""
    true = clean(result, "plant.x")[:-1]
    outside = np.maximum(
        result["observer.diagnostics.lower"][1:] - true, true - result["observer.diagnostics.upper"][1:]
    )
    return int(np.sum(outside > 0)), float(max(outside.max(), 0.0))


def milliseconds(result: Result) -> str:
    """Median time of a sample, called from Python."""
    return f"{np.median(result.step_ns['observer']) / 1e6:.2f} ms"


def seeds() -> Table:
    """Plain and tube, seed by seed."""
    columns = (
        "seed",
        "plain",
        "failed",
        "tube",
        "failed",
        "refined",
        "y +- b",
        "wrong bounds",
        "plain, time",
        "tube, time",
    )
    table = Table(*columns, title="Example 4: rms output error after 15 s, in m; noise 0.577 rms")
    rms = []
    for seed in SEEDS:
        plain, tube = (
            run(f"systems/gong_example_4_{which}.ssp", overrides={"plant.sensor.seed": seed})
            for which in ("plain", "tube")
        )
        rms.append((late_rms(plain), late_rms(tube)))
        count, most = wrong_bounds(tube)
        last = {
            name: int(tube[f"observer.diagnostics.{name}"][-1])
            for name in ("solver_failures", "refined_bounds", "bound_fallbacks")
        }
        table.add_row(
            str(seed),
            f"{rms[-1][0]:.3f}",
            str(int(plain["observer.diagnostics.solver_failures"][-1])),
            f"{rms[-1][1]:.3f}",
            str(last["solver_failures"]),
            str(last["refined_bounds"]),
            str(last["bound_fallbacks"]),
            f"{count}, by at most {most:.3f}" if count else "0",
            milliseconds(plain),
            milliseconds(tube),
        )
    median = np.median(rms, axis=0)
    table.add_row("median", f"{median[0]:.3f}", "", f"{median[1]:.3f}", style="bold")
    return table


def noise_and_error(plain: Result, tube: Result) -> None:
    """The paper's Figures 4 and 6 on one scale: noise, its bound, output error; below, the tube of each sample, around its true output."""
    figure, axes = plt.subplots(3, 1, figsize=(8, 7), layout="constrained")
    for axis, result, title in zip(
        axes, (plain, tube), ("plain (Figure 4)", "tube and Problem 3 (Figure 6)"), strict=False
    ):
        time, error = result.time[:-1], output_error(result)
        noise = result["plant.y"][:-1] - clean(result, "plant.x")[:-1]
        axis.axhspan(-1, 1, color=GREY, alpha=0.08, linewidth=0)
        axis.plot(time, noise, ".", color=GREY, markersize=2, label="noise of the samples")
        axis.plot(
            time, error, color=ORANGE, label=f"error of the output, {title}; rms after 15 s: {late_rms(result):.3f} m"
        )
        axis.axvline(LATE, color=GREY, linewidth=0.8, linestyle=":")
        axis.set_ylim(-1.7, 1.3)
        axis.set_xlim(0, time[-1])
        axis.set_ylabel("[m]")
        axis.legend(frameon=False, loc="lower right", ncols=2, fontsize=8)
    time, true = tube.time[:-1], clean(tube, "plant.x")[:-1]
    lower, upper = (tube[f"observer.diagnostics.{side}"][1:] - true for side in ("lower", "upper"))
    axes[2].fill_between(
        time,
        lower,
        upper,
        step="mid",
        color=BLUE,
        alpha=0.3,
        linewidth=0,
        label=r"$\sigma_1$ to $\sigma_2$, minus the true output",
    )
    axes[2].plot(time, output_error(tube), color=ORANGE, label="error of the output")
    axes[2].set_xlim(0, time[-1])
    axes[2].set_ylim(-0.6, 0.6)
    axes[2].set_ylabel("[m]")
    axes[2].set_xlabel("time [s]")
    axes[2].legend(frameon=False, loc="lower right", ncols=2, fontsize=8)
    save(figure, "gong_example_4")


if __name__ == "__main__":
    noise_and_error(
        *(run(f"systems/gong_example_4_{w}.ssp", overrides={"plant.sensor.seed": SHOWN}) for w in ("plain", "tube"))
    )
    Console(width=130).print(seeds())
