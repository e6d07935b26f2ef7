"""observer-fmus compare: one system in several tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table as ConsoleTable

from commands.console import CallLimit, fail, out
from commands.records import command_html
from cosim.errors import ExperimentError, SystemFileError
from cosim.master.slave import RunError
from cosim.master.watched import LIMIT as CALL_LIMIT
from cosim.masters.comparison import LIMIT, MASTERS, record_all
from cosim.masters.experiment import MasterError, Recording
from cosim.masters.report import table, write_comparison
from cosim.results import write_columns


def compare(
    system: Annotated[Path, typer.Argument(help="The system to run, an .ssp file.", show_default=False)],
    masters: Annotated[
        str, typer.Option(metavar="NAMES", help="The tools that run it; the first is what the others are compared to.")
    ] = ",".join(MASTERS),
    out_directory: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", help="Where <tool>.csv of each and report.html go.", show_default="not written"
        ),
    ] = None,
    limit: CallLimit = CALL_LIMIT,
) -> None:
    """Run a system in several tools; print the largest difference of each variable. Fails above 1e-12 (relative).

    \b
    Example:
      observer-fmus compare systems/gong_example_1.ssp --masters fmpy,ecos
    """
    try:
        recordings = record_all(system, [name.strip() for name in masters.split(",")], limit)
    except (SystemFileError, ExperimentError) as error:
        fail(str(error), 2)
    except (RunError, MasterError) as error:
        fail(str(error), 1)
    if out_directory is not None:
        try:
            out_directory.mkdir(parents=True, exist_ok=True)
            for name, recording in recordings.items():
                write_columns(recording, out_directory / f"{name}.csv")
            write_comparison(
                out_directory / "report.html", f"{system.stem} in several tools", command_html(), recordings
            )
        except OSError as error:
            fail(f"cannot write to {out_directory}: {error.strerror or error}", 2)
    worst = _print_differences(system.stem, recordings)
    if not worst <= LIMIT:
        fail(f"{system}: the tools differ by {worst:.2g}, more than {LIMIT:g}", 1)


def _print_differences(title: str, recordings: dict[str, Recording]) -> float:
    """Print the largest difference of each column from the first recording; the largest of them is returned."""
    found, worst = table(recordings)
    shown = ConsoleTable(title=f"{title}: largest difference", title_justify="left")
    for i, head in enumerate(found.columns):
        shown.add_column(head, justify="right" if i else "left")
    *rows, last = found.rows
    for row in rows:
        shown.add_row(*row)
    shown.add_section()
    shown.add_row(*last, style="bold")
    out.print(shown)
    return worst
