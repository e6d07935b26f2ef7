"""observer-fmus tune: the noises of an observer from recorded files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from commands.console import CallLimit, fail, late_progress, out, split_assignments
from commands.logs import Decimal, Encoding, Mapped, Missing, SampleTime, Separator, SkipBadRows, SkipLines, reading
from cosim.errors import ExperimentError, SystemFileError
from cosim.master.slave import RunError
from cosim.master.watched import LIMIT

if TYPE_CHECKING:
    from cosim.tuning import Tuned


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
            min=1,
            metavar="SAMPLES",
            help="Make the error so many samples ahead small, not the likelihood of the innovations large.",
            show_default="the likelihood; 1 where the observer has none",
        ),
    ] = None,
    parameters: Annotated[
        Path | None,
        typer.Option(metavar="FILE.ssv", help="Start the search from these values.", show_default="the FMU's own"),
    ] = None,
    sample_time: SampleTime = None,
    mapped: Mapped = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="VARIABLE=VALUE",
            help="Start value of a parameter, or the constant value of an input without a column; a noise that is set is not tuned. "
            "May be repeated.",
        ),
    ] = None,
    separator: Separator = None,
    decimal: Decimal = None,
    encoding: Encoding = None,
    missing: Missing = None,
    skip_lines: SkipLines = 0,
    skip_bad_rows: SkipBadRows = False,
    limit: CallLimit = LIMIT,
) -> None:
    """Find an observer's process noise, measurement noise and initial deviations from recorded files; write them as a parameter set.

    \b
    Example:
      observer-fmus tune fmus/duffing_ukf.fmu log.csv --set u=0 --out tuned.ssv
    """
    # scipy's optimisers take a moment to load: only this command waits for them.
    from cosim.tuning import tune as perform
    from cosim.tuning.tune import write

    path = out_file or Path("results") / f"{fmu.stem}.ssv"
    try:
        with late_progress() as progress:
            made = perform(
                fmu,
                logs,
                ahead=ahead or 0,
                sample_time=sample_time,
                mapping=split_assignments(mapped, "--map", "INPUT=COLUMN"),
                reading=reading(separator, decimal, encoding, missing, skip_lines, skip_bad_rows),
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
    try:
        write(made, fmu, path)
    except OSError as error:
        fail(f"cannot write to {path}: {error.strerror or error}", 2)
    _show(made)
    out.print(Text(str(path)), soft_wrap=True)


def _show(made: Tuned) -> None:
    values = _table("", "unit", "before", "after", "known to")
    for p in made.parameters:
        said = made.deviations[p.name]
        known = f"{math.expm1(said):.0%}" if said < math.log(2) else "-"
        values.add_row(p.name, p.unit, f"{p.start:.4g}", f"{made.values[p.name]:.4g}", known)
    out.print(values)
    worth = _table("", "fitted part before", "after", "held-back part before", "after")
    for row in _worth(made):
        worth.add_row(*row)
    out.print(worth)
    facts = [f"{made.evaluations} replays of the fitted part, {made.fitted.after.samples} measurements."]
    if made.zeros:
        facts.append(
            f"Noises of 0 were left at it: {', '.join(made.zeros)}; --parameters with another value tunes them."
        )
    for fact in facts:
        out.print(Text(fact), soft_wrap=True)
    for warning in made.warnings:
        out.print(Text(f"warning: {warning}", style="yellow"), soft_wrap=True)


def _table(*heads: str) -> Table:
    table = Table(box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for head in heads:
        table.add_column(head, justify="left" if head in ("", "unit") else "right")
    return table


def _worth(made: Tuned) -> list[tuple[str, ...]]:
    """What the noises are worth: the likelihood or the errors, the size of the innovations, whether they are white."""
    judged = [one for part in (made.fitted, made.held_back) for one in (part.before, part.after)]
    tested = [one for part in (made.fitted, made.held_back) for one in (part.consistent_before, part.consistent_after)]
    rows: list[tuple[str, ...]] = []
    if made.ahead:
        for name in judged[0].rms:
            rows.append((f"error of {name} {made.ahead} ahead, rms", *(f"{one.rms[name]:.4g}" for one in judged)))
    else:
        values = (one.value / max(one.samples, 1) for one in judged)
        rows.append(("log-likelihood a measurement", *(f"{value:.4f}" for value in values)))
    if not math.isnan(tested[0].nis):
        rows.append(("mean of NIS, 1 if consistent", *(f"{one.nis:.3f}" for one in tested)))
        rows.append(("its 95 % band", *(f"{one.band[0]:.3f} to {one.band[1]:.3f}" for one in tested)))
    rows.append(("whiteness, p-value", *(f"{one.whiteness:.2g}" for one in tested)))
    return rows
