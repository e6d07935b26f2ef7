"""What there is to say of an advice: facts, the table of the observers, reasons, and a page with the choice at work."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import NamedTuple

from advice.advise import Advice
from advice.choice import unfit
from advice.trial import Outcome
from cosim.errors import one_line
from cosim.report.page import Section, Table, on_run, write_report
from observers.variable import unscaled


def facts(made: Advice, noise: Mapping[str, float]) -> list[str]:
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
    facts += [f"Note: {note}." for note in unscaled((*model.states, *model.unknown_parameters, *model.outputs))]
    facts += [f"Observability: {sentence}." for sentence in seen.said]
    return facts


def table(made: Advice) -> Table:
    """The observers that were tried, best first; a line break in a head is where a narrow column breaks it."""
    model = made.model
    unit = {v.name: v.unit for v in (*model.states, *model.algebraic, *model.unknown_parameters, *model.outputs)}
    names = list(dict.fromkeys(name for outcome in made.outcomes for name in outcome.errors))
    what = f"{made.ahead} ahead" if made.ahead else "error"
    heads = [f"{what}\n{name}" + ("" if unit[name] == "1" else f" [{unit[name]}]") for name in names]
    rows = []
    for outcome in made.outcomes:
        cells = [f"{outcome.errors[name]:.2g}" if name in outcome.errors else "-" for name in names]
        rows.append((outcome.candidate.method, *cells, *_worth(outcome)))
    worth = ("after\njump", "within\n2 std", "settling", "per\nsample", "silent")
    return Table(("observer", *heads, *worth), rows, model.name)


def _worth(outcome: Outcome) -> list[str]:
    return [
        f"{outcome.after_jump:.2g}" if outcome.after_jump is not None else "-",
        f"{outcome.coverage:.0%}" if outcome.coverage is not None else "-",
        f"{outcome.settling:.3g} s" if outcome.settling is not None else "never",
        f"{1e6 * outcome.per_sample:.0f} us",
        f"{outcome.silent:.1%}" if outcome.wrong else "-",
    ]


def reasons(made: Advice) -> list[str]:
    """Why observers are not in the table, or cannot be chosen."""
    left = [(o.candidate.method, unfit(o, made.outcomes)) for o in made.outcomes]
    return [
        *(f"Not for this model: {one_line(_named(r.method, r.reason))}." for r in made.refused),
        *(f"Not to be chosen: {method}: {reason}." for method, reason in left if reason),
    ]


def _named(method: str, reason: str) -> str:
    return reason if reason.startswith(f"{method}:") else f"{method}: {reason}"


class Advised(NamedTuple):
    """An advice, the sentences on what it rests on (`facts`), and the Python that makes the choice, empty where there is none."""

    advice: Advice
    facts: Sequence[str]
    code: str


def write_advice(path: Path, title: str, command_html: str, advised: Sequence[Advised]) -> None:
    """Write the page on the advices for the Models of a file; `command_html` is the command that made it.

    Raises:
        OSError: the file cannot be written.
    """
    intro, sections = command_html, []
    for made, said, code in advised:
        name = made.model.name
        taken = (
            f"{name}: take {made.choice.candidate.method}." if made.choice else f"{name}: no observer can be advised."
        )
        intro += f"<p>{escape(taken)}</p>" + (f'<div class="scroll"><pre>{escape(code)}</pre></div>' if code else "")
        sections.append(Section(f"{name}: what was looked at", [*said, *reasons(made)]))
        if made.shown is not None:
            sections.append(on_run(f"{name}: {made.shown.system}", "", made.shown))
    write_report(path, title, intro, [table(one.advice) for one in advised if one.advice.outcomes], sections)
