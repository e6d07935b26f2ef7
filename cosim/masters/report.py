"""What there is to say of a comparison: a table of the differences, and a page with their course in time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from bokeh.plotting import figure as new_figure

from cosim.masters.comparison import LIMIT, differences, differing, largest
from cosim.masters.experiment import Recording
from cosim.report.axes import TALL, TRUTH, axes, colours, span_of
from cosim.report.page import Section, Table, write_report


def table(recordings: Mapping[str, Recording]) -> tuple[Table, float]:
    """The largest difference of each column from the first recording, relative, with the largest of all in the last row; and that."""
    (first, reference), *others = recordings.items()
    found = {name: differences(reference, recording) for name, recording in others}
    rows = [
        (variable, *("not recorded" if (d := column[variable]) is None else f"{d:.2g}" for column in found.values()))
        for variable in reference
    ]
    worst = {name: largest(column) for name, column in found.items()}
    rows.append(("largest", *(f"{value:.2g}" for value in worst.values())))
    return Table((f"from {first}, relative", *found), rows), max(worst.values())


def write_comparison(path: Path, title: str, command_html: str, recordings: Mapping[str, Recording]) -> None:
    """Write the page on recordings of one system by several tools, by name; `command_html` is the command that made it.

    Raises:
        OSError: the file cannot be written.
    """
    found, worst = table(recordings)
    said = f"The largest difference is {worst:.2g}; the limit is {LIMIT:g}."
    sections = [Section("Differences in time", [said], [], [_drawn(recordings)])]
    write_report(path, title, command_html, [found], sections)


def _drawn(recordings: Mapping[str, Recording]) -> new_figure:
    """Of each tool the largest difference of all columns at each time."""
    (first, reference), *others = recordings.items()
    time = reference["time"]
    drawn = axes(f"Largest difference from {first}, relative", "", time, span_of(time), height=TALL)
    drawn.line(np.full(len(time), LIMIT), "limit", TRUTH)
    for (name, recording), colour in zip(others, colours(len(others)), strict=True):
        there = [variable for variable in reference if variable in recording]
        there = [variable for variable in there if recording[variable].shape == time.shape]
        if there:
            drawn.line(np.max([differing(reference[v], recording[v]) for v in there], axis=0), name, colour, step=True)
    return drawn.done()
