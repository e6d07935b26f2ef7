"""Makes the picture of silverbox.md from the measured record, and prints how well the observers explain it.

python docs/figures_silverbox.py
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from figures import BLUE, GREEN, GREY, ORANGE, save
from rich.console import Console
from rich.table import Table
from scipy.interpolate import CubicSpline

import reference_models
from cosim.replay.log import read_log
from cosim.replay.replay import replay
from reference_models.silverbox import K1, K3, SAMPLE_TIME
from reference_models.silverbox_evaluation import evaluate

LOG = Path(reference_models.__file__).parent / "data" / "silverbox.csv.gz"
SHOWN = slice(6100, 6160)  # of the velocity: some periods
EVERY = 60  # of the parameters
NAMES = ("x1", "x2", "k1", "k3")
# The FMUs and, where the picture shows them, their labels.
OBSERVERS = {
    "silverbox_pseudospectral": "200 samples",
    "silverbox_pseudospectral_short": "50 samples and arrival cost",
    "silverbox_ukf": "",
}


def stiffness(time: np.ndarray, filtered: Mapping[str, np.ndarray], y: np.ndarray) -> None:
    """The estimates of velocity, k1 and k3 by label, against a spline's derivative and the fitted values."""
    figure, (velocity, linear, cubic) = plt.subplots(3, 1, figsize=(8, 6.5), layout="constrained")
    velocity.plot(
        time[SHOWN], CubicSpline(time, y)(time[SHOWN], 1), color=BLUE, label="derivative of a spline through y"
    )
    for (label, found), colour in zip(filtered.items(), (ORANGE, GREEN), strict=True):
        velocity.plot(time[SHOWN], found[SHOWN, 1], "--" if colour == ORANGE else ":", color=colour, label=label)
    velocity.set_ylabel("$x_2$ [V/s]")
    for axis, column, fitted, span, label in (
        (linear, 2, K1, 0.01, "$k_1$ [1/s$^2$]"),
        (cubic, 3, K3, 0.4, "$k_3$ [1/(V$^2$ s$^2$)]"),
    ):
        for found, colour in zip(filtered.values(), (ORANGE, GREEN), strict=True):
            axis.plot(time[::EVERY], found[::EVERY, column], color=colour, linewidth=0.9)
        axis.axhline(fitted, color=BLUE, linewidth=0.9, label="fitted to a free run")
        axis.axvspan(0, 2, color=GREY, alpha=0.1, linewidth=0)
        axis.set_ylabel(label)
        axis.set_ylim((1 - span) * fitted, (1 + span) * fitted)
        axis.set_xlim(0, time[-1])
        axis.legend(frameon=False, loc="lower right", bbox_to_anchor=(1, 1), fontsize=8)
    velocity.legend(frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1, 1), fontsize=8)
    cubic.set_xlabel("time [s]")
    save(figure, "silverbox")


if __name__ == "__main__":
    log = read_log(LOG)
    u, y = log.numbers("u"), log.numbers("y")
    shown = {}
    table = Table("FMU", "k1", "k3", "20 ahead", "time a sample", "failed", "in each status")
    for fmu, label in OBSERVERS.items():
        result = replay(f"fmus/{fmu}.fmu", LOG, sample_time=SAMPLE_TIME).result
        estimates = np.column_stack([result[f"observer.filtered.{v}"][1:] for v in NAMES])
        if label:
            shown[label] = estimates
        found, status = evaluate(estimates, u, y), result["observer.diagnostics.status"].astype(int)
        items = result.items["observer.diagnostics.status"]
        table.add_row(
            fmu,
            f"{found.k1_deviation:+.2%}",
            f"{found.k3_deviation:+.2%}",
            f"{found.prediction_rms * 1e3:.2f} mV",
            f"{np.median(result.step_ns['observer']) / 1e3:.0f} us",
            str(int(result["observer.diagnostics.solver_failures"][-1])),
            ", ".join(f"{items[s]} {count}" for s, count in zip(*np.unique(status, return_counts=True), strict=True)),
        )
    stiffness(SAMPLE_TIME * np.arange(len(y)), shown, y)
    Console(width=160).print(table)
