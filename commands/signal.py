"""observer-fmus signal: a recorded file becomes an FMU that plays it."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.markup import escape

from commands.console import err, fail, out, split_assignments
from commands.logs import AS_IT_IS, SampleTime, how_read, reads_logs
from cosim.errors import ExperimentError
from cosim.replay import units
from cosim.replay.log import Column, Log, read_log
from cosim.replay.reading import Reading
from cosim.replay.signals import TIME, read, time_column, times
from fmu_src import ExportError, export
from fmu_src.description.units import parse as parse_unit
from observers.component import Port
from reference_models.recorded import BETWEEN, Signal, recorded

_NAME = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*\Z", re.ASCII)


@reads_logs
def signal(
    log: Annotated[
        Path,
        typer.Argument(
            help="The file, .csv or .csv.gz: a column 'time', and one for each output; units as in 'v \\[mV]'.",
            show_default=False,
        ),
    ],
    name: Annotated[
        str | None, typer.Option(help="Of the FMU.", show_default="the name of the file before its first point")
    ] = None,
    between: Annotated[
        str, typer.Option(help="Between two rows: held (the value of the earlier one) or linear (a straight line).")
    ] = "held",
    mapped: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            metavar="OUTPUT=COLUMN",
            help="An output and its column, or the time (time=COLUMN). May be repeated; the other columns are then left out.",
            show_default="an output for each column",
        ),
    ] = None,
    sample_time: SampleTime = None,
    platforms: Annotated[
        str, typer.Option(help="As of build: host, all, or names of platforms, with commas.")
    ] = "host",
    out_directory: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the FMU.")] = Path("fmus"),
    reading: Reading = AS_IT_IS,
) -> None:
    """Make an FMU whose outputs follow the columns of a recorded file: the same file, the same bytes.

    Before the first row an output has the value of its parameter start.<output> (that of the first row, unless set); after the last row
    it keeps that one's. At an empty cell it goes on from the value before to the one after, as between two rows.

    \b
    Example:
      observer-fmus signal drive.csv --between linear --map u=torque
    """
    name = name or log.name.partition(".")[0]
    if not _NAME.match(name) or "." in name:
        fail(f"--name {name}: letters, digits and _ name an FMU, and no digit first", 2)
    if between not in BETWEEN:
        fail(f"--between {between}: must be {' or '.join(BETWEEN)}", 2)
    mapping = split_assignments(mapped, "--map", "OUTPUT=COLUMN")
    try:
        found = read_log(log, reading)
        signals, facts = _signals(found, mapping, sample_time)
        with err.status(escape(f"building {name}")):
            component = recorded(name, signals, between, source=log.name)
            path = export(component, out_directory, [platform.strip() for platform in platforms.split(",")])
    except OSError as error:
        fail(f"cannot write to {out_directory}: {error.strerror or error}", 2)
    except (ExperimentError, ExportError, ValueError) as error:
        fail(str(error), 2)
    for fact in facts:
        out.print(fact, markup=False, soft_wrap=True)
    out.print(f"{os.path.relpath(path)}  {path.stat().st_size / 1024:.0f} KiB", markup=False, soft_wrap=True)


def _signals(log: Log, mapping: dict[str, str], sample_time: float | None) -> tuple[tuple[Signal, ...], list[str]]:
    """The signals of the columns, and what is to be said of how the file was read.

    Raises:
        ExperimentError: the file cannot be read; a name that is none; a unit that FMI does not write.
    """
    clock = time_column(log, mapping, sample_time)
    columns = {output: log.column(column) for output, column in mapping.items() if output != TIME} or {
        column.name: column for column in log.columns if column.head and column != clock
    }
    for output, column in columns.items():
        if not _NAME.match(output):
            raise ExperimentError(
                f"{log.path}: '{output}' cannot be the name of an output: letters, digits and _, with points between; "
                f"--map NAME={column.head} gives the column one"
            )
    try:
        rows = read(log, clock, {column: log.number() for column in columns.values()})
    except ExperimentError as error:
        raise ExperimentError(f"{error}; --map OUTPUT=COLUMN takes the columns that it names only") from None
    instants, signals, facts = times(log, clock, rows, sample_time), [], how_read(log, rows)
    for output, column in columns.items():
        values = rows.values[column.head]
        there = ~np.isnan(values)
        if not there.all():
            facts.append(f"Output {output}: {int((~there).sum())} of {len(values)} cells are empty.")
        signals.append(Signal(_variable(log, output, column), instants[there], values[there]))
    return tuple(signals), facts


def _variable(log: Log, output: str, column: Column) -> Port:
    """The output's name and unit; a unit that means nothing to FMI is refused."""
    unit = units.expression(column.unit)
    if unit:
        try:
            parse_unit(unit)
        except ValueError as error:
            raise ExperimentError(
                f"{log.path}: the unit '{column.unit}' of the column '{column.head}' is none that an FMU can declare ({error})"
            ) from None
    return Port(output, f"column '{column.head}' of {log.path.name}", unit)
