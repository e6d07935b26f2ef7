"""observer-fmus build: the catalogue, or the FMUs of a user's own model. `python build_fmus.py` does the same."""

from __future__ import annotations

import os
import warnings
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from build_fmus import build_all, build_of, choose, with_parameters
from commands.console import err, fail
from fmu_src import ExportError, ExportWarning


def build(
    only: Annotated[
        list[str] | None, typer.Option(help="An FMU or a system of the catalogue; can be given several times.")
    ] = None,
    platforms: Annotated[
        str,
        typer.Option(
            help="host, all, or some of linux64, win64, darwin64, aarch64-linux, aarch64-darwin, with commas."
        ),
    ] = "host",
    out: Annotated[Path, typer.Option(help="Folder for the FMUs; the systems go into 'systems' beside it.")] = Path(
        "fmus"
    ),
    target: Annotated[
        str, typer.Option(help="native: C without dependencies; python: a PythonFMU, which needs Python in the tool.")
    ] = "native",
    parameters: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.ssv",
            help="A parameter set, as tune writes one: its values become the start values of the FMU that has all of its names.",
            show_default=False,
        ),
    ] = None,
    file: Annotated[
        Path | None,
        typer.Option(
            help="A Python file: builds the Components that it defines, and a system of each observer with its plant."
        ),
    ] = None,
) -> None:
    """Build the catalogue's FMUs and systems, or the FMUs of your own model.

    \b
    Example:
      observer-fmus build --file my_model.py --platforms all
    """
    if file is not None and only:
        fail("--file and --only exclude each other", 2)
    try:
        with err.status(escape(f"working out what {file} defines")) if file is not None else nullcontext():
            work = build_of(file) if file is not None else choose(only or [])
            if parameters is not None:
                work = with_parameters(work, parameters)
    except (ValueError, KeyError) as error:
        fail(str(error.args[0]), 2)
    except KeyboardInterrupt:
        fail("stopped; nothing was built", 130)
    try:
        columns = (
            TextColumn("{task.description:<32}"),
            BarColumn(),
            TextColumn("{task.completed}/{task.total}"),
            TimeElapsedColumn(),
        )
        with (
            warnings.catch_warnings(record=True) as notes,
            Progress(*columns, console=err, disable=not err.is_terminal) as bar,
        ):
            warnings.simplefilter("always", ExportWarning)
            task = bar.add_task("", total=len(work.fmus) + len(work.systems))
            written = build_all(
                work,
                out,
                [name.strip() for name in platforms.split(",")],
                lambda name, done, total: bar.update(task, description=name, completed=done, total=total),
                target,
            )
    except OSError as error:
        fail(f"cannot write to {out}: {error.strerror or error}", 2)
    except (ExportError, ValueError) as error:
        fail(str(error), 2)
    except KeyboardInterrupt:
        fail(f"stopped; what was finished is in {out}", 130)
    for path in written:
        print(f"{os.path.relpath(path)}  {path.stat().st_size / 1024:.0f} KiB")
    for note in (*work.notes, *(one.message for one in notes)):
        err.print(f"note: {note}", style="yellow", markup=False, highlight=False, soft_wrap=True)
