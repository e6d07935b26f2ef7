"""What a campaign shows: a summary of all runs, a figure like Figure 7 of Gong, Ross & Kang 2007, and a report of both."""

from __future__ import annotations

import io
from html import escape
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cosim.campaign.campaign import TABLE, Campaign
from cosim.campaign.run import Outcome
from cosim.report.estimates import Pair
from cosim.report.figures import COLOURS, ESTIMATE, TRUTH
from cosim.report.page import Table, html_table, write_page
from cosim.whole import whole

FIGURE = "figure.svg"
SHOWN_FAILURES = 20


def succeeded(campaign: Campaign) -> list[Outcome]:
    """The outcomes of the runs that did not fail."""
    return [outcome for outcome in campaign.outcomes if not outcome.failure]


def summary(campaign: Campaign) -> Table:
    """For each estimate the errors over all runs that did not fail: rms, largest, rms where settled, and that of the worst run."""
    columns = ("estimate", "unit", "rms", "largest", "settled", "worst", "run")
    done, rows = succeeded(campaign), []
    for pair in campaign.pairs if done else ():
        label = f"({pair.estimate} - {pair.truth})"
        rms, largest, settled = (
            np.array([outcome.numbers[f"{what}{label}"] for outcome in done])
            for what in ("rms", "largest", "settled_rms")
        )
        numbers = (np.sqrt(np.mean(rms**2)), np.max(largest), np.sqrt(np.mean(settled**2)), np.max(settled))
        worst = done[int(np.argmax(settled))].run
        rows.append((pair.estimate, campaign.units[pair.truth], *(f"{n:.2e}" for n in numbers), str(worst)))
    return Table(columns, rows)


def settled_means(campaign: Campaign) -> str:
    """What the columns of `summary` mean."""
    return (
        "Errors of the current estimate over all runs: rms, largest, and rms of the settled points, which lie more than "
        f"{campaign.experiment.settle:g} s after the start and after each jump of a parameter; worst: that of the run with the "
        "largest."
    )


def counts(campaign: Campaign) -> dict[str, int]:
    """Over all runs: how many there are and failed, solver failures and rejected samples, communication points not finite."""
    done = succeeded(campaign)
    found = {"runs": len(campaign.outcomes), "failed runs": len(campaign.outcomes) - len(done)}
    for label, last in (
        ("solver failures", "diagnostics.solver_failures"),
        ("rejected samples", "diagnostics.rejected_samples"),
        ("points with a non-finite output", "non_finite"),
    ):
        found[label] = sum(int(n) for outcome in done for name, n in outcome.numbers.items() if name.endswith(last))
    return found


def figure(campaign: Campaign) -> Figure:
    """One panel for each estimate, against time, over all runs that did not fail.

    Of a true parameter the average of the estimates and the truth, with the band that holds 90 % of the estimates; of a state,
    whose true trajectory is another in every run, the rms error and the error that 95 % of the runs stay below.

    Raises:
        ValueError: all runs failed.
    """
    done = succeeded(campaign)
    if not done:
        raise ValueError(f"campaign of '{campaign.system}': all runs failed, there is nothing to draw")
    count = len(campaign.pairs)
    made = Figure(figsize=(8, 0.6 + 1.7 * count), layout="constrained")
    axes = made.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    for i, (pair, axis) in enumerate(zip(campaign.pairs, axes, strict=True)):
        truth = np.array([outcome.truths[:, i] for outcome in done])
        estimate = np.array([outcome.estimates[:, i] for outcome in done])
        if pair.truth in campaign.experiment.parameters:
            _draw_average(axis, done[0].time, truth, estimate, campaign.experiment.settle)
        else:
            _draw_error(axis, done[0].time, np.abs(estimate - truth))
        axis.set_ylabel(_label(campaign, pair))
        axis.grid(color="#e5e5e5")
        axis.legend(frameon=False, ncols=3, fontsize=8, loc="upper right")
    axis.set_xlabel("time [s]")
    axis.set_xlim(done[0].time[0], done[0].time[-1])
    return made


def _draw_average(axis: Axes, time: np.ndarray, truth: np.ndarray, estimate: np.ndarray, settle: float) -> None:
    """The axis fits what comes after `settle`; the first estimates, which may be anywhere, can leave it."""
    low, high = np.quantile(estimate, (0.05, 0.95), axis=0)
    axis.fill_between(time, low, high, color=ESTIMATE, alpha=0.25, linewidth=0, label="90 % of the runs")
    axis.plot(time, truth.mean(axis=0), color=TRUTH, label="true")
    axis.plot(time, estimate.mean(axis=0), "--", color=ESTIMATE, label="average of the estimates")
    shown = time > time[0] + settle
    if shown.any():
        least, most = min(low[shown].min(), truth.min()), max(high[shown].max(), truth.max())
        axis.set_ylim(least - 0.3 * (most - least), most + 0.6 * (most - least))


def _draw_error(axis: Axes, time: np.ndarray, error: np.ndarray) -> None:
    axis.semilogy(
        time, np.quantile(error, 0.95, axis=0), color=COLOURS[4], linewidth=0.8, label="95 % of the runs below"
    )
    axis.semilogy(time, np.sqrt(np.mean(error**2, axis=0)), color=COLOURS[0], label="rms error over the runs")


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


def write_campaign_report(campaign: Campaign, out: Path) -> None:
    """Write `report.html` and, unless all runs failed, `figure.svg` into `out`.

    Raises:
        OSError: `out` cannot be written.
    """
    found = ", ".join(f"{number} {label}" for label, number in counts(campaign).items())
    parts = [f"<h1>{escape(campaign.system)}</h1>", f"<p>{escape(found)}. All numbers: {TABLE}.</p>"]
    done = succeeded(campaign)
    if done:
        varied = ", ".join(done[0].values) or "nothing"
        parts += [f"<p>Varied: {escape(varied)}. {settled_means(campaign)}</p>", html_table(summary(campaign))]
        drawing = svg(figure(campaign))
        with whole(out / FIGURE) as partial:
            partial.write_text(drawing, encoding="utf-8")
        parts.append(drawing[drawing.index("<svg") :])
    failures = [outcome for outcome in campaign.outcomes if outcome.failure]
    if failures:
        shown = [(str(outcome.run), outcome.failure) for outcome in failures[:SHOWN_FAILURES]]
        parts += ["<h2>Runs that failed</h2>", html_table(Table(("run", "reason"), shown))]
        if len(failures) > len(shown):
            parts.append(f"<p>{len(failures) - len(shown)} more are in {TABLE}.</p>")
    write_page(out / "report.html", f"Campaign {campaign.system}", parts)
