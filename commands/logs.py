"""The words of the command line for recorded files: how one is written, and what was found of it."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Annotated, Any

import typer

from commands.console import plain, split_assignments, whole
from cosim.replay.log import Log, Rows
from cosim.replay.reading import Reading


def _lines(text: str | int) -> int:
    count = whole(text)
    if count < 0:
        raise typer.BadParameter(f"{count} lines cannot be left out")
    return count


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
SkipLines = Annotated[
    int, typer.Option(metavar="COUNT", parser=_lines, help="Lines before that of the names that are left out.")
]
SkipBadRows = Annotated[
    bool,
    typer.Option(
        "--skip-bad-rows",
        help="Leave out, and count, rows that cannot be read: not as many cells as names, no numbers, times that do not ascend.",
    ),
]

_NAMED = {",": "comma", ";": "semicolon", "\t": "tab", "|": "bar", " ": "blank"}


AS_IT_IS = Reading()


def _reading(
    separator: Separator = None,
    decimal: Decimal = None,
    encoding: Encoding = None,
    missing: Missing = None,
    skip_lines: SkipLines = 0,
    skip_bad_rows: SkipBadRows = False,
) -> Reading:
    """The options as a Reading; `tab` and `\\t` are the tabulator."""
    tab = separator is not None and separator.lower() in ("tab", "\\t")
    return Reading("\t" if tab else separator, decimal, encoding, skip_lines, skip_bad_rows, tuple(missing or ()))


def reads_logs(verb: Callable[..., None]) -> Callable[..., None]:
    """The verb with the options of `_reading` on the command line, in the place of its parameter `reading`."""
    own = inspect.signature(verb, eval_str=True).parameters
    options = inspect.signature(_reading, eval_str=True).parameters

    def with_options(**given: Any) -> None:
        reading = _reading(**{name: given.pop(name) for name in options})
        verb(**given, reading=reading)

    shown = [one for name, p in own.items() for one in (options.values() if name == "reading" else (p,))]
    parameters = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in shown]
    with_options.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    with_options.__annotations__ = {p.name: p.annotation for p in parameters}
    with_options.__name__, with_options.__doc__ = verb.__name__, verb.__doc__
    return with_options


def mapping_of(mapped: list[str] | None) -> dict[str, str]:
    """The option --map: columns by input."""
    return split_assignments(mapped, "--map", "INPUT=COLUMN")


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
