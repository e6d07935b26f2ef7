"""What bounds a deadline: instructions of a step, median and worst, under noise and under outliers: python -m benchmarks.worst_case.

Of every observer of the catalogue, and three more that `benchmarks.trust` judges. Each FMU is built and driven natively on the streams of
`benchmarks.streams.catalogue`; callgrind counts each fmi2DoStep by itself. Counts are per step of one sample; a few percent depend on
the processor, for which glibc picks its cosine. The time is that of the step with the most instructions, driven from Python without
callgrind: processor time, the least of three runs.
"""

from __future__ import annotations

import re
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import thread_time_ns
from typing import Annotated

import numpy as np
import typer
from fmpy.fmi2 import fmi2Warning
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from advice.streams.corruptions import CLEAN, CORRUPTIONS
from advice.streams.streams import Stream, Streams
from benchmarks import callgrind
from benchmarks.native import Experiment, Unpacked, build_driver, command, execute, unpack
from benchmarks.python_master import begun
from benchmarks.streams.catalogue import CATALOGUE
from benchmarks.streams.entry import Entry
from fmu_src import export
from observers.component import Component

STEP = "fmi2DoStep"
LIMIT = "tuning.iteration_limit"
STREAMS = (CLEAN, *(c for c in CORRUPTIONS if c.name in ("outliers", "times_1000")))
RUNS = 3  # of which the least time of a step counts
_SUMMARY = re.compile(r"^summary: (\d+)", re.MULTILINE)

err = Console(stderr=True)


@dataclass(frozen=True)
class Cost:
    """On a stream: the instructions of each step (samples - 1,), the first left out; its `settled` samples; `ms`, the time of the worst."""

    steps: np.ndarray
    settled: int
    ms: float

    @property
    def median(self) -> float:
        """Of the steps that follow on the settled samples: before, a window waits for its samples."""
        return float(np.median(self.steps[self.settled - 1 :]))

    @property
    def worst(self) -> float:
        return float(np.max(self.steps))


def with_limit(component: Component, limit: int) -> Component:
    """The component with that iteration limit, or its largest; one without a limit as it is."""
    ports = (replace(p, start=min(limit, p.max)) if p.name == LIMIT else p for p in component.parameters)
    return replace(component, parameters=tuple(ports))


def limit_of(component: Component) -> int | None:
    """The component's iteration limit; None where it has none."""
    return next((round(p.start) for p in component.parameters if p.name == LIMIT), None)


def cost(driver: Path, fmu: Unpacked, entry: Entry, stream: Stream) -> Cost:
    """The cost of the FMU's steps on the stream."""
    known = {v.name for v in fmu.description.modelVariables if v.causality == "input"}
    inputs = {name: values for name, values in stream.inputs.items() if name in known}  # not the unknown disturbances
    names = tuple([*stream.measured, *inputs])
    rows = np.column_stack([*stream.measured.values(), *inputs.values()])
    first = next(v.name for v in fmu.description.modelVariables if v.name.startswith("estimate."))
    experiment = Experiment(rows, stream.scenario.sample_time, names, [first], entry.parameters)
    with tempfile.TemporaryDirectory() as scratch:
        directory = Path(scratch)
        run = command(driver, fmu, fmu.library, experiment, 1, directory)
        count = ["--tool=callgrind", "--quiet", f"--toggle-collect={STEP}", f"--dump-after={STEP}"]
        execute(["valgrind", *count, f"--callgrind-out-file={directory / 'step'}", *run])
        dumps = sorted(directory.glob("step.*"), key=lambda path: int(path.suffix[1:]))
        found = [_SUMMARY.search(path.read_text()) for path in dumps]
    steps = np.array([int(match[1]) for match in found if match])
    steps = steps[steps > 0]
    worst = 1 + int(np.argmax(steps[1:]))
    until = replace(experiment, samples=rows[: worst + 1])
    ms = min(_last_step(fmu, until) for _ in range(RUNS)) / 1e6
    return Cost(steps[1:], stream.scenario.settled, ms)


def _last_step(fmu: Unpacked, experiment: Experiment) -> int:
    """Nanoseconds of the processor in the last of the steps."""
    with begun(fmu, experiment) as slave:
        samples = np.ascontiguousarray(experiment.samples, dtype=float)
        references = np.array(fmu.references(experiment.inputs), dtype=np.uint32)
        set_real, h, took = slave.access("Set", "Real"), experiment.step, 0
        for k, row in enumerate(samples):
            status = set_real(slave.component, references.ctypes.data, len(references), row.ctypes.data)
            begin = thread_time_ns()
            status = max(status, slave.do_step(slave.component, k * h, h, 1))
            took = thread_time_ns() - begin
            if status > fmi2Warning:
                raise slave.failure("set or doStep", status, k * h)
        return took


def costs(driver: Path, entry: Entry, component: Component, scratch: Path) -> list[Cost]:
    """Of the observer, on each of STREAMS."""
    streams = Streams(entry.scenario())
    fmu = unpack(export(component, scratch), scratch / component.name)
    return [cost(driver, fmu, entry, streams.stream(corruption, 0)) for corruption in STREAMS]


def _short(value: float) -> str:
    return f"{value:.0f}" if value >= 1000 else f"{value:.1f}" if value >= 1 else f"{value:.2g}"


def rows(entries: dict[str, Entry], limit: int | None, bar: Progress) -> Iterator[list[str]]:
    """The cells of each observer; with a `limit`, of those that have one."""
    task = bar.add_task("", total=len(entries))
    with tempfile.TemporaryDirectory() as scratch:
        driver = build_driver(Path(scratch))
        for name, entry in entries.items():
            bar.update(task, description=name)
            component = entry.make()
            bar.advance(task)
            if limit is not None:
                if limit_of(component) is None:
                    continue
                component = with_limit(component, limit)
            found = costs(driver, entry, component, Path(scratch))
            worst = max(found, key=lambda c: c.worst)
            yield [
                f"`{name}`",
                *(_short(value / 1e3) for c in found for value in (c.median, c.worst)),
                f"{worst.worst / found[0].median:.1f}",
                f"{_short(worst.ms)} of {1e3 * entry.scenario().sample_time:.3g}",
                f"{limit_of(component) or '-'}",
            ]


def main(
    observer: Annotated[list[str] | None, typer.Option(help="only observers whose name contains this")] = None,
    iteration_limit: Annotated[
        int | None, typer.Option(min=1, help=f"{LIMIT} of the observers that have it; only these are run")
    ] = None,
) -> None:
    """Print the table: thousands of instructions of a step."""
    if not callgrind.is_installed():
        err.print("error: valgrind is not installed: it counts the instructions", style="red")
        sys.exit(1)
    entries = {name: e for name, e in CATALOGUE.items() if not observer or any(part in name for part in observer)}
    if not entries:
        err.print(f"error: no observer's name contains {', '.join(observer or ())}; known: {', '.join(CATALOGUE)}")
        sys.exit(2)
    noise, *others = ("noise" if corruption is CLEAN else corruption.name.replace("_", " ") for corruption in STREAMS)
    heads = [f"{noise}: median", "worst", *(text for name in others for text in (f"{name}: median", "worst"))]
    heads = ["FMU", *heads, "ratio", "ms at worst", f"`{LIMIT}`"]
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}", flush=True)
    columns = (TextColumn("{task.description:<42}"), BarColumn(), TextColumn("{task.completed}/{task.total}"))
    with Progress(*columns, TimeElapsedColumn(), console=err, transient=True, disable=not err.is_terminal) as bar:
        for cells in rows(entries, iteration_limit, bar):
            print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    typer.run(main)
