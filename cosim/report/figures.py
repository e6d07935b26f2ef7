"""The figures on one run: estimates and truth, measured and predicted, errors, the observer's diagnostics, the time that steps take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from bokeh.models import FixedTicker, HoverTool, Legend, Range1d
from bokeh.plotting import figure as new_figure

from cosim.report.estimates import Pair, pairs
from cosim.report.observed import Measurement, deviation_of, known_inputs, measurements
from cosim.results import Result

# The page turns these about where its reader likes it dark. None is a default of Bokeh, which leaves such out.
INK, PAPER, GRID = "#1a1a1a", "#fefefe", "#e4e4e4"
TRUTH, ESTIMATE = INK, "#d55e00"
# Okabe and Ito's palette: told apart with every kind of colour vision.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#7a5195", "#767676")
POINTS = 1500  # that a curve keeps; more would only make the file large
ROW, TALL = 210, 330  # heights of a figure in pixels
MOST = 8  # curves in one figure
USUAL = (0.02, 0.98)  # quantiles between which an axis is never cut
FAR = 3.0  # spans of these quantiles: what is farther off is a spike, at which the axis is cut
NARROW = 0.05  # of the median: an axis that is cut shows as much to either side at least, or a constant would fill it with its rounding
LEAST = 1e-16  # on a logarithmic axis


@dataclass
class Axes:
    """A Bokeh figure and what was drawn in it, by which its vertical axis is chosen."""

    figure: new_figure
    time: np.ndarray
    log: bool = False
    whole: list[np.ndarray] = field(default_factory=list)  # values that the axis must show
    usual: list[np.ndarray] = field(default_factory=list)  # values whose spikes it may cut

    def line(self, values: np.ndarray, label: str, colour: str, *, step: bool = False, dash: str = "solid") -> None:
        kept = _thin(values)
        style = {"line_color": colour, "line_width": 1.6, "legend_label": label} if label else {"line_color": colour}
        draw = self.figure.step if step else self.figure.line
        draw(
            _small(self.time[kept]),
            _small(values[kept]),
            line_dash=dash,
            **({"mode": "after"} if step else {}),
            **style,
        )
        (self.whole if colour == TRUTH else self.usual).append(values)

    def band(self, low: np.ndarray, high: np.ndarray, label: str, colour: str) -> None:
        kept = _thin(high)
        edges = (_small(low[kept]), _small(high[kept]))
        self.figure.varea(
            _small(self.time[kept]), *edges, fill_color=colour, fill_alpha=0.18, legend_label=label, level="underlay"
        )

    def done(self) -> new_figure:
        cut = self._choose_range()
        if cut:
            self.figure.title.text += " (cut: zoom out)"
        return self.figure

    def _choose_range(self) -> bool:
        """Whether spikes were cut."""
        values = [v[np.isfinite(v)] for v in (*self.whole, *self.usual)]
        seen = np.concatenate(values) if values else np.empty(0)
        if self.log:
            seen = seen[seen > 0]
        if not len(seen):
            return False
        scale, back = (np.log10, lambda x: 10.0**x) if self.log else (lambda x: x, lambda x: x)
        seen = scale(seen)
        low, high = least, most = float(seen.min()), float(seen.max())
        first, last = (float(q) for q in np.quantile(seen, USUAL))
        span = last - first
        if span > 0 and not self.log and (high > last + FAR * span or low < first - FAR * span):
            must = np.concatenate([v[np.isfinite(v)] for v in self.whole] or [np.array([first])])
            around = max(span / 2, NARROW * abs(float(np.median(seen))))
            low = min(max(low, first - around), float(must.min()))
            high = max(min(high, last + around), float(must.max()))
        pad = 0.06 * (high - low) or 0.06 * abs(high) or 1.0
        self.figure.y_range = Range1d(float(back(low - pad)), float(back(high + pad)))
        return bool(low > least or high < most)


def figures(result: Result) -> list[new_figure]:
    """The figures that the columns of `result` allow, in the order of reading; their time axes move together."""
    shared = Range1d(
        float(result.time[0]), float(result.time[-1]) if len(result.time) > 1 else float(result.time[0]) + 1
    )
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
    return [*made, _step_times(result, shared)]


def _estimate(result: Result, name: str, truth: str | None, shared: Range1d) -> new_figure:
    variable = name.partition(".estimate.")[2]
    axes = _axes(result, f"{variable}{_of(result, name)}", result.units[name], shared)
    std = deviation_of(result, name)
    if std is not None:
        axes.band(result[name] - 2 * std, result[name] + 2 * std, "estimated +- 2 std", ESTIMATE)
    if truth is not None:
        axes.line(result[truth], "true", TRUTH)
    axes.line(result[name], "estimated", ESTIMATE, dash="dashed" if truth is not None else "solid")
    return axes.done()


def _errors(result: Result, found: Sequence[Pair], shared: Range1d) -> new_figure:
    axes = _axes(result, "Errors of the estimates", "|estimate - truth|", shared, log=True, height=TALL)
    for pair, colour in zip(found, _colours(len(found)), strict=True):
        error = pair.error(result)
        label = pair.variable + _unit(result.units[pair.truth])
        axes.line(np.where(error > LEAST, error, np.nan), label, colour)  # a logarithmic axis has no zero
    return axes.done()


def _measured(result: Result, one: Measurement, shared: Range1d) -> new_figure:
    axes = _axes(result, one.name, one.unit, shared)
    axes.line(one.measured, "measured", COLOURS[0])
    axes.time = result.time[one.sampled]
    axes.line(one.predicted, "predicted", ESTIMATE, dash="dashed")
    return axes.done()


def _innovation(result: Result, one: Measurement, shared: Range1d) -> new_figure:
    axes = _axes(result, f"Innovation of {one.name}", one.unit, shared)
    if one.deviation is not None:
        axes.band(-2 * one.deviation, 2 * one.deviation, "+- 2 std", COLOURS[0])
    axes.line(one.innovation, "measured - predicted", COLOURS[0], step=True)
    return axes.done()


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
        axes = _axes(result, title, units.pop() if len(units) == 1 else "units in the legend", shared, log, TALL)
        for name, colour in zip(some, _colours(len(some)), strict=True):
            values, unit = curves[name]
            axes.line(np.where(values > 0, values, np.nan) if log else values, name + _unit(unit), colour, step=step)
        made.append(axes.done())
    return made


def _outputs(result: Result, shared: Range1d) -> list[new_figure]:
    """For each element: what a system without an observer can show."""
    made = []
    for element in result.step_ns:
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
    axes = _axes(result, f"Status ({name})", "", shared, height=110 + 28 * len(there))
    axes.line(np.array([place[v] for v in values], dtype=float), "", COLOURS[0], step=True)
    plot = axes.figure
    plot.yaxis.ticker = FixedTicker(ticks=list(place.values()))
    plot.yaxis.major_label_overrides = {i: items.get(code, str(code)) for code, i in place.items()}
    plot.y_range = Range1d(-0.5, len(there) - 0.5)
    return plot


def _step_times(result: Result, shared: Range1d) -> new_figure:
    axes = _axes(result, "Computing time per communication step", "us", shared, log=True, height=TALL)
    for (element, ns), colour in zip(result.step_ns.items(), _colours(len(result.step_ns)), strict=True):
        axes.time = result.time[: len(ns)]
        axes.line(ns / 1000, element if len(result.step_ns) <= MOST else "", colour)
    return axes.done()


def _axes(result: Result, title: str, unit: str, shared: Range1d, log: bool = False, height: int = ROW) -> Axes:
    plot = new_figure(
        title=title,
        height=height,
        sizing_mode="stretch_width",
        x_range=shared,
        y_axis_type="log" if log else "linear",
        tools="pan,box_zoom,wheel_zoom,reset,save",
        toolbar_location="below",
        background_fill_color=PAPER,
        border_fill_color=PAPER,
        outline_line_color=None,
        min_border_left=56,
    )
    plot.toolbar.logo = None
    plot.add_tools(HoverTool(tooltips=[("time", "$x{0.000000} s"), ("value", "$y{0.000000e+0}")]))
    plot.title.text_color, plot.title.text_font_size = INK, "15px"
    plot.xaxis.axis_label = "time [s]"
    plot.yaxis.axis_label = unit if unit not in ("", "1") else None
    for axis in (*plot.xaxis, *plot.yaxis):
        axis.axis_line_color = axis.major_tick_line_color = axis.minor_tick_line_color = INK
        axis.major_label_text_color = axis.axis_label_text_color = INK
        axis.axis_label_text_font_style = "normal"
    plot.grid.grid_line_color = GRID
    plot.add_layout(_legend(), "above")
    return Axes(plot, result.time, log)


def _legend() -> Legend:
    return Legend(
        orientation="horizontal",
        click_policy="hide",
        border_line_color=None,
        background_fill_color=PAPER,
        label_text_color=INK,
        padding=2,
        margin=2,
        label_text_font_size="12px",
        ncols=4,
    )


def _small(values: np.ndarray) -> np.ndarray:
    return values.astype(np.float32)  # 7 digits are more than a screen shows, at half the size


def _thin(values: np.ndarray) -> np.ndarray:
    """Indices of at most POINTS values: the least and the largest of every stretch, so that no peak is lost."""
    if len(values) <= POINTS:
        return np.arange(len(values))
    kept = []
    for stretch in np.array_split(np.arange(len(values)), POINTS // 2):
        here = values[stretch]
        low, high = np.where(np.isnan(here), np.inf, here), np.where(np.isnan(here), -np.inf, here)
        kept += [stretch[np.argmin(low)], stretch[np.argmax(high)]]
    return np.unique(kept)


def _of(result: Result, name: str) -> str:
    """Whose estimate it is, where there are several observers."""
    observers = {n.partition(".estimate.")[0] for n in result.names if ".estimate." in n}
    return f" ({name.partition('.estimate.')[0]})" if len(observers) > 1 else ""


def _colours(count: int) -> list[str]:
    return [COLOURS[i % len(COLOURS)] for i in range(count)]


def _unit(unit: str) -> str:
    return f" [{unit}]" if unit not in ("", "1") else ""
