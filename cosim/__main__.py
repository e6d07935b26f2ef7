"""The command line of the co-simulation: python -m cosim."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, NoReturn

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table as ConsoleTable
from rich.text import Text

from cosim.comparison import LIMIT, MASTERS, differences, largest, record_all
from cosim.errors import ExperimentError, SystemFileError
from cosim.estimates import pairs
from cosim.master import run as run_system
from cosim.masters.experiment import MasterError, Recording
from cosim.report import Table, write_report
from cosim.results import Result, write_columns, write_csv
from cosim.slave import RunError

SHOW_PROGRESS_AFTER = 1.5  # [s]

app = typer.Typer(
    help="Run systems of FMUs (.ssp files, SSP 1.0 with FMI 2.0 co-simulation FMUs).",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
out = Console()
err = Console(stderr=True)


@app.callback()
def commands() -> None:
    """Run systems of FMUs (.ssp files, SSP 1.0 with FMI 2.0 co-simulation FMUs)."""


@app.command()
def run(
    system: Annotated[Path, typer.Argument(help="The system to run, an .ssp file.", show_default=False)],
    out_directory: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Where the files go.", show_default="results/<name of the file>"),
    ] = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="ELEMENT.VARIABLE=VALUE",
            help="Start value of a parameter or an unconnected input, such as plant.sensor.seed=7. May be repeated.",
        ),
    ] = None,
    stop: Annotated[float | None, typer.Option(help="Stop time in seconds.", show_default="the system's")] = None,
    step: Annotated[
        float | None, typer.Option(help="Communication step size in seconds.", show_default="the system's")
    ] = None,
) -> None:
    """Run a system once; write results.csv (all outputs of all FMUs) and report.html (figures)."""
    directory = out_directory or Path("results") / system.stem
    overrides = _overrides(assignments or [])
    try:
        with _late_progress() as progress:
            result = run_system(system, stop=stop, step=step, overrides=overrides, progress=progress)
        failure = None
    except (SystemFileError, ExperimentError) as error:
        _fail(str(error), 2)
    except RunError as error:
        if error.partial is None or not len(error.partial.time):
            _fail(str(error), 1)
        result, failure = error.partial, error
    table = directory / "results.csv"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        write_csv(result, table)
        if failure is None:
            _write_report(result, directory / "report.html")
    except OSError as error:
        _fail(f"cannot write to {directory}: {error.strerror or error}", 2)
    if failure is not None:
        _fail(f"{failure} (the record up to there is in {table})", 1)
    _summarise(result, directory)


@app.command()
def compare(
    system: Annotated[Path, typer.Argument(help="The system to run, an .ssp file.", show_default=False)],
    masters: Annotated[
        str, typer.Option(metavar="NAMES", help="The tools that run it; the first is what the others are compared to.")
    ] = ",".join(MASTERS),
    out_directory: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Where <tool>.csv of each goes.", show_default="not written"),
    ] = None,
) -> None:
    """Run a system in several tools; print the largest difference of each variable. Fails above 1e-12 (relative)."""
    try:
        recordings = record_all(system, [name.strip() for name in masters.split(",")])
    except (SystemFileError, ExperimentError) as error:
        _fail(str(error), 2)
    except (RunError, MasterError) as error:
        _fail(str(error), 1)
    if out_directory is not None:
        try:
            out_directory.mkdir(parents=True, exist_ok=True)
            for name, recording in recordings.items():
                write_columns(recording, out_directory / f"{name}.csv")
        except OSError as error:
            _fail(f"cannot write to {out_directory}: {error.strerror or error}", 2)
    worst = _print_differences(system.stem, recordings)
    if not worst <= LIMIT:
        _fail(f"{system}: the tools differ by {worst:.2g}, more than {LIMIT:g}", 1)


def _overrides(assignments: list[str]) -> dict[str, str]:
    overrides = {}
    for assignment in assignments:
        name, equals, value = assignment.partition("=")
        if not equals or not name.strip() or not value.strip():
            _fail(f"--set {assignment}: not of the form ELEMENT.VARIABLE=VALUE", 2)
        overrides[name.strip()] = value.strip()
    return overrides


def _fail(message: str, code: int) -> NoReturn:
    """End with one red line; `code` is 2 for a user's mistake, 1 for a failed run."""
    err.print(Text(f"error: {' '.join(message.split())}", style="red"), soft_wrap=True)
    raise typer.Exit(code)


