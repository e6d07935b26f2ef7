"""What bounds a deadline: instructions of a step, median and worst, under noise and under outliers: python -m benchmarks.worst_case.

The observers and streams are those of `benchmarks.trust`; each FMU is built and driven natively, and callgrind counts each fmi2DoStep by
itself. Counts are per step of one sample; a few percent depend on the processor, for which glibc picks its cosine.
"""

from __future__ import annotations

import re
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from benchmarks import callgrind
from benchmarks.native import Experiment, Unpacked, build_driver, command, execute, unpack
from benchmarks.streams.catalogue import PAPERS, Entry
from benchmarks.streams.corruptions import CLEAN, CORRUPTIONS
from benchmarks.streams.streams import Stream, Streams
from fmu_src import export

STEP = "fmi2DoStep"
STREAMS = (CLEAN, *(c for c in CORRUPTIONS if c.name in ("outliers", "times_1000")))
_SUMMARY = re.compile(r"^summary: (\d+)", re.MULTILINE)

out = Console(width=None if sys.stdout.isatty() else 130)
err = Console(stderr=True)


@dataclass(frozen=True)
class Cost:
    """Instructions of each step (samples,) on a stream, the first sample left out."""

    steps: np.ndarray

    @property
    def median(self) -> float:
        return float(np.median(self.steps))

    @property
    def worst(self) -> float:
        return float(np.max(self.steps))


def cost(driver: Path, fmu: Unpacked, stream: Stream, parameters: Mapping[str, float]) -> Cost:
    """The cost of the FMU's steps on the stream."""
    names = tuple([*stream.measured, *stream.inputs])
    rows = np.column_stack([*stream.measured.values(), *stream.inputs.values()])
    first = fmu.description.modelVariables[0].name
    estimates = [v.name for v in fmu.description.modelVariables if v.name.startswith("estimate.")][:1] or [first]
    experiment = Experiment(rows, stream.scenario.sample_time, names, estimates, parameters)
    with tempfile.TemporaryDirectory() as scratch:
        directory = Path(scratch)
        run = command(driver, fmu, fmu.library, experiment, 1, directory)
        count = ["--tool=callgrind", "--quiet", f"--toggle-collect={STEP}", f"--dump-after={STEP}"]
        execute(["valgrind", *count, f"--callgrind-out-file={directory / 'step'}", *run])
        dumps = sorted(directory.glob("step.*"), key=lambda path: int(path.suffix[1:]))
        found = [_SUMMARY.search(path.read_text()) for path in dumps]
    steps = np.array([int(match[1]) for match in found if match])
    return Cost(steps[steps > 0][1:])


def costs(driver: Path, entry: Entry, scratch: Path) -> list[Cost]:
    """Of the observer, on each of STREAMS."""
    component, streams = entry.make(), Streams(entry.scenario())
    fmu = unpack(export(component, scratch), scratch / component.name)
    return [cost(driver, fmu, streams.stream(corruption, 0), entry.parameters) for corruption in STREAMS]


def main(
    observer: Annotated[list[str] | None, typer.Option(help="only observers whose name contains this")] = None,
) -> None:
    """Print the table: thousands of instructions of a step."""
    if not callgrind.is_installed():
        err.print("error: valgrind is not installed: it counts the instructions", style="red")
        sys.exit(1)
    entries = {name: e for name, e in PAPERS.items() if not observer or any(part in name for part in observer)}
    table = Table(box=None, pad_edge=False)
    table.add_column("thousands of instructions a step", no_wrap=True)
    for corruption in STREAMS:
        name = "noise" if corruption is CLEAN else corruption.name
        for column in (f"{name}: median", "worst", "ratio"):
            table.add_column(column, justify="right")
    columns = (TextColumn("{task.description:<42}"), BarColumn(), TextColumn("{task.completed}/{task.total}"))
    with (
        tempfile.TemporaryDirectory() as name,
        Progress(*columns, TimeElapsedColumn(), console=err, transient=True, disable=not err.is_terminal) as bar,
    ):
        task = bar.add_task("", total=len(entries))
        driver = build_driver(Path(name))
        for label, entry in entries.items():
            bar.update(task, description=label)
            cells = [
                (f"{c.median / 1e3:.1f}", f"{c.worst / 1e3:.1f}", f"{c.worst / c.median:.1f}")
                for c in costs(driver, entry, Path(name))
            ]
            table.add_row(label, *(text for row in cells for text in row))
            bar.advance(task)
    out.print(table)


if __name__ == "__main__":
    typer.run(main)
