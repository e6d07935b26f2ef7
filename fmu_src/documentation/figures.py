"""The pictures in an FMU: a plot of the default experiment and the icon. The same component gives the same bytes."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

import numpy as np

from fmu_src.documentation.experiment import default_experiment
from observers.component import Component

MOST_STEPS = 600
MOST_PANELS = 8
_STYLE: Any = {"svg.hashsalt": "observer-fmus", "svg.fonttype": "none", "font.family": "sans-serif", "font.size": 9}


@dataclass(frozen=True)
class Panel:
    """One axis of the plot: its label and its curves, values over the common times, by legend."""

    label: str
    curves: dict[str, np.ndarray]


def panels(component: Component, driven_by: Component | None) -> tuple[np.ndarray, list[Panel]]:
    """Times (n) [s] and what is worth a look: each `estimate.*` with the plant's `x.*`, or else the continuous outputs.

    Raises:
        ExperimentFailed: a step of the default experiment fails.
    """
    recording = default_experiment(component, driven_by, MOST_STEPS)
    own, plant = _six_digits(recording.outputs), _six_digits(recording.plant or {})
    units = {port.name: "" if port.unit in ("", "1") else f" [{port.unit}]" for port in component.outputs}
    names = [name.removeprefix("estimate.") for name in own if name.startswith("estimate.")]
    pairs = [name for name in names if f"x.{name}" in plant]
    if pairs:
        return recording.times, [
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
    return recording.times, [Panel(f"{name}{units[name]}", {name: own[name]}) for name in shown[:MOST_PANELS]]


def _six_digits(series: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """More digits than the plot shows, fewer than differ between machines."""
    return {name: np.array([float(f"{v:.6g}") for v in values]) for name, values in series.items()}


def plot(times: np.ndarray, rows: list[Panel]) -> str:
    """The panels one below the other, as an SVG element to stand in an HTML page."""
    # Loaded where something is drawn: matplotlib takes longer to load than most commands take.
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(8, 0.6 + 1.6 * len(rows)), layout="constrained")
        for axes, panel in zip(np.atleast_1d(figure.subplots(len(rows), sharex=True)), rows, strict=True):
            for (legend, values), line in zip(panel.curves.items(), ("-", "--"), strict=False):
                axes.plot(times, values, line, linewidth=1.2, label=legend)
            axes.set_ylabel(panel.label)
            axes.grid(alpha=0.3)
            if panel is rows[0] and len(panel.curves) > 1:
                axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, frameon=False)
        axes.set_xlabel("time [s]")
        buffer = io.StringIO()
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def icon(name: str) -> bytes:
    """A block with the component's name, as PNG."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import FancyBboxPatch

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
