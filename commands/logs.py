"""The words of the command line for recorded files: how one is written, and what was found of it."""

from __future__ import annotations

from typing import Annotated

import typer

from commands.console import plain
from cosim.replay.log import Log, Rows
from cosim.replay.reading import Reading

SampleTime = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS",
        parser=plain,
        help="Seconds between the rows of a file without a column 'time'.",
        show_default=False,
    ),
]
Mapped = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="INPUT=COLUMN",
        help="The column that feeds an input, or holds the time (time=COLUMN). May be repeated.",
    ),
]
Separator = Annotated[
    str | None,
    typer.Option(help="Between the cells: ',', ';', '|', ' ' or tab.", show_default="found from the file"),
]
Decimal = Annotated[str | None, typer.Option(help="The decimal sign, '.' or ','.", show_default="found from the file")]
Encoding = Annotated[
    str | None, typer.Option(help="Of the text, such as cp1252.", show_default="UTF-8; UTF-16 by its mark")
]
Missing = Annotated[
    list[str] | None,
    typer.Option(metavar="TEXT", help="What stands for an empty cell, such as n/a or 65535. May be repeated."),
]
SkipLines = Annotated[int, typer.Option(help="Lines before that of the names that are left out.")]
SkipBadRows = Annotated[
    bool,
    typer.Option(
        "--skip-bad-rows",
        help="Leave out, and count, rows that cannot be read: not as many cells as names, no numbers, times that do not ascend.",
    ),
]

_NAMED = {",": "comma", ";": "semicolon", "\t": "tab", "|": "bar", " ": "blank"}


def reading(
    separator: str | None,
    decimal: str | None,
    encoding: str | None,
    missing: list[str] | None,
    skip_lines: int,
    skip_bad_rows: bool,
) -> Reading:
    """The options as a Reading; `tab` and `\\t` are the tabulator."""
    tab = separator is not None and separator.lower() in ("tab", "\\t")
    return Reading("\t" if tab else separator, decimal, encoding, skip_lines, skip_bad_rows, tuple(missing or ()))


def how_read(log: Log, rows: Rows) -> list[str]:
    """What was found or skipped and is not what everybody expects of a CSV file, a sentence each."""
    facts = []
    if (log.separator, log.decimal) != (",", "."):
        name = _NAMED.get(log.separator, repr(log.separator))
        facts.append(f"Read with the separator {name} and the decimal sign '{log.decimal}'.")
    if log.units_below:
        facts.append("The line under the names holds units.")
    if rows.skipped:
        facts.append(f"{rows.skipped} rows could not be read and were skipped, the first one, {rows.reason}.")
    return facts
