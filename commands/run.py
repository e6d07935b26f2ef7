"""observer-fmus run: a system once, its record and a report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table as ConsoleTable
from rich.text import Text

from commands.console import (
    SHOWN,
    Assignments,
    CallLimit,
    ParameterSet,
    fail,
    late_progress,
    out,
    plain,
    split_assignments,
)
from commands.records import Format, RecordFormat, command_html, errors_of, print_table, trusted_of, write_record
from cosim.errors import ExperimentError, SystemFileError, one_line
from cosim.fmu import Value
from cosim.master.slave import RunError
from cosim.master.watched import LIMIT
from cosim.master.watched import run as run_system
from cosim.report.page import Table, on_run, write_report
from cosim.results import Result
from cosim.system.parameter_set import parameters_in_system


def run(
    system: Annotated[Path, typer.Argument(help="The system to run, an .ssp file.", show_default=False)],
    out_directory: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Where the files go.", show_default="results/<name of the file>"),
    ] = None,
    assignments: Assignments = None,
    parameters: ParameterSet = None,
    input_file: Annotated[
        Path | None,
        typer.Option(
            "--input",
            metavar="FILE.csv",
            help="Values of the system's input connectors and of unconnected inputs: a column `time`, then one by the name of each.",
        ),
    ] = None,
    stop: Annotated[
        float | None, typer.Option(metavar="SECONDS", parser=plain, help="Stop time.", show_default="the system's")
    ] = None,
    step: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", parser=plain, help="Communication step size.", show_default="the system's"),
    ] = None,
    form: RecordFormat = Format.csv,
    limit: CallLimit = LIMIT,
) -> None:
    """Run a system once; write results.csv (all outputs of all FMUs), what its codes mean, and report.html (figures).

    \b
    Example:
      observer-fmus run systems/gong_example_1.ssp --set plant.sensor.seed=7
    """
    directory = out_directory or Path("results") / system.stem
    overrides: dict[str, Value] = {**split_assignments(assignments)}
    try:
        if parameters is not None:
            overrides = parameters_in_system(parameters, system) | overrides
        with late_progress() as progress:
            result = run_system(
                system,
                stop=stop,
                step=step,
                overrides=overrides,
                inputs=input_file,
                progress=progress,
                limit=limit,
            )
        failure = None
    except (SystemFileError, ExperimentError) as error:
        fail(str(error), 2)
    except RunError as error:
        if error.partial is None or not len(error.partial.time):
            fail(str(error), 1)
        result, failure = error.partial, error
    errors, report = errors_of(result), directory / "report.html"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        files = write_record(result, directory, "results", form)
        if failure is None:
            _write_report(result, errors, report)
    except OSError as error:
        fail(f"cannot write to {directory}: {error.strerror or error}", 2)
    if failure is not None:
        fail(f"{failure} (the record up to there is in {files[0]})", 1)
    _summarise(result, errors, [*files, report])


def _write_report(result: Result, errors: Table | None, path: Path) -> None:
    intro = f"<p>{len(result.time) - 1} communication steps of {result.step:g} s up to t = {result.time[-1]:g} s.</p>"
    write_report(
        path, result.system, command_html() + intro, [errors] if errors else [], [on_run("The run", "", result)]
    )


def _summarise(result: Result, errors: Table | None, files: Sequence[Path]) -> None:
    if errors is not None:
        print_table(errors, result.system)
    for sentence in trusted_of(result):
        out.print(Text(sentence), soft_wrap=True)
    table = ConsoleTable(title="Computing time", title_justify="left", title_style="bold")
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
        told = f"{len(warnings)} {noun}, the first by {first.element}: {one_line(first.text, SHOWN)}"
        out.print(Text(told, style="yellow"), soft_wrap=True)
    for note in result.notes:
        out.print(Text(f"note: {one_line(note, SHOWN)}", style="yellow"), soft_wrap=True)
    for file in files:
        out.print(Text(str(file)), soft_wrap=True)
