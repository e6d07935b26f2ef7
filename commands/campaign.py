"""observer-fmus campaign: one system many times."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table as ConsoleTable
from rich.text import Text

from commands.console import Assignments, CallLimit, ParameterSet, err, fail, out, plain, split_assignments, whole
from commands.records import command_html
from cosim.campaign.run import SETTLE
from cosim.campaign.variation import parse
from cosim.errors import ExperimentError, SystemFileError
from cosim.fmu import Value
from cosim.master.watched import LIMIT
from cosim.system.parameter_set import parameters_in_system

if TYPE_CHECKING:
    from cosim.campaign.campaign import Campaign

REPORT, PICTURE = "report.html", "figure.svg"


def campaign(
    system: Annotated[Path, typer.Argument(help="The system to run, an .ssp file.", show_default=False)],
    runs: Annotated[int, typer.Option(metavar="COUNT", parser=whole, help="How many runs.", show_default=False)],
    vary: Annotated[
        list[str],
        typer.Option(
            metavar="ELEMENT.VARIABLE[=LOW:HIGH]",
            help="What varies: uniformly between two bounds, or, without them, whole numbers that are distinct in all runs. "
            "May be repeated.",
            show_default=False,
        ),
    ],
    assignments: Assignments = None,
    parameters: ParameterSet = None,
    out_directory: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="The campaign's folder.", show_default="results/<file>_campaign"),
    ] = None,
    seed: Annotated[int, typer.Option(metavar="NUMBER", parser=whole, help="Seed of the random values.")] = 0,
    stop: Annotated[
        float | None, typer.Option(metavar="SECONDS", parser=plain, help="Stop time.", show_default="the system's")
    ] = None,
    settle: Annotated[
        float,
        typer.Option(
            metavar="SECONDS",
            parser=plain,
            help="Seconds after the start and each jump of a true parameter that do not count as settled.",
        ),
    ] = SETTLE,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="A Dask scheduler.", show_default="processes on this machine"),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            metavar="COUNT", parser=whole, help="Processes on this machine.", show_default="one for each processor"
        ),
    ] = None,
    limit: CallLimit = LIMIT,
    dashboard: Annotated[
        bool,
        typer.Option("--dashboard", help="Dask's page about its processes, at http://127.0.0.1:8787; wants bokeh."),
    ] = False,
) -> None:
    """Run a system many times with varied values; write runs.csv (a line a run), figure.svg and report.html.

    A campaign that was stopped goes on where it was when the same command is given again.

    \b
    Example:
      observer-fmus campaign systems/gong_example_5.ssp --runs 100 \\
        --vary plant.start.x1=-1:1 --vary plant.sensor.seed
    """
    # Dask takes longer to load than a run takes: only this command waits for it.
    from cosim.campaign.campaign import campaign as perform
    from cosim.campaign.picture import write_picture
    from cosim.campaign.report import succeeded, write_campaign_report

    directory = out_directory or Path("results") / f"{system.stem}_campaign"
    columns = (TextColumn("runs"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    overrides: dict[str, Value] = {**split_assignments(assignments)}
    try:
        if parameters is not None:
            overrides = parameters_in_system(parameters, system) | overrides
        with Progress(*columns, console=err, transient=True, disable=not err.is_terminal) as display:
            task = display.add_task("runs", total=runs)
            made = perform(
                system,
                directory,
                runs=runs,
                vary=parse(vary),
                overrides=overrides,
                seed=seed,
                stop=stop,
                settle=settle,
                scheduler=scheduler,
                workers=workers,
                limit=limit,
                dashboard=dashboard,
                progress=lambda done, total: display.update(task, completed=done, total=total),
            )
        write_campaign_report(made, directory / REPORT, command_html())
        if succeeded(made):
            write_picture(made, directory / PICTURE)
    except (SystemFileError, ExperimentError) as error:
        fail(str(error), 2)
    except OSError as error:
        fail(f"cannot write to {directory}: {error.strerror or error}", 2)
    except KeyboardInterrupt:
        fail(f"stopped; the finished runs are in {directory}, and the same command goes on from there", 130)
    _summarise(made, directory)


def _summarise(made: Campaign, directory: Path) -> None:
    from cosim.campaign.campaign import TABLE
    from cosim.campaign.report import counts, settled_means, succeeded, summary

    found = summary(made)
    table = ConsoleTable(
        title=made.system,
        title_justify="left",
        title_style="bold",
        box=SIMPLE_HEAD,
        pad_edge=False,
        collapse_padding=True,
    )
    for head in found.columns:
        table.add_column(head, justify="left" if head in ("estimate", "unit") else "right")
    for row in found.rows:
        table.add_row(*row)
    if succeeded(made):
        out.print(table)
        out.print(settled_means(made), soft_wrap=True)
    out.print(", ".join(f"{number} {label}" for label, number in counts(made).items()), soft_wrap=True)
    for file in (TABLE, *((PICTURE,) if succeeded(made) else ()), REPORT):
        out.print(Text(str(directory / file)), soft_wrap=True)
    failures = [outcome for outcome in made.outcomes if outcome.failure]
    if failures:
        first = failures[0]
        fail(f"{len(failures)} of {len(made.outcomes)} runs failed, the first, run {first.run}: {first.failure}", 1)
