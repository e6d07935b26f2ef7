"""What a campaign shows: a summary of all runs, how the estimates and their errors lie over the runs, and a page of both."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import NamedTuple

import numpy as np
from bokeh.models import Range1d
from bokeh.plotting import figure as new_figure

from cosim.campaign.campaign import TABLE, Campaign
from cosim.campaign.run import Outcome
from cosim.report.axes import COLOURS, ESTIMATE, TALL, TRUTH, axes, positive, span_of
from cosim.report.estimates import Pair
from cosim.report.page import Section, Table, write_report

SHOWN_FAILURES = 20
NINETY, MOST = (0.05, 0.95), 0.95  # quantiles over the runs


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


class Average(NamedTuple):
    """A true parameter over the runs, (m,): the averages of the truth and of the estimates, and between what 90 % of these lie."""

    truth: np.ndarray
    mean: np.ndarray
    low: np.ndarray
    high: np.ndarray


class Errors(NamedTuple):
    """The errors of a state over the runs, (m,): their rms, and what half of them and 95 % of them stay below."""

    rms: np.ndarray
    half: np.ndarray
    most: np.ndarray


def course(campaign: Campaign, pair: Pair) -> Average | Errors:
    """What all runs that did not fail make of an estimate: of a state, whose true trajectory is another in every run, the errors.

    Raises:
        ValueError: all runs failed.
    """
    done, i = succeeded(campaign), campaign.pairs.index(pair)
    if not done:
        raise ValueError(f"campaign of '{campaign.system}': all runs failed, there is nothing to draw")
    truth = np.array([outcome.truths[:, i] for outcome in done])
    estimate = np.array([outcome.estimates[:, i] for outcome in done])
    if pair.truth in campaign.experiment.parameters:
        return Average(truth.mean(axis=0), estimate.mean(axis=0), *np.quantile(estimate, NINETY, axis=0))
    error = np.abs(estimate - truth)
    return Errors(np.sqrt(np.mean(error**2, axis=0)), *np.quantile(error, (0.5, MOST), axis=0))


def _drawn(campaign: Campaign, pair: Pair, shared: Range1d) -> new_figure:
    time, found = succeeded(campaign)[0].time, course(campaign, pair)
    unit = campaign.units[pair.truth]
    if isinstance(found, Average):
        drawn = axes(pair.estimate, unit, time, shared, height=TALL)
        drawn.band(found.low, found.high, "90 % of the runs", ESTIMATE)
        drawn.line(found.truth, "true", TRUTH)
        drawn.line(found.mean, "average of the estimates", ESTIMATE, dash="dashed")
        return drawn.done()
    drawn = axes(f"Error of {pair.estimate}", unit, time, shared, log=True, height=TALL)
    for values, label, colour in (
        (found.most, "95 % of the runs below", COLOURS[4]),
        (found.half, "half of the runs below", COLOURS[2]),
        (found.rms, "rms over the runs", COLOURS[0]),
    ):
        drawn.line(positive(values), label, colour)
    return drawn.done()


def _statuses(campaign: Campaign) -> list[Table]:
    """How often each status held, in words, over all runs."""
    found: dict[str, dict[str, int]] = {}
    for outcome in succeeded(campaign):
        for name, number in outcome.numbers.items():
            column, _, word = name.rpartition(".")
            if column.endswith(".status") and number:
                held = found.setdefault(column, {})
                held[word] = held.get(word, 0) + int(number)
    return [
        Table((column, "of the points"), [(word, f"{n / sum(held.values()):.2%}") for word, n in held.items()])
        for column, held in found.items()
    ]


def _failures(campaign: Campaign) -> Section:
    failures = [outcome for outcome in campaign.outcomes if outcome.failure]
    more = len(failures) - SHOWN_FAILURES
    shown = [(str(outcome.run), outcome.failure) for outcome in failures[:SHOWN_FAILURES]]
    return Section(
        "Runs that failed", [f"{more} more are in {TABLE}."] if more > 0 else [], [Table(("run", "reason"), shown)]
    )


def write_campaign_report(campaign: Campaign, path: Path, command_html: str = "") -> None:
    """Write the page on a campaign; `command_html` is the command that made it.

    Raises:
        OSError: the file cannot be written.
    """
    done = succeeded(campaign)
    found = ", ".join(f"{number} {label}" for label, number in counts(campaign).items())
    intro = f"{command_html}<p>{escape(found)}. All numbers: {TABLE}.</p>"
    tables, sections = [], []
    if done:
        varied = ", ".join(done[0].values) or "nothing"
        intro += f"<p>Varied: {escape(varied)}. {escape(settled_means(campaign))}</p>"
        tables = [summary(campaign)]
        shared = span_of(done[0].time)
        drawn = [_drawn(campaign, pair, shared) for pair in campaign.pairs]
        sections = [Section("Over all runs", [], _statuses(campaign), drawn)]
    if len(done) < len(campaign.outcomes):
        sections.insert(0, _failures(campaign))
    write_report(path, f"Campaign {campaign.system}", intro, tables, sections)
