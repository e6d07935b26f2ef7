"""observer-fmus replay: an observer over a recorded file."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Annotated, NoReturn

import numpy as np
import typer
from rich.text import Text

from commands.console import SHOWN, CallLimit, ParameterSet, fail, late_progress, out, split_assignments
from commands.logs import AS_IT_IS, Mapped, SampleTime, how_read, mapping_of, reads_logs
from commands.records import Format, RecordFormat, command_html, trusted_of, write_record
from cosim.errors import ExperimentError, SystemFileError, one_line
from cosim.fmu import Value, read_description
from cosim.master.slave import RunError
from cosim.master.watched import LIMIT
from cosim.replay import Replay
from cosim.replay import replay as perform
from cosim.replay.reading import Reading
from cosim.report.page import Table, on_run, write_report
from cosim.system.parameter_set import parameters_of

JITTER = 1e-3  # of the sample time: rows farther from their sample instants are worth a word


@reads_logs
def replay(
    fmu: Annotated[Path, typer.Argument(help="The observer, an .fmu file.", show_default=False)],
    log: Annotated[
        Path,
        typer.Argument(
            help="The recorded file, .csv or .csv.gz: columns named like the FMU's inputs, and 'time'; units as in 'v \\[mV]'.",
            show_default=False,
        ),
    ],
    out_directory: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", help="Where the files go.", show_default="results/<name of the FMU>_replay"
        ),
    ] = None,
    sample_time: SampleTime = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="VARIABLE=VALUE",
            help="Start value of a parameter, or the constant value of an input without a column. May be repeated.",
        ),
    ] = None,
    parameters: ParameterSet = None,
    mapped: Mapped = None,
    reading: Reading = AS_IT_IS,
    form: RecordFormat = Format.csv,
    limit: CallLimit = LIMIT,
) -> None:
    """Run an observer over a recorded file; write estimates.csv (all outputs at each sample instant), what its codes mean, and report.html.

    \b
    Example:
      observer-fmus replay fmus/duffing_ukf.fmu log.csv --map y=position
    """
    directory = out_directory or Path("results") / f"{fmu.stem}_replay"
    overrides: dict[str, Value] = {**split_assignments(assignments, "--set", "VARIABLE=VALUE")}
    try:
        if parameters is not None:
            overrides = parameters_of(parameters, read_description(fmu)) | overrides
        with late_progress() as progress:
            made = perform(
                fmu,
                log,
                sample_time=sample_time,
                mapping=mapping_of(mapped),
                reading=reading,
                overrides=overrides,
                progress=progress,
                limit=limit,
            )
    except (SystemFileError, ExperimentError) as error:
        fail(str(error), 2)
    except RunError as error:
        _keep_partial(error, directory, form)
    facts = _facts(made)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        files = write_record(made.result, directory, "estimates", form)
        intro = command_html() + "".join(f"<p>{escape(fact)}</p>" for fact in facts)
        write_report(
            directory / "report.html",
            made.result.system,
            intro,
            [_inputs(made)],
            [on_run("The replay", "", made.result)],
        )
    except OSError as error:
        fail(f"cannot write to {directory}: {error.strerror or error}", 2)
    for fact in (*facts, *trusted_of(made.result)):
        out.print(Text(fact), soft_wrap=True)
    for file in (*files, directory / "report.html"):
        out.print(Text(str(file)), soft_wrap=True)


def _keep_partial(error: RunError, directory: Path, form: Format) -> NoReturn:
    """End with the reason why the FMU failed, and the rows up to there in estimates.csv."""
    if error.partial is None or not len(error.partial.time):
        fail(str(error), 1)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        table, *_ = write_record(error.partial, directory, "estimates", form)
    except OSError as problem:
        fail(f"{error}; cannot write to {directory}: {problem.strerror or problem}", 2)
    fail(f"{error} (the record up to there is in {table})", 1)


def _facts(made: Replay) -> list[str]:
    """What a reader must know of how the log met the FMU, a sentence each."""
    taken = made.sampling
    there = taken.rows >= 0
    facts = [f"{len(taken.rows)} samples of {taken.sample_time:g} s from t = {taken.start:g} s."]
    facts += how_read(made.log, made.rows)
    facts += [f"Input {name}: {given} became {wanted}." for name, (given, wanted) in made.signals.converted.items()]
    facts += [
        f"Input {name} has no unit: its column, in {unit}, was taken as it is."
        for name, unit in made.signals.unchecked.items()
    ]
    if not there.all():
        facts.append(f"{int(np.sum(~there))} of them have no row within half a sample time: given as missing.")
    largest = np.abs(taken.offsets).max() / taken.sample_time
    if largest > JITTER:
        facts.append(
            f"Rows lie up to {largest:.1%} of the sample time away from the sample instants they were taken for."
        )
    unused = made.recorded - int(np.sum(there))
    if unused:
        facts.append(
            f"{unused} of {made.recorded} rows lie farther from every sample instant than another and were left out."
        )
    for name, count in made.empty.items():
        if count:
            facts.append(f"Input {name} was missing (NaN) in {count} samples.")
    for name, count in made.held.items():
        if count:
            facts.append(f"Input {name} was empty in {count} samples and kept its last value.")
    if made.ignored:
        facts.append(f"Columns that feed no input were ignored: {', '.join(made.ignored)}.")
    if made.kept:
        facts.append(f"Inputs without a column kept their value: {', '.join(made.kept)}.")
    warnings = [message for message in made.result.messages if message.status != "ok"]
    if warnings:
        facts.append(f"The FMU warned {len(warnings)} times, first: {one_line(warnings[0].text, SHOWN)}")
    return facts


def _inputs(made: Replay) -> Table:
    rows = [(n, c, str(made.empty[n] + made.held.get(n, 0))) for n, c in made.columns.items()]
    return Table(("input", "column", "missing samples"), rows)
