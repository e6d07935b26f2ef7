"""The figures on one run: states and estimates, errors, the observer's diagnostics, the time that steps take."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from cosim.report.estimates import Pair, pairs
from cosim.results import Result

TRUTH, ESTIMATE = "#1a1a1a", "#d55e00"
# Okabe and Ito's palette: told apart with every kind of colour vision.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#7a5195", "#666666")
POINTS = 4000  # that a curve keeps; more would only make the file large
ROW = 190  # height of one panel in pixels
TIME = "time [s]"


def figures(result: Result) -> list[go.Figure]:
    """The figures that the columns of `result` allow, in the order of reading."""
    found = pairs(result)
    estimates = [name for name in result.names if ".estimate." in name]
    if found:
        made = [_states(result, found), _errors(result, found)]
    elif estimates:
        made = [_estimates(result, estimates)]
    else:
        made = _outputs(result)
    made += [_status(result, name) for name in result.names if name.endswith(".status") and name in result.items]
    for last, title, log in (
        (".cost", "Cost of the estimate", True),
        (".iterations", "Iterations of the solver", False),
    ):
        names = [name for name in result.names if name.endswith(f".diagnostics{last}")]
        if names:
            made.append(_curves(result, names, title, log))
    return [*made, _step_times(result)]


def _states(result: Result, found: list[Pair]) -> go.Figure:
    figure = make_subplots(rows=len(found), cols=1, shared_xaxes=True, vertical_spacing=0.12 / len(found))
    for row, pair in enumerate(found, start=1):
        first = row == 1
        for name, label, colour, dash in (
            (pair.truth, "true", TRUTH, "solid"),
            (pair.estimate, "estimated", ESTIMATE, "dash"),
        ):
            line = {"color": colour, "width": 1.8, "dash": dash}
            curve = _curve(result.time, result[name], name=label, line=line, legendgroup=label, showlegend=first)
            figure.add_trace(curve, row=row, col=1)
        unit = _unit(result, pair.truth)
        figure.update_yaxes(title_text=f"{pair.variable}{unit}", row=row, col=1)
    figure.update_xaxes(title_text=TIME, row=len(found), col=1)
    return _finish(figure, "True and estimated values", 130 + ROW * len(found))


def _estimates(result: Result, names: list[str]) -> go.Figure:
    """Estimates whose truth nobody knows."""
    figure = make_subplots(rows=len(names), cols=1, shared_xaxes=True, vertical_spacing=0.12 / len(names))
    for row, name in enumerate(names, start=1):
        line = {"color": ESTIMATE, "width": 1.5}
        figure.add_trace(_curve(result.time, result[name], name=name, line=line, showlegend=False), row=row, col=1)
        figure.update_yaxes(title_text=name.partition(".estimate.")[2] + _unit(result, name), row=row, col=1)
    figure.update_xaxes(title_text=TIME, row=len(names), col=1)
    return _finish(figure, "Estimated values", 130 + ROW * len(names))


def _errors(result: Result, found: list[Pair]) -> go.Figure:
    figure = go.Figure()
    for pair, colour in zip(found, _colours(len(found)), strict=True):
        error = pair.error(result)
        label = pair.variable + _unit(result, pair.truth)
        shown = np.where(error > 0, error, np.nan)  # a logarithmic axis has no zero
        figure.add_trace(_curve(result.time, shown, name=label, line={"color": colour, "width": 1.5}))
    figure.update_yaxes(title_text="|estimate - truth|", type="log", exponentformat="power")
    figure.update_xaxes(title_text=TIME)
    return _finish(figure, "Errors of the estimates", 400)


def _status(result: Result, name: str) -> go.Figure:
    items = result.items[name]
    line = {"color": COLOURS[0], "width": 1.8, "shape": "hv"}
    figure = go.Figure(_curve(result.time, result[name], name=name, line=line))
    lowest, highest = min(items), max(items)
    figure.update_yaxes(tickvals=list(items), ticktext=list(items.values()), range=[lowest - 0.5, highest + 0.5])
    figure.update_xaxes(title_text=TIME)
    return _finish(figure, f"Status ({name})", 150 + 26 * len(items))


def _curves(result: Result, names: list[str], title: str, log: bool) -> go.Figure:
    figure = go.Figure()
    for name, colour in zip(names, _colours(len(names)), strict=True):
        values = np.where(result[name] > 0, result[name], np.nan) if log else result[name]
        label = name + _unit(result, name)
        figure.add_trace(_curve(result.time, values, name=label, line={"color": colour, "width": 1.5, "shape": "hv"}))
    figure.update_yaxes(
        title_text=names[0].rpartition(".")[2] + _unit(result, names[0]), type="log" if log else "linear"
    )
    if log:
        figure.update_yaxes(exponentformat="power")
    figure.update_xaxes(title_text=TIME)
    return _finish(figure, title, 320)


def _outputs(result: Result) -> list[go.Figure]:
    """One figure for each element: what a system without an observer can show."""
    made = []
    for element in result.step_ns:
        names = [n for n in result.names if n.startswith(f"{element}.") and result.kinds[n] == "Real"]
        if names:
            figure = go.Figure()
            for name, colour in zip(names, _colours(len(names)), strict=True):
                label = name.removeprefix(f"{element}.") + _unit(result, name)
                figure.add_trace(_curve(result.time, result[name], name=label, line={"color": colour, "width": 1.5}))
            figure.update_xaxes(title_text=TIME)
            figure.update_yaxes(title_text="value (units in the legend)")
            made.append(_finish(figure, f"Outputs of {element}", 400))
    return made


def _step_times(result: Result) -> go.Figure:
    figure = go.Figure()
    for (element, ns), colour in zip(result.step_ns.items(), _colours(len(result.step_ns)), strict=True):
        line = {"color": colour, "width": 1}
        figure.add_trace(_curve(result.time[: len(ns)], ns / 1000, name=element, line=line))
    figure.update_yaxes(title_text="time per step [us]", type="log", exponentformat="power")
    figure.update_xaxes(title_text=TIME)
    return _finish(figure, "Computing time per communication step", 320)


def _curve(time: np.ndarray, values: np.ndarray, **style: object) -> go.Scatter:
    kept = _thin(values)
    return go.Scatter(
        x=time[kept].astype(np.float32),  # 7 digits are more than a screen shows, at half the size
        y=values[kept].astype(np.float32),
        mode="lines",
        hovertemplate="t = %{x:.6g} s: %{y:.6g}",
        **style,
    )


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


def _colours(count: int) -> list[str]:
    return [COLOURS[i % len(COLOURS)] for i in range(count)]


def _unit(result: Result, name: str) -> str:
    unit = result.units[name]
    return f" [{unit}]" if unit not in ("", "1") else ""


def _finish(figure: go.Figure, title: str, height: int) -> go.Figure:
    axis = {"showline": True, "linecolor": "#1a1a1a", "gridcolor": "#e4e4e4", "zeroline": False, "ticks": "outside"}
    figure.update_xaxes(**axis)
    figure.update_yaxes(**axis, automargin=True, title_standoff=12)
    return figure.update_layout(
        template="none",
        title={"text": title, "x": 0, "xref": "paper", "font": {"size": 18}},
        font={"family": "system-ui, sans-serif", "size": 14, "color": "#1a1a1a"},
        height=height,
        margin={"l": 90, "r": 20, "t": 60, "b": 55},
        legend={"orientation": "h", "x": 1, "xanchor": "right", "y": 1, "yanchor": "bottom"},
        showlegend=True,
        paper_bgcolor="#ffffff",
        plot_bgcolor="#ffffff",
    )
