"""Makes the picture of Example 6 in pseudospectral.md from the built FMUs, and prints the table of starts.

python docs/figures_dae.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from figures import BLUE, GREY, ORANGE, save
from rich.console import Console
from rich.table import Table

from cosim.master import run
from cosim.master.slave import RunError
from cosim.results import Result
from cosim.system import Element, System
from observers.status import CODE, STATUS

SYSTEM = "systems/gong_example_6.ssp"
SAMPLE_TIME, FINE = 0.2, 0.01  # [s]
TRUTH = {"x1": "plant.x.x1", "x2": "plant.x.x2", "x3": "plant.z.x3"}
UNITS = {"x1": "C", "x2": "Wb", "x3": "V"}
SINGULAR = 1 + 1 / np.sqrt(3)  # 3 (x3 - 1)^2 = 1, on the upper branch [V]
# x3 and x2 at the start.
STARTS = ((2.7, 1.5), (3.0, -1.0), (0.9, 0.2), (1.2, -0.1), (-0.5, 0.8))
BRANCHES = ("upper", "upper", "middle", "middle", "lower")


def charge(voltage: float) -> float:
    """x1 of the capacitor at a voltage, (41)."""
    return (voltage - 1) ** 3 - (voltage - 1) + 1


def until_it_ends(overrides: dict[str, float], step: float) -> tuple[Result, str]:
    """The coupled run up to the singularity or 8 s, and what the plant says at its end."""
    try:
        return run(SYSTEM, overrides=overrides, stop=8.0, step=step), ""
    except RunError as error:
        return error.partial, str(error)


def alone(y: np.ndarray) -> Result:
    """The observer's FMU over samples y, with none in the last step: what it says where the plant has ended."""
    system = System("observer", {"observer": Element(Path("fmus/rlc_pseudospectral.fmu"))}, stop=len(y) * SAMPLE_TIME)
    return run(system, step=SAMPLE_TIME, inputs={"observer.y": np.append(y, np.nan)})


def starts() -> Table:
    """Each start, guessed 0.1 off in x1 and x3 and at 0 in x2: the first estimate's errors, the largest, how the run ends."""
    columns = ("x3 at the start", "branch", "first estimate: errors", "at", "largest error", "end")
    table = Table(*columns, title="Example 6, starts on all branches")
    for (voltage, flux), branch in zip(STARTS, BRANCHES, strict=True):
        guess = {"x1": charge(voltage) + 0.1, "x2": 0.0, "x3": voltage + 0.1}
        result, end = until_it_ends(
            {
                "plant.start.x1": charge(voltage),
                "plant.start.x2": flux,
                "plant.start.x3": voltage,
                **{f"observer.guess.{name}": value for name, value in guess.items()},
            },
            SAMPLE_TIME,
        )
        error = np.abs([result[f"observer.filtered.{v}"][1:] - result[path][:-1] for v, path in TRUTH.items()])
        fitted = (CODE.estimating, CODE.settling)
        estimated = np.flatnonzero(np.isin(result["observer.diagnostics.status"][1:], fitted))
        first = estimated[0]
        table.add_row(
            f"{voltage:g} V",
            branch,
            " ".join(f"{value:.1e}" for value in error[:, first]),
            f"{result.time[first]:.1f} s",
            f"{error[:, estimated].max():.1e}",
            end[end.index("rlc:") :] if end else f"{result.time[-1]:g} s, {len(estimated)} estimates",
        )
    return table


def branch_and_end() -> None:
    """Like the paper's Figure 9: the true trajectory and the samples' estimates, up to the singularity; below, the status."""
    smooth, _ = until_it_ends({}, FINE)
    coupled, _ = until_it_ends({}, SAMPLE_TIME)
    observed = alone(coupled["plant.y"])
    figure, axes = plt.subplots(4, 1, figsize=(8, 7), sharex=True, height_ratios=[2, 2, 2, 1.2], layout="constrained")
    for axis, (v, path) in zip(axes, TRUTH.items(), strict=False):
        axis.plot(smooth.time, smooth[path], color=BLUE, label="true")
        at = observed.time[1:-1] - SAMPLE_TIME
        axis.plot(at, observed[f"observer.filtered.{v}"][1:-1], "*", color=ORANGE, label="estimate")
        axis.set_ylabel(f"$x_{v[1]}$ [{UNITS[v]}]")
    axes[0].legend(frameon=False, loc="lower left", ncols=2)
    axes[2].axhline(SINGULAR, color=GREY, linestyle=":", linewidth=0.9)
    axes[2].text(0.05, SINGULAR + 0.03, "singularity, $3 (x_3 - 1)^2 = 1$", color=GREY, fontsize=8)
    status = observed["observer.diagnostics.status"].astype(int)
    present = sorted(set(status))
    axes[3].step(observed.time, [present.index(s) for s in status], "o-", where="post", color=GREY, markersize=3)
    axes[3].set_yticks(range(len(present)), [STATUS.items[s - 1][0] for s in present], fontsize=7)
    for axis in axes:
        axis.axvline(smooth.time[-1], color=GREY, linestyle=":", linewidth=0.9)
    axes[3].set_xlabel("time [s]")
    figure.align_ylabels(axes[:3])
    save(figure, "gong_example_6")


if __name__ == "__main__":
    branch_and_end()
    Console(width=160).print(starts())
