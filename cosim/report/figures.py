"""The figures on one run: estimates and truth, measured and predicted, errors, the observer's diagnostics, the time that steps take."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from bokeh.models import FixedTicker, Range1d
from bokeh.plotting import figure as new_figure

from cosim.report.axes import COLOURS, ESTIMATE, MOST, TALL, TRUTH, axes, colours, in_unit, positive, span_of
from cosim.report.estimates import Pair, pairs
from cosim.report.observed import Measurement, deviation_of, known_inputs, measurements
from cosim.results import Result


def figures(result: Result) -> list[new_figure]:
    """The figures that the columns of `result` allow, in the order of reading; their time axes move together."""
    shared = span_of(result.time)
    found = pairs(result)
    estimates = [name for name in result.names if ".estimate." in name]
    truths = {pair.estimate: pair.truth for pair in found}
    made = [_estimate(result, name, truths.get(name), shared) for name in estimates]
    if found:
        made += [_errors(result, found, shared)]
    for one in measurements(result):
        made += [_measured(result, one, shared), _innovation(result, one, shared)]
    made += _grouped(result, known_inputs(result), "Known inputs", shared)
    if not estimates:
        made += _outputs(result, shared)
    made += [
        _status(result, name, shared) for name in result.names if name.endswith(".status") and name in result.items
    ]
    for last, title, log in (
        (".cost", "Cost of the estimate", True),
        (".iterations", "Iterations of the solver", False),
    ):
        curves = {n: result[n] for n in result.names if n.endswith(f".diagnostics{last}")}
        if curves:
            made += _grouped(
                result, {n: (v, result.units[n]) for n, v in curves.items()}, title, shared, log, step=True
            )
    return [*made, _step_times(result, shared)] if result.step_ns else made


def _estimate(result: Result, name: str, truth: str | None, shared: Range1d) -> new_figure:
    variable = name.partition(".estimate.")[2]
    drawn = axes(f"{variable}{_of(result, name)}", result.units[name], result.time, shared, height=TALL)
    trusted = name.partition(".estimate.")[0] + ".diagnostics.trusted"
    if trusted in result.names:
        drawn.spans(result[trusted] < 0.5, "not trusted")
    std = deviation_of(result, name)
    if std is not None:
        drawn.band(result[name] - 2 * std, result[name] + 2 * std, "estimated +- 2 std", ESTIMATE)
    if truth is not None:
        drawn.line(result[truth], "true", TRUTH)
    drawn.line(result[name], "estimated", ESTIMATE, dash="dashed" if truth is not None else "solid")
    return drawn.done()


def _errors(result: Result, found: Sequence[Pair], shared: Range1d) -> new_figure:
    drawn = axes("Errors of the estimates", "|estimate - truth|", result.time, shared, log=True, height=TALL)
    for pair, colour in zip(found, colours(len(found)), strict=True):
        error = pair.error(result)
        label = pair.variable + in_unit(result.units[pair.truth])
        drawn.line(positive(error), label, colour)
    return drawn.done()


def _measured(result: Result, one: Measurement, shared: Range1d) -> new_figure:
    drawn = axes(one.name, one.unit, result.time, shared)
    drawn.line(one.measured, "measured", COLOURS[0])
    drawn.x = result.time[one.sampled]
    drawn.line(one.predicted, "predicted", ESTIMATE, dash="dashed")
    return drawn.done()


def _innovation(result: Result, one: Measurement, shared: Range1d) -> new_figure:
    drawn = axes(f"Innovation of {one.name}", one.unit, result.time, shared)
    if one.deviation is not None:
        drawn.band(-2 * one.deviation, 2 * one.deviation, "+- 2 std", COLOURS[0])
    drawn.line(one.innovation, "measured - predicted", COLOURS[0], step=True)
    return drawn.done()


def _grouped(
    result: Result,
    curves: dict[str, tuple[np.ndarray, str]],
    title: str,
    shared: Range1d,
    log: bool = False,
    step: bool = False,
) -> list[new_figure]:
    """Curves (values, unit) by name, at most MOST in a figure."""
    made, names = [], list(curves)
    for first in range(0, len(names), MOST):
        some = names[first : first + MOST]
        units = {curves[name][1] for name in some}
        drawn = axes(title, units.pop() if len(units) == 1 else "units in the legend", result.time, shared, log, TALL)
        for name, colour in zip(some, colours(len(some)), strict=True):
            values, unit = curves[name]
            drawn.line(positive(values, 0.0) if log else values, name + in_unit(unit), colour, step=step)
        made.append(drawn.done())
    return made


def _outputs(result: Result, shared: Range1d) -> list[new_figure]:
    """For each element: what a system without an observer can show."""
    made = []
    for element in result.sources:
        head = f"{element}."
        names = [n for n in result.names if n.startswith(head) and result.kinds[n] == "Real"]
        curves = {n.removeprefix(head): (result[n], result.units[n]) for n in names}
        made += _grouped(result, curves, f"Outputs of {element}", shared)
    return made


def _status(result: Result, name: str, shared: Range1d) -> new_figure:
    """In words: those that occurred, from the mildest to the gravest."""
    items, values = result.items[name], result[name].astype(int)
    there = sorted({int(v) for v in values})
    place = {code: i for i, code in enumerate(there)}
    drawn = axes(f"Status ({name})", "", result.time, shared, height=110 + 28 * len(there))
    drawn.line(np.array([place[v] for v in values], dtype=float), "", COLOURS[0], step=True)
    plot = drawn.figure
    plot.yaxis.ticker = FixedTicker(ticks=list(place.values()))
    plot.yaxis.major_label_overrides = {i: items.get(code, str(code)) for code, i in place.items()}
    plot.y_range = Range1d(-0.5, len(there) - 0.5)
    return plot


def _step_times(result: Result, shared: Range1d) -> new_figure:
    drawn = axes("Computing time per communication step", "us", result.time, shared, log=True, height=TALL)
    for (element, ns), colour in zip(result.step_ns.items(), colours(len(result.step_ns)), strict=True):
        drawn.x = result.time[: len(ns)]
        drawn.line(ns / 1000, element if len(result.step_ns) <= MOST else "", colour)
    return drawn.done()


def _of(result: Result, name: str) -> str:
    """Whose estimate it is, where there are several observers."""
    observers = {n.partition(".estimate.")[0] for n in result.names if ".estimate." in n}
    return f" ({name.partition('.estimate.')[0]})" if len(observers) > 1 else ""
