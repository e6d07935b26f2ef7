"""What there is to say of tuned noises: tables, and a page with the innovations before and after."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from bokeh.models import Range1d, Span
from bokeh.plotting import figure as new_figure

from cosim.report.axes import COLOURS, ESTIMATE, INK, axes, span_of
from cosim.report.page import Section, Table, write_report
from cosim.tuning.innovations import LAGS, Innovations, correlations
from cosim.tuning.tune import OPEN, Tuned

SAMPLES = "sample (behind the line: held back)"


def values(made: Tuned) -> Table:
    """The noises before and after, and how well each is known."""
    rows = []
    for p in made.parameters:
        said = made.deviations[p.name]
        known = f"{math.expm1(said):.0%}" if said < OPEN else "-"
        rows.append((p.name, p.unit, f"{p.start:.4g}", f"{made.values[p.name]:.4g}", known))
    return Table(("", "unit", "before", "after", "known to"), rows)


def worth(made: Tuned) -> Table:
    """What the noises are worth: the likelihood or the errors, the size of the innovations, whether they are white."""
    judged = [one for part in (made.fitted, made.held_back) for one in (part.before, part.after)]
    tested = [one for part in (made.fitted, made.held_back) for one in (part.consistent_before, part.consistent_after)]
    rows: list[tuple[str, ...]] = []
    if made.ahead:
        for name in judged[0].rms:
            rows.append((f"error of {name} {made.ahead} ahead, rms", *(f"{one.rms[name]:.4g}" for one in judged)))
    else:
        densities = (one.value / max(one.samples, 1) for one in judged)
        rows.append(("log-likelihood a measurement", *(f"{density:.4f}" for density in densities)))
    if not math.isnan(tested[0].nis):
        rows.append(("mean of NIS, 1 if consistent", *(f"{one.nis:.3f}" for one in tested)))
        rows.append(("its 95 % band", *(f"{one.band[0]:.3f} to {one.band[1]:.3f}" for one in tested)))
    rows.append(("whiteness, p-value", *(f"{one.whiteness:.2g}" for one in tested)))
    return Table(("", "fitted part before", "after", "held-back part before", "after"), rows)


def facts(made: Tuned) -> list[str]:
    """What a reader of the tables must know, a sentence each."""
    found = [f"{made.evaluations} replays of the fitted part, {made.fitted.after.samples} measurements."]
    if made.zeros:
        found.append(
            f"Noises of 0 were left at it: {', '.join(made.zeros)}; --parameters with another value tunes them."
        )
    return found


def write_tuning(path: Path, title: str, command_html: str, made: Tuned) -> None:
    """Write the page on tuned noises; `command_html` is the command that made it.

    Raises:
        OSError: the file cannot be written.
    """
    split, judged = len(made.fitted.after.innovations.nu), (made.fitted, made.held_back)
    shared, drawn = Range1d(0.0, float(split + len(made.held_back.after.innovations.nu))), []
    for i, (name, unit) in enumerate(made.outputs.items()):
        for word, found in (
            ("before", [part.before.innovations for part in judged]),
            ("after", [part.after.innovations for part in judged]),
        ):
            plot = _innovation(f"Innovation of {name}, {word}", unit, found, i, shared)
            plot.add_layout(Span(location=split, dimension="height", line_color=INK, line_dash="dotted"))
            drawn.append(plot)
        tested = (made.held_back.before, made.held_back.after)
        drawn.append(_correlation(name, *(one.innovations.series()[:, i] for one in tested)))
    warnings = [f"Warning: {warning}." for warning in made.warnings]
    sections = [
        Section("What to know", [*facts(made), *warnings]),
        Section("Innovations: measured minus predicted", [], [], drawn),
    ]
    write_report(path, title, command_html, [values(made), worth(made)], sections)


def _innovation(title: str, unit: str, parts: Sequence[Innovations], i: int, shared: Range1d) -> new_figure:
    """One output's, over all parts in a row."""
    nu = np.concatenate([part.nu[:, i] for part in parts])
    drawn = axes(title, unit, np.arange(len(nu), dtype=float), shared, along=SAMPLES)
    variances = [part.S[:, i, i] for part in parts if part.S is not None]
    if variances:
        std = np.where(np.isfinite(nu), np.sqrt(np.concatenate(variances)), np.nan)
        drawn.band(-2 * std, 2 * std, "+- 2 std", COLOURS[0])
    drawn.line(nu, "measured - predicted", COLOURS[0], step=True)
    return drawn.done()


def _correlation(name: str, before: np.ndarray, after: np.ndarray) -> new_figure:
    """Of the held-back part, with what 95 % of white series stay within."""
    lags = np.arange(1.0, LAGS + 1)
    drawn = axes(f"Correlation of the held-back innovations of {name}", "", lags, span_of(lags), along="lag in samples")
    bound = np.full(LAGS, 1.96 / math.sqrt(max(int(np.isfinite(after).sum()), 1)))
    drawn.band(-bound, bound, "95 % of white series", COLOURS[0])
    drawn.whole += [-bound, bound]
    drawn.line(_padded(correlations(before)), "before", COLOURS[0], dash="dashed")
    drawn.line(_padded(correlations(after)), "after", ESTIMATE)
    return drawn.done()


def _padded(found: np.ndarray) -> np.ndarray:
    return np.append(found, np.full(LAGS - len(found), np.nan))
