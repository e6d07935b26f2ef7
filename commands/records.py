"""How the verbs write down what a run yields: a table, what its codes mean, the errors of the estimates, the command that made it."""

from __future__ import annotations

import shlex
import sys
from enum import StrEnum
from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table as ConsoleTable

from commands.console import NAME, out
from cosim.report.estimates import Pair, pairs
from cosim.report.observed import deviation_of
from cosim.report.page import Table, shares
from cosim.results import Result, write_csv, write_legend, write_parquet

COLUMNS = ("estimate", "unit", "median error", "largest, second half", "last", "within 2 std, second half")


class Format(StrEnum):
    csv = "csv"
    parquet = "parquet"


def _known(text: str) -> Format:
    try:
        form = Format(text)
    except ValueError:
        raise typer.BadParameter(f"'{text}' is none of {', '.join(Format)}") from None
    if form is Format.parquet and find_spec("pyarrow") is None:
        raise typer.BadParameter("parquet needs pyarrow: pip install pyarrow")
    return form


RecordFormat = Annotated[
    Format,
    typer.Option(
        "--format",
        metavar="csv|parquet",
        parser=_known,
        help="Of the table: text, or Parquet with enumerations in words.",
    ),
]


def write_record(result: Result, directory: Path, stem: str, form: Format) -> list[Path]:
    """The table in the wanted form, and of a CSV table what the codes in it mean; the files written, the table first."""
    table = directory / f"{stem}.{form}"
    if form is Format.parquet:
        write_parquet(result, table)
        return [table]
    write_csv(result, table)
    legend = directory / f"{stem}.legend.csv"
    write_legend(result, legend)
    return [table, legend] if result.items else [table]


def command_html() -> str:
    """The command that this process is, as a paragraph; nothing where the verb was called from Python."""
    if Path(sys.argv[0]).stem != NAME:
        return ""
    return f"<p><code>{escape(shlex.join([NAME, *sys.argv[1:]]))}</code></p>"


def errors_of(result: Result) -> Table | None:
    """The errors of all estimates whose truth the result holds; None where there are none."""
    found = pairs(result)
    return Table(COLUMNS, [_row(result, pair) for pair in found]) if found else None


def _row(result: Result, pair: Pair) -> tuple[str, ...]:
    error, half = pair.error(result), len(result.time) // 2
    std = deviation_of(result, pair.estimate)
    within = f"{np.mean(error[half:] <= 2 * std[half:]):.0%}" if std is not None else "-"
    numbers = (np.median(error), np.max(error[half:]), error[-1])
    return (pair.estimate, result.units[pair.truth], *(f"{number:.2e}" for number in numbers), within)


def trusted_of(result: Result) -> list[str]:
    """A sentence for each observer: how much of the run its estimate was to be trusted, and why not in the rest."""
    told = []
    for name in result.names:
        if name.endswith(".diagnostics.trusted"):
            element, trusted = name.removesuffix(".diagnostics.trusted"), result[name] > 0.5
            rest = sorted(shares(result, f"{element}.diagnostics.status", ~trusted), key=lambda share: -share[2])
            why = ", ".join(f"{word or code} {part:.1%}" for word, code, part in rest)
            told.append(f"{element}: trusted in {trusted.mean():.1%} of the rows" + (f"; {why}" if why else ""))
    return told


def print_table(table: Table, title: str) -> None:
    """On the console: text to the left, numbers to the right."""
    shown = ConsoleTable(title=title, title_justify="left", title_style="bold")
    for head in table.columns:
        shown.add_column(head, justify="left" if head in ("estimate", "unit") else "right", no_wrap=head == "estimate")
    for row in table.rows:
        shown.add_row(*row)
    out.print(shown)
