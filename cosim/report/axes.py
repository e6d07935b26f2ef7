"""Axes of a report: colours, an axis that no spike ruins, curves thinned without losing a peak."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from bokeh.models import HoverTool, Legend, Range1d
from bokeh.plotting import figure as new_figure

# The page turns these about where its reader likes it dark. None is a default of Bokeh, which leaves such out.
INK, PAPER, GRID = "#1a1a1a", "#fefefe", "#e4e4e4"
TRUTH, ESTIMATE = INK, "#d55e00"
# Okabe and Ito's palette: told apart with every kind of colour vision.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#7a5195", "#767676")
POINTS = 1500  # that a curve keeps; more would only make the file large
ROW, TALL = 210, 330  # heights of a figure in pixels
STRIPS = 800  # that the rows are grouped to where they are shaded
MOST = 8  # curves in one figure
USUAL = (0.02, 0.98)  # quantiles between which an axis is never cut
FAR = 3.0  # spans of these quantiles: what is farther off is a spike, at which the axis is cut
NARROW = 0.05  # of the median: an axis that is cut shows as much to either side at least, or a constant would fill it with its rounding
LEAST = 1e-16  # of an error on a logarithmic axis
TIME = "time [s]"


@dataclass
class Axes:
    """A Bokeh figure and what was drawn in it, by which its vertical axis is chosen."""

    figure: new_figure
    x: np.ndarray
    log: bool = False
    whole: list[np.ndarray] = field(default_factory=list)  # values that the axis must show
    usual: list[np.ndarray] = field(default_factory=list)  # values whose spikes it may cut

    def line(self, values: np.ndarray, label: str, colour: str, *, step: bool = False, dash: str = "solid") -> None:
        kept = _thin(values)
        style = {"line_color": colour, "line_width": 1.6, "legend_label": label} if label else {"line_color": colour}
        draw = self.figure.step if step else self.figure.line
        draw(
            _small(self.x[kept]),
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
            _small(self.x[kept]), *edges, fill_color=colour, fill_alpha=0.18, legend_label=label, level="underlay"
        )

    def spans(self, where: np.ndarray, label: str) -> None:
        """Shades the times at which `where` (n,) holds, to the next row's; nothing if it never does."""
        if not where.any():
            return
        firsts = np.arange(0, len(where), max(1, -(-len(where) // STRIPS)))  # of a group of rows that are shaded alike
        edges = np.flatnonzero(np.diff(np.concatenate([[False], np.logical_or.reduceat(where, firsts), [False]])))
        ends = np.append(self.x[firsts], self.x[-1])
        style = {"fill_color": INK, "fill_alpha": 0.1, "line_color": None, "level": "underlay", "legend_label": label}
        self.figure.vstrip(_small(ends[edges[::2]]), _small(ends[edges[1::2]]), **style)

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


def axes(
    title: str, unit: str, x: np.ndarray, shared: Range1d, log: bool = False, height: int = ROW, along: str = TIME
) -> Axes:
    """Empty axes; `along`: what their horizontal axis says of `x`, and `shared` its range."""
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
    name, _, x_unit = along.partition(" [")
    tip = f"$x{{0.000000}} {x_unit.rstrip(']')}" if x_unit else "$x{0}"
    plot.add_tools(HoverTool(tooltips=[(name, tip), ("value", "$y{0.000000e+0}")]))
    plot.title.text_color, plot.title.text_font_size = INK, "15px"
    plot.xaxis.axis_label = along
    plot.yaxis.axis_label = unit if unit not in ("", "1") else None
    for axis in (*plot.xaxis, *plot.yaxis):
        axis.axis_line_color = axis.major_tick_line_color = axis.minor_tick_line_color = INK
        axis.major_label_text_color = axis.axis_label_text_color = INK
        axis.axis_label_text_font_style = "normal"
    plot.grid.grid_line_color = GRID
    plot.add_layout(_legend(), "above")
    return Axes(plot, x, log)


def span_of(x: np.ndarray) -> Range1d:
    """The range of a horizontal axis that shows `x` (n,) whole."""
    return Range1d(float(x[0]), float(x[-1]) if len(x) > 1 else float(x[0]) + 1)


def positive(values: np.ndarray, least: float = LEAST) -> np.ndarray:
    """`values`, NaN where they are not above `least`: a logarithmic axis has no zero."""
    return np.where(values > least, values, np.nan)


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
        ncols=3,  # four of them are cut off on a narrow screen
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


def colours(count: int) -> list[str]:
    return [COLOURS[i % len(COLOURS)] for i in range(count)]


def in_unit(unit: str) -> str:
    return f" [{unit}]" if unit not in ("", "1") else ""
