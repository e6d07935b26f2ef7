"""The picture of a campaign, like Figure 7 of Gong, Ross & Kang 2007: figure.svg, for a text."""

from __future__ import annotations

import io
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cosim.campaign.campaign import Campaign
from cosim.campaign.report import Average, Errors, course, succeeded
from cosim.report.axes import COLOURS, ESTIMATE, TRUTH
from cosim.report.estimates import Pair
from cosim.whole import whole


def figure(campaign: Campaign) -> Figure:
    """One panel for each estimate, against time, over all runs that did not fail: what `course` says of it.

    Raises:
        ValueError: all runs failed.
    """
    found = [course(campaign, pair) for pair in campaign.pairs]
    time = succeeded(campaign)[0].time
    made = Figure(figsize=(8, 0.6 + 1.7 * len(found)), layout="constrained")
    panels = made.subplots(len(found), 1, sharex=True, squeeze=False)[:, 0]
    for pair, one, axis in zip(campaign.pairs, found, panels, strict=True):
        if isinstance(one, Average):
            _draw_average(axis, time, one, campaign.experiment.settle)
        else:
            _draw_errors(axis, time, one)
        axis.set_ylabel(_label(campaign, pair))
        axis.grid(color="#e5e5e5")
        axis.legend(frameon=False, ncols=3, fontsize=8, loc="upper right")
    axis.set_xlabel("time [s]")
    axis.set_xlim(time[0], time[-1])
    return made


def _draw_average(axis: Axes, time: np.ndarray, one: Average, settle: float) -> None:
    """The axis fits what comes after `settle`; the first estimates, which may be anywhere, can leave it."""
    axis.fill_between(time, one.low, one.high, color=ESTIMATE, alpha=0.25, linewidth=0, label="90 % of the runs")
    axis.plot(time, one.truth, color=TRUTH, label="true")
    axis.plot(time, one.mean, "--", color=ESTIMATE, label="average of the estimates")
    shown = time > time[0] + settle
    if shown.any():
        least, most = min(one.low[shown].min(), one.truth.min()), max(one.high[shown].max(), one.truth.max())
        axis.set_ylim(least - 0.3 * (most - least), most + 0.6 * (most - least))


def _draw_errors(axis: Axes, time: np.ndarray, one: Errors) -> None:
    axis.semilogy(time, one.most, color=COLOURS[4], linewidth=0.8, label="95 % of the runs below")
    axis.semilogy(time, one.rms, color=COLOURS[0], label="rms error over the runs")


def _label(campaign: Campaign, pair: Pair) -> str:
    unit = campaign.units[pair.truth]
    what = pair.variable if pair.truth in campaign.experiment.parameters else f"error of {pair.variable}"
    return f"{what} [{unit}]" if unit and unit != "1" else what


def svg(made: Figure) -> str:
    """`made` as SVG text, the same for the same figure."""
    text = io.StringIO()
    # Real text, and no random identifiers or dates.
    with matplotlib.rc_context({"svg.hashsalt": "campaign", "svg.fonttype": "none"}):
        made.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()


def write_picture(campaign: Campaign, path: Path) -> None:
    """Write `figure` as SVG.

    Raises:
        ValueError: all runs failed.
        OSError: the file cannot be written.
    """
    drawing = svg(figure(campaign))
    with whole(path) as partial:
        partial.write_text(drawing, encoding="utf-8")
