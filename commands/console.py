"""What the commands share: where they print, how they end, how they show progress."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from cosim.errors import number, one_line, whole_number

NAME = "observer-fmus"
SHOW_PROGRESS_AFTER = 1.5  # [s]
SHORTEST_CALL = 0.1  # [s] that a call may be limited to
SHOWN = 300  # characters of what an FMU says
ELEMENT_FORM = "ELEMENT.VARIABLE=VALUE"

out = Console()
err = Console(stderr=True)

Assignments = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar=ELEMENT_FORM,
        help="Start value of a parameter or an unconnected input, such as plant.sensor.seed=7. May be repeated.",
    ),
]


def plain(text: str | float) -> float:
    """The number of an option, or its default: what a file may hold, too, and no more."""
    try:
        return number(text) if isinstance(text, str) else text
    except ValueError:
        raise typer.BadParameter(f"'{text}' is not a number") from None


def whole(text: str | int) -> int:
    """The whole number of an option, or its default, likewise."""
    try:
        return whole_number(text) if isinstance(text, str) else text
    except ValueError:
        raise typer.BadParameter(f"'{text}' is not a whole number") from None


def _call_limit(text: str | float) -> float:
    limit = plain(text)
    if not SHORTEST_CALL <= limit < math.inf:
        raise typer.BadParameter(f"{text} s is not finite or shorter than {SHORTEST_CALL:g} s")
    return limit


ParameterSet = Annotated[
    Path | None,
    typer.Option(
        "--parameters",
        metavar="FILE.ssv",
        help="Start values from a parameter set, as tune writes one, for what has all of its names; --set goes first.",
        show_default=False,
    ),
]

CallLimit = Annotated[
    float,
    typer.Option(
        "--call-limit",
        metavar="SECONDS",
        parser=_call_limit,
        help="How long a call of an FMU may take before the run is ended.",
    ),
]


def split_assignments(texts: list[str] | None, option: str = "--set", form: str = ELEMENT_FORM) -> dict[str, str]:
    """Names and values, as text, of an option of the given form, such as `--set NAME=VALUE`."""
    found = {}
    for text in texts or []:
        name, equals, value = text.partition("=")
        if not equals or not name.strip() or not value.strip():
            fail(f"{option} {text}: not of the form {form}", 2)
        found[name.strip()] = value.strip()
    return found


def say(message: str) -> None:
    """One red line on stderr."""
    err.print(Text(f"error: {one_line(message)}", style="red"), soft_wrap=True)


def fail(message: str, code: int) -> NoReturn:
    """End with one red line; `code` is 2 for a user's mistake, 1 for a failed run."""
    say(message)
    raise typer.Exit(code)


@contextmanager
def late_progress() -> Iterator[Callable[[int, int], None]]:
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
