"""Makes the picture of silverbox.md from the measured record, and prints how well the observer explains it.

python docs/figures_silverbox.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from figures import BLUE, GREY, ORANGE, save
from scipy.interpolate import CubicSpline

import reference_models
from cosim.log import read_log
from cosim.replay import replay
from reference_models.silverbox import K1, K3, SAMPLE_TIME
from reference_models.silverbox_evaluation import evaluate

LOG = Path(reference_models.__file__).parent / "data" / "silverbox.csv.gz"
SHOWN = slice(6100, 6160)  # of the velocity: some periods
EVERY = 60  # of the parameters
NAMES = ("x1", "x2", "k1", "k3")


def stiffness(time: np.ndarray, filtered: np.ndarray, y: np.ndarray, name: str) -> None:
    """The estimates of velocity, k1 and k3 against a spline's derivative and the fitted values."""
    figure, (velocity, linear, cubic) = plt.subplots(3, 1, figsize=(8, 6.5), layout="constrained")
    velocity.plot(
        time[SHOWN], CubicSpline(time, y)(time[SHOWN], 1), color=BLUE, label="derivative of a spline through y"
    )
    velocity.plot(time[SHOWN], filtered[SHOWN, 1], "--", color=ORANGE, label="estimate")
    velocity.set_ylabel("$x_2$ [V/s]")
    for axis, column, fitted, label in ((linear, 2, K1, "$k_1$ [1/s$^2$]"), (cubic, 3, K3, "$k_3$ [1/(V$^2$ s$^2$)]")):
        axis.axhline(fitted, color=BLUE, label="fitted to a free run")
        axis.plot(time[::EVERY], filtered[::EVERY, column], color=ORANGE, linewidth=0.9, label="estimate")
        axis.axvspan(0, 2, color=GREY, alpha=0.1, linewidth=0)
        axis.set_ylabel(label)
        axis.set_ylim(0.6 * fitted, 1.4 * fitted)
        axis.set_xlim(0, time[-1])
    for axis in (velocity, linear, cubic):
        axis.legend(frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1, 1), fontsize=8)
    cubic.set_xlabel("time [s]")
    save(figure, name)


if __name__ == "__main__":
    log = read_log(LOG)
    u, y = log.column("u"), log.column("y")
    made = replay("fmus/silverbox_ukf.fmu", LOG, sample_time=SAMPLE_TIME)
    filtered = np.column_stack([made.result[f"observer.filtered.{v}"][1:] for v in NAMES])
    stiffness(made.result.time[:-1], filtered, y, "silverbox_ukf")
    found = evaluate(filtered, u, y)
    print(
        f"k1 {found.k1_deviation:+.2%}, k3 {found.k3_deviation:+.2%}, 20 samples ahead {found.prediction_rms * 1e3:.2f} mV"
    )
    print(f"{np.median(made.result.step_ns['observer']) / 1e3:.1f} us a sample")