@contextmanager
def _late_progress() -> Iterator[Callable[[int, int], None]]:
    """What to call with the steps done and of all: shows a bar once a run takes longer than a moment."""
    columns = (TextColumn("running"), BarColumn(), TextColumn("{task.percentage:.0f} %"), TimeRemainingColumn())
    display = Progress(*columns, console=err, transient=True, disable=not err.is_terminal)
    task = display.add_task("running")
    begin = time.monotonic()

    def update(done: int, total: int) -> None:
        display.update(task, completed=done, total=total)
        if time.monotonic() - begin > SHOW_PROGRESS_AFTER:
            display.start()  # does nothing when it is shown already

    try:
        yield update
    finally:
        display.stop()


def _write_report(result: Result, path: Path) -> None:
    found = pairs(result)
    table = None
    if found:
        half = len(result.time) // 2
        columns = ("estimate", "unit", "median error", "largest error, second half", "last error")
        rows = []
        for pair in found:
            error = pair.error(result)
            numbers = (np.median(error), np.max(error[half:]), error[-1])
            rows.append((pair.estimate, result.units[pair.truth], *(f"{number:.2e}" for number in numbers)))
        table = Table(columns, rows)
    intro = f"<p>{len(result.time) - 1} communication steps of {result.step:g} s up to t = {result.time[-1]:g} s.</p>"
    write_report(path, result.system, intro, table, [("Figures", "", result)])


def _summarise(result: Result, directory: Path) -> None:
    table = ConsoleTable(title=result.system, title_justify="left", title_style="bold")
    for head in ("element", "outputs", "steps", "median us/step", "max us/step"):
        table.add_column(head, justify="left" if head == "element" else "right")
    for element, ns in result.step_ns.items():
        outputs = sum(name.startswith(f"{element}.") for name in result.names)
        times = (f"{np.median(ns) / 1000:.2f}", f"{np.max(ns) / 1000:.1f}")
        table.add_row(element, str(outputs), str(len(ns)), *times)
    out.print(table)
    warnings = [m for m in result.messages if m.status != "ok"]
    if warnings:
        first = warnings[0]
        noun = "warning" if len(warnings) == 1 else "warnings"
        out.print(
            Text(f"{len(warnings)} {noun}, the first by {first.element}: {first.text}", style="yellow"), soft_wrap=True
        )
    for file in ("results.csv", "report.html"):
        out.print(Text(str(directory / file)), soft_wrap=True)


def _print_differences(title: str, recordings: dict[str, Recording]) -> float:
    """Print the largest difference of each column from the first recording; the largest of them is returned."""
    (first, reference), *others = recordings.items()
    table = ConsoleTable(title=f"{title}: largest difference from {first}, relative", title_justify="left")
    table.add_column("variable")
    found = {}
    for name, recording in others:
        table.add_column(name, justify="right")
        found[name] = differences(reference, recording)
    for variable in reference:
        values = [column[variable] for column in found.values()]
        table.add_row(variable, *("not recorded" if v is None else f"{v:.2g}" for v in values))
    worst = {name: largest(column) for name, column in found.items()}
    table.add_section()
    table.add_row("largest", *(f"{value:.2g}" for value in worst.values()), style="bold")
    out.print(table)
    return max(worst.values())


if __name__ == "__main__":
    app(prog_name="python -m cosim")
