"""The pictures in an FMU: a plot of the default experiment and the icon. The same component gives the same bytes."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from fmu_src.errors import ExportError
from observers.component import Component
from observers.instance import Instance

MOST_STEPS = 600
MOST_PANELS = 8
_STYLE: Any = {"svg.hashsalt": "observer-fmus", "svg.fonttype": "none", "font.family": "sans-serif", "font.size": 9}


@dataclass(frozen=True)
class Panel:
    """One axis of the plot: its label and its curves, values over the common times, by legend."""

    label: str
    curves: dict[str, np.ndarray]


def default_experiment(component: Component, driven_by: Component | None) -> tuple[np.ndarray, list[Panel]]:
    """Times (n) [s] and what is worth a look: each `estimate.*` with the plant's `x.*`, or else the continuous outputs.

    Both run as Python instances from time 0, at most MOST_STEPS steps: get all outputs, set all inputs, step all.

    Raises:
        ExportError: a step of the default experiment fails.
    """
    members = [component] if driven_by is None else [driven_by, component]
    h = component.step_size
    steps = max(1, min(MOST_STEPS, round(component.stop_time / h)))
    instances = [Instance(member) for member in members]
    inputs = [{port.name for port in member.inputs} for member in members]
    history: list[dict[str, list[float]]] = [{port.name: [] for port in member.outputs} for member in members]
    try:
        for k in range(steps + 1):
            values = [
                dict(zip(record, instance.outputs(), strict=True))
                for record, instance in zip(history, instances, strict=True)
            ]
            for record, now in zip(history, values, strict=True):
                for name, value in now.items():
                    record[name].append(value)
            for names, instance in zip(inputs, instances, strict=True):
                for other in values:
                    for name in names & other.keys():
                        instance.set(name, other[name])
            if k < steps:
                for instance in instances:
                    instance.step(k * h, h)
    except (ValueError, RuntimeError) as error:
        raise ExportError(f"component '{component.name}': its default experiment fails: {error}") from error
    # Six digits: more than the plot shows, fewer than differ between machines.
    series = [
        {name: np.array([float(f"{v:.6g}") for v in values]) for name, values in record.items()} for record in history
    ]
    return np.arange(steps + 1) * h, _panels(component, series)


def _panels(component: Component, series: list[dict[str, np.ndarray]]) -> list[Panel]:
    own, plant = series[-1], series[0]
    units = {port.name: "" if port.unit == "1" else f" [{port.unit}]" for port in component.outputs}
    names = [name.removeprefix("estimate.") for name in own if name.startswith("estimate.")]
    pairs = [name for name in names if len(series) > 1 and f"x.{name}" in plant]
    if pairs:
        return [
            Panel(
                f"{name}{units[f'estimate.{name}']}", {"plant": plant[f"x.{name}"], "estimate": own[f"estimate.{name}"]}
            )
            for name in pairs[:MOST_PANELS]
        ]
    shown = [
        port.name
        for port in component.outputs
        if port.kind == "Real" and port.variability == "continuous" and not port.local
    ]
    return [Panel(f"{name}{units[name]}", {name: own[name]}) for name in shown[:MOST_PANELS]]


def plot(times: np.ndarray, panels: list[Panel]) -> str:
    """The panels one below the other, as an SVG element to stand in an HTML page."""
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(8, 0.6 + 1.6 * len(panels)), layout="constrained")
        for axes, panel in zip(np.atleast_1d(figure.subplots(len(panels), sharex=True)), panels, strict=True):
            for (legend, values), line in zip(panel.curves.items(), ("-", "--"), strict=False):
                axes.plot(times, values, line, linewidth=1.2, label=legend)
            axes.set_ylabel(panel.label)
            axes.grid(alpha=0.3)
            if panel is panels[0] and len(panel.curves) > 1:
                axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, frameon=False)
        axes.set_xlabel("time [s]")
        buffer = io.StringIO()
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def icon(name: str) -> bytes:
    """A block with the component's name, as PNG."""
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(1.28, 1.28), dpi=100)
        figure.add_artist(
            FancyBboxPatch((0.1, 0.2), 0.8, 0.6, boxstyle="round,pad=0.04", facecolor="#e8f0f8", edgecolor="#204a70")
        )
        words = name.split("_")
        size = min(14.0, 110 / max(len(word) for word in words))
        figure.text(0.5, 0.5, "\n".join(words), ha="center", va="center", fontsize=size, color="#204a70")
        buffer = io.BytesIO()
        # Stored, not deflated: see archive.py.
        FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None}, pil_kwargs={"compress_level": 0})
    return buffer.getvalue()
