"""observer-fmus advise: which observer for a model, how often it samples, and what it is worth."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from build_fmus import namespace_of
from commands.console import err, fail, plain, say, split_assignments
from cosim.errors import number, one_line
from cosim.interrupts import interrupts_noticed
from observers.component import Component
from observers.model import Model

if TYPE_CHECKING:
    from advice.advise import Advice
    from advice.trial import Outcome

WIDE = 140  # columns of what is not read on a terminal
UNTUNED = (0.1, 0.01, 0.001)  # of an output's nominal value: noises that nobody gave, by method
TUNING = "tuning.measurement_noise."

out = Console(width=None if sys.stdout.isatty() else WIDE, highlight=False)


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
    try:
        with interrupts_noticed() as check:
            code = _advise_all(file, log, given, sample_time, check)
    except KeyboardInterrupt:
        fail("stopped; there is no advice yet", 130)
    if code:
        raise typer.Exit(code)


def _advise_all(
    file: Path, log: Path | None, given: Mapping[str, float], sample_time: float | None, check: Callable[[], None]
) -> int:
    """Print the advice for each Model of the file; the gravest of the codes."""
    try:
        with err.status(Text(f"working out what {file} defines")):
            namespace = namespace_of(file)
            models = _models(file, namespace)
    except ValueError as error:
        check()
        fail(str(error), 2)
    others = set(given) & {v.name for model in models.values() for v in model.outputs}
    codes = []
    for variable, model in models.items():
        own = {v.name for v in model.outputs}
        told = {name: std for name, std in given.items() if name in own or name not in others}
        codes.append(_advise(file, variable, model, _stated(model, namespace) | told, log, sample_time, check))
    return max(codes)


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
    log: Path | None,
    sample_time: float | None,
    check: Callable[[], None],
) -> int:
    """Print the advice for one Model; 0 where there is a choice, 1 where there is none, 2 where nothing could be tried."""
    # Observers and compiler take a second to load: only this command waits for them.
    from advice.advise import STAGES
    from advice.advise import advise as perform
    from advice.log import recorded
    from advice.region import AdviceError
    from cosim.errors import ExperimentError
    from fmu_src import ExportError

    columns = (
        TextColumn("{task.description:<34}"),
        BarColumn(),
        TextColumn("{task.percentage:.0f} %"),
        TimeElapsedColumn(),
    )
    try:
        record = recorded(log, model, sample_time) if log is not None else None
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
        return 2
    check()
    for line in _facts(made, noise):
        out.print(Text(line), soft_wrap=True)
    if made.outcomes:
        out.print(_table(made))
    for line in (*_reasons(made), "", *_ending(made, file, variable), ""):
        out.print(Text(line), soft_wrap=True)
    return 0 if made.choice is not None else 1


def _stated(model: Model, namespace: Mapping[str, Any]) -> dict[str, float]:
    """The noise that an observer of the model in the file was given."""
    untuned = {f"{TUNING}{v.name}": [part * v.nominal for part in UNTUNED] for v in model.outputs}
    return {
        port.name.removeprefix(TUNING): port.start
        for value in namespace.values()
        if isinstance(value, Component) and value.name.startswith(f"{model.name}_")
        for port in value.parameters
        if port.name in untuned and port.start > 0 and port.start not in untuned[port.name]
    }


def _facts(made: Advice, noise: Mapping[str, float]) -> list[str]:
    """What was looked at, a sentence each."""
    model, seen = made.model, made.observability
    unit = {v.name: "" if v.unit == "1" else f" {v.unit}" for v in (*model.outputs, *model.inputs)}
    moved = ", ".join(
        f"{n} from {low:.4g} to {high:.4g}{unit.get(n, '')}" for n, (low, high) in made.region.driven.items()
    )
    guessed = [v.name for v in model.outputs if v.name not in noise]
    facts = [f"{model.name}: {model.description}" if model.description else model.name]
    facts.append(f"Inputs move {moved}." if moved else "There are no inputs.")
    facts.append(
        "Noise of a sample: "
        + ", ".join(f"{n} {std:.4g}{unit[n]}" for n, std in made.noise.items())
        + (f" (1 % of the nominal value where --noise does not say: {', '.join(guessed)})." if guessed else ".")
    )
    by = f", by the fastest mode that the outputs show, {made.rate:.3g} 1/s" if made.rate else ""
    facts.append(f"Sample time: {made.sample_time:g} s{by}.")
    if seen.window is not None:
        facts.append(f"Window: {seen.window} samples determine every state and unknown parameter.")
    facts += [f"Observability: {sentence}." for sentence in seen.said]
    return facts


def _table(made: Advice) -> Table:
    table = Table(box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column("observer", no_wrap=True)
    unit = {
        v.name: v.unit
        for v in (*made.model.states, *made.model.algebraic, *made.model.unknown_parameters, *made.model.outputs)
    }
    names = list(dict.fromkeys(name for outcome in made.outcomes for name in outcome.errors))
    what = f"{made.ahead} ahead\n" if made.ahead else "error\n"
    for name in names:
        table.add_column(
            f"{what}{name}" + ("" if unit[name] == "1" else f" [{unit[name]}]").replace("[", "\\["), justify="right"
        )
    for head in ("after\njump", "within\n2 std", "settling", "per\nsample", "silent"):
        table.add_column(head, justify="right", no_wrap=True)
    for outcome in made.outcomes:
        cells = [f"{outcome.errors[name]:.2g}" if name in outcome.errors else "-" for name in names]
        mark = "bold" if outcome is made.choice else ""
        table.add_row(outcome.candidate.method, *cells, *_worth(outcome), style=mark)
    return table


def _worth(outcome: Outcome) -> list[str]:
    return [
        f"{outcome.after_jump:.2g}" if outcome.after_jump is not None else "-",
        f"{outcome.coverage:.0%}" if outcome.coverage is not None else "-",
        f"{outcome.settling:.3g} s" if outcome.settling is not None else "never",
        f"{1e6 * outcome.per_sample:.0f} us",
        f"{outcome.silent:.1%}" if outcome.wrong else "-",
    ]


def _reasons(made: Advice) -> list[str]:
    """Why observers are not in the table, or cannot be chosen."""
    from advice.choice import unfit

    left = [(o.candidate.method, unfit(o, made.outcomes)) for o in made.outcomes]
    return [
        *(f"Not for this model: {one_line(_named(r.method, r.reason))}." for r in made.refused),
        *(f"Not to be chosen: {method}: {reason}." for method, reason in left if reason),
    ]


def _named(method: str, reason: str) -> str:
    return reason if reason.startswith(f"{method}:") else f"{method}: {reason}"


def _ending(made: Advice, file: Path, variable: str) -> list[str]:
    """What to take, to copy."""
    if made.choice is None:
        return [f"No observer can be advised for {made.model.name}."]
    chosen = made.choice.candidate
    return [
        f"Take {chosen.method}. Into {file}:",
        "",
        f"from observers.{chosen.method} import {chosen.method}",
        f"observer = {chosen.line(variable)}",
        "",
        "and then:",
        "",
        f"observer-fmus build --file {file}",
    ]
