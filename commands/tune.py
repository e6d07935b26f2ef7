"""observer-fmus tune: the noises of an observer from recorded files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table as ConsoleTable
from rich.text import Text

from commands.console import CallLimit, fail, late_progress, out, split_assignments, whole
from commands.logs import AS_IT_IS, Mapped, SampleTime, mapping_of, reads_logs
from commands.records import command_html
from cosim.errors import ExperimentError, SystemFileError
from cosim.master.slave import RunError
from cosim.master.watched import LIMIT
from cosim.replay.reading import Reading

if TYPE_CHECKING:
    from cosim.tuning import Tuned


def _ahead(text: str | int) -> int:
    samples = whole(text)
    if samples < 1:
        raise typer.BadParameter(f"{samples} samples: 1 is the least")
    return samples


@reads_logs
def tune(
    fmu: Annotated[Path, typer.Argument(help="The observer, an .fmu file.", show_default=False)],
    logs: Annotated[
        list[Path],
        typer.Argument(help="Recorded files, as for replay, all with the same columns.", show_default=False),
    ],
    out_file: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE.ssv",
            help="The parameter set that is written: replay, run, campaign and build take it, and SSP tools do.",
            show_default="results/<name of the FMU>.ssv",
        ),
    ] = None,
    ahead: Annotated[
        int | None,
        typer.Option(
            metavar="SAMPLES",
            parser=_ahead,
            help="Make the error so many samples ahead small, not the likelihood of the innovations large.",
            show_default="the likelihood; 1 where the observer has none",
        ),
    ] = None,
    parameters: Annotated[
        Path | None,
        typer.Option(metavar="FILE.ssv", help="Start the search from these values.", show_default="the FMU's own"),
    ] = None,
    sample_time: SampleTime = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="VARIABLE=VALUE",
            help="Start value of a parameter, or the constant value of an input without a column; a noise that is set is not tuned. "
            "May be repeated.",
        ),
    ] = None,
    mapped: Mapped = None,
    reading: Reading = AS_IT_IS,
    limit: CallLimit = LIMIT,
    report: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="Where the report goes.", show_default="beside the parameter set"),
    ] = None,
) -> None:
    """Find an observer's process noise, measurement noise and initial deviations from recorded files; write them as a parameter set.

    \b
    Example:
      observer-fmus tune fmus/duffing_ukf.fmu log.csv --set u=0 --out tuned.ssv
    """
    # scipy's optimisers take a moment to load: only this command waits for them.
    from cosim.tuning import tune as perform
    from cosim.tuning.report import write_tuning
    from cosim.tuning.tune import write

    path = out_file or Path("results") / f"{fmu.stem}.ssv"
    try:
        with late_progress() as progress:
            made = perform(
                fmu,
                logs,
                ahead=ahead or 0,
                sample_time=sample_time,
                mapping=mapping_of(mapped),
                reading=reading,
                overrides=split_assignments(assignments, "--set", "VARIABLE=VALUE"),
                parameters=parameters,
                progress=progress,
                limit=limit,
            )
    except (SystemFileError, ExperimentError) as error:
        fail(str(error), 2)
    except RunError as error:
        fail(str(error), 1)
    except KeyboardInterrupt:
        fail("stopped; nothing was written", 130)
    page = report or path.with_suffix(".html")
    try:
        write(made, fmu, path)
        write_tuning(page, f"{fmu.stem} tuned", command_html(), made)
    except OSError as error:
        fail(f"cannot write to {error.filename or path}: {error.strerror or error}", 2)
    _show(made)
    for file in (path, page):
        out.print(Text(str(file)), soft_wrap=True)


def _show(made: Tuned) -> None:
    from cosim.tuning.report import facts, values, worth

    for table in (values(made), worth(made)):
        shown = ConsoleTable(box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
        for head in table.columns:
            shown.add_column(head, justify="left" if head in ("", "unit") else "right")
        for row in table.rows:
            shown.add_row(*row)
        out.print(shown)
    for fact in facts(made):
        out.print(Text(fact), soft_wrap=True)
    for warning in made.warnings:
        out.print(Text(f"warning: {warning}", style="yellow"), soft_wrap=True)
