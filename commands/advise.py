"""observer-fmus advise: which observer for a model, how often it samples, and what it is worth."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeVar

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table as ConsoleTable
from rich.text import Text

from commands.console import err, fail, plain, say, split_assignments
from commands.logs import AS_IT_IS, Mapped, mapping_of, reads_logs
from commands.records import command_html
from cosim.errors import number
from cosim.interrupts import interrupts_noticed
from cosim.replay.reading import Reading
from cosim.report.page import Table
from observers.component import Component
from observers.model import Model, Variable
from observers.user_file import namespace_of

if TYPE_CHECKING:
    from advice.advise import Advice
    from advice.report import Advised

WIDE = 140  # columns of what is not read on a terminal
TUNING = "tuning.measurement_noise."

T = TypeVar("T")

out = Console(width=None if sys.stdout.isatty() else WIDE, highlight=False)


@reads_logs
def advise(
    file: Annotated[Path, typer.Argument(help="A Python file that defines a Model.", show_default=False)],
    log: Annotated[
        Path | None,
        typer.Option(
            help="A recorded file, .csv or .csv.gz, with columns named like the outputs and inputs: errors are then of predicting it."
        ),
    ] = None,
    noise: Annotated[
        list[str] | None,
        typer.Option(
            metavar="OUTPUT=STD",
            help="Standard deviation of a sample, in the output's unit. May be repeated.",
            show_default="the file's observer's, or 1 % of the nominal value",
        ),
    ] = None,
    sample_time: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            parser=plain,
            help="Seconds between samples, or between the rows of a log without times.",
            show_default="by the model, or the log's",
        ),
    ] = None,
    mapped: Mapped = None,
    reading: Reading = AS_IT_IS,
    report: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="Where the report goes.", show_default="results/<file>_advice.html"),
    ] = None,
) -> None:
    """Try every observer that applies to your model on the same noisy and faulty data, and say which to take.

    \b
    Example:
      observer-fmus advise my_model.py --noise y=0.01
    """
    given = {
        name: _number(f"--noise {name}", text)
        for name, text in split_assignments(noise, "--noise", "OUTPUT=STD").items()
    }
    if sample_time is not None and not 1e-6 <= sample_time < 1e6:
        fail(f"--sample-time {sample_time:g} must be between 1e-06 and 1e+06", 2)
    mapping = mapping_of(mapped)
    if log is None and (mapping or reading != AS_IT_IS):
        fail("how a log is read is said, but there is none: give --log", 2)
    path = report or Path("results") / f"{file.stem}_advice.html"
    try:
        with interrupts_noticed() as check:
            advised = _advise_all(
                file, _Log(log, mapping, reading) if log is not None else None, given, sample_time, check
            )
            code = max(2 if one is None else 0 if one.code else 1 for one in advised)
            _write(path, file, [one for one in advised if one is not None])
    except KeyboardInterrupt:
        fail("stopped; there is no advice yet", 130)
    if code:
        raise typer.Exit(code)


class _Log(NamedTuple):
    """A recorded file, which columns feed what, and how it is written."""

    path: Path
    mapping: Mapping[str, str]
    reading: Reading


def _advise_all(
    file: Path,
    log: _Log | None,
    given: Mapping[str, float],
    sample_time: float | None,
    check: Callable[[], None],
) -> list[Advised | None]:
    """Print the advice for each Model of the file; None where nothing could be tried."""
    try:
        with err.status(Text(f"working out what {file} defines")):
            namespace = namespace_of(file)
            models = _models(file, namespace)
    except ValueError as error:
        check()
        fail(str(error), 2)
    advised = []
    for variable, model in models.items():
        others = [other for other in models.values() if other is not model]
        noise = _stated(model, namespace) | _own(given, model.outputs, [v for m in others for v in m.outputs])
        all_others = [v for m in others for v in (*m.outputs, *m.inputs)]
        own = (*model.outputs, *model.inputs)
        taken = log._replace(mapping=_own(log.mapping, own, all_others)) if log is not None else None
        advised.append(_advise(file, variable, model, noise, taken, sample_time, check))
    return advised


def _own(given: Mapping[str, T], own: Sequence[Variable], others: Sequence[Variable]) -> dict[str, T]:
    """What of `given` is of a model, or of none: its error says so."""
    names, strange = {v.name for v in own}, {v.name for v in others}
    return {name: value for name, value in given.items() if name in names or name not in strange}


def _write(path: Path, file: Path, advised: list[Advised]) -> None:
    """Write the report, if there is anything to say, and print its name."""
    from advice.report import write_advice

    if not advised:
        return
    try:
        write_advice(path, f"Advice on {file.name}", command_html(), advised)
    except OSError as error:
        fail(f"cannot write to {path}: {error.strerror or error}", 2)
    out.print(Text(str(path)), soft_wrap=True)


def _models(file: Path, namespace: Mapping[str, Any]) -> dict[str, Model]:
    """The Models at module level, by the names of their variables."""
    found: dict[str, Model] = {}
    for name, value in namespace.items():
        if isinstance(value, Model) and not any(value is other for other in found.values()):
            found[name] = value
    if not found:
        raise ValueError(f"{file} defines no Model at module level; observer-fmus new NAME writes a file with one")
    return found


def _number(where: str, text: str) -> float:
    try:
        return number(text)
    except ValueError as error:
        fail(f"{where}: {error}", 2)


def _advise(
    file: Path,
    variable: str,
    model: Model,
    noise: Mapping[str, float],
    log: _Log | None,
    sample_time: float | None,
    check: Callable[[], None],
) -> Advised | None:
    """Print the advice for one Model; None where nothing could be tried."""
    # Observers and compiler take a second to load: only this command waits for them.
    from advice.advise import STAGES
    from advice.advise import advise as perform
    from advice.log import recorded
    from advice.region import AdviceError
    from advice.report import Advised, facts, reasons, table
    from cosim.errors import ExperimentError
    from fmu_src import ExportError

    columns = (
        TextColumn("{task.description:<34}"),
        BarColumn(),
        TextColumn("{task.percentage:.0f} %"),
        TimeElapsedColumn(),
    )
    try:
        record = recorded(log.path, model, sample_time, log.mapping, log.reading) if log is not None else None
        with Progress(*columns, console=err, transient=True, disable=not err.is_terminal) as bar:
            task = bar.add_task("", total=STAGES)

            def told(stage: str) -> None:
                check()
                bar.update(task, description=stage, advance=1)

            made = perform(
                model,
                noise=noise,
                sample_time=sample_time,
                record=record,
                progress=told,
            )
    except (ExportError, OSError) as error:
        check()
        fail(str(error), 1)
    except (AdviceError, ExperimentError, ValueError) as error:
        check()
        say(str(error))
        return None
    check()
    found = Advised(made, facts(made, noise), _code(made, variable))
    for line in found.facts:
        out.print(Text(line), soft_wrap=True)
    if made.outcomes:
        out.print(_table(table(made), made.choice.candidate.method if made.choice is not None else ""))
    for line in (*reasons(made), "", *_ending(made, file, variable, found.code), ""):
        out.print(Text(line), soft_wrap=True)
    return found


def _stated(model: Model, namespace: Mapping[str, Any]) -> dict[str, float]:
    """The noise that an observer of the model in the file was given."""
    outputs = {f"{TUNING}{v.name}" for v in model.outputs}
    return {
        port.name.removeprefix(TUNING): port.start
        for value in namespace.values()
        if isinstance(value, Component) and value.name.startswith(f"{model.name}_")
        for port in value.parameters
        if port.name in outputs and port.given and port.start > 0
    }


def _table(made: Table, chosen: str) -> ConsoleTable:
    what = made.columns[1].partition("\n")[0]  # the columns of errors, whose names may be long, can be broken
    shown = ConsoleTable(box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for head in made.columns:
        shown.add_column(
            Text(head), justify="left" if head == "observer" else "right", no_wrap=not head.startswith(what)
        )
    for row in made.rows:
        shown.add_row(*row, style="bold" if row[0] == chosen else "")
    return shown


def _code(made: Advice, variable: str) -> str:
    """The lines of Python that make the choice; empty where there is none."""
    if made.choice is None:
        return ""
    chosen = made.choice.candidate
    return f"from observers.{chosen.method} import {chosen.method}\nobserver = {chosen.line(variable)}"


def _ending(made: Advice, file: Path, variable: str, code: str) -> list[str]:
    """What to take, to copy."""
    from advice.choice import why

    if made.choice is None:
        return [f"No observer can be advised for {made.model.name}."]
    driven = f" and a source of {', '.join(v.name for v in made.model.inputs)}" if made.model.inputs else ""
    return [
        f"Take {made.choice.candidate.method}. {why(made.choice, made.outcomes)} Into {file}:",
        "",
        *code.splitlines(),
        "",
        "and then:",
        "",
        f"observer-fmus build --file {file}",
        "",
        f"With plant({variable}) of reference_models.plant in the file too{driven}, this writes a system that runs.",
    ]
