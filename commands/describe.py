"""observer-fmus describe: what an observer can use of an FMU, and what stands in its way."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from commands.console import err, fail, out
from fmu_src.errors import PlantError
from fmu_src.plant.description import PlantDescription, Scalar, obstacles, read
from fmu_src.plant.examine import Selection, examine
from fmu_src.plant.guest import unpacked

MOST = 40  # rows of a table


def describe(
    fmu: Annotated[Path, typer.Argument(help="Any FMU of FMI 2.0.", metavar="FILE.fmu", show_default=False)],
) -> None:
    """List what an observer can use of an FMU: states, inputs, outputs, parameters; and try what stands in its way.

    \b
    Example:
      observer-fmus describe pendulum.fmu
    """
    try:
        plant = read(fmu)
        in_the_way = obstacles(plant)
        if not in_the_way:
            with err.status(escape(f"asking {fmu.name} for points")):
                in_the_way = _tried(fmu, plant)
    except PlantError as error:
        fail(str(error), 1)
    _say(f"{fmu.name}: {plant.name}" + (f", by {plant.tool}" if plant.tool else ""))
    kinds = "model exchange" if plant.exchange else "co-simulation only"
    _say(f"FMI 2.0, {kinds}; binaries for {', '.join(plant.platforms) or 'no platform that is known here'}")
    variables = plant.variables.values()
    _table("states", plant.states)
    _table("inputs", (v for v in variables if v.causality == "input"))
    _table("outputs", plant.outputs)
    _table("parameters", (v for v in variables if v.causality in ("parameter", "calculatedParameter")))
    if plant.license:
        _say(f"Its owner says: {plant.license}. Files that hold it want --redistribute.")
    for sentence in in_the_way:
        _say(f"In the way of an observer: it {sentence}.")
    if not in_the_way:
        _say("Nothing is in the way of an observer: observer-fmus wrap --help.")
    raise typer.Exit(1 if in_the_way else 0)


def _tried(fmu: Path, plant: PlantDescription) -> list[str]:
    """What the plant itself does that an observer cannot use."""
    variables = list(plant.variables.values())
    chosen = Selection(
        inputs=tuple(
            v for v in variables if v.causality == "input" and v.variability == "continuous" and v.kind == "Real"
        ),
        known=(),
        unknown=(),
        outputs=tuple(v for v in plant.outputs if v.variability == "continuous"),
    )
    try:
        examine(unpacked(fmu, plant.file) / "plant", plant, chosen)
    except PlantError as error:
        return [str(error).removeprefix(f"plant '{plant.file}' ")]
    return []


def _table(title: str, variables: Iterable[Scalar]) -> None:
    found = list(variables)
    table = Table(title=f"{len(found)} {title}", title_justify="left", box=None, pad_edge=False)
    for head in ("name", "unit", "start", "use", "description"):
        table.add_column(head, justify="right" if head == "start" else "left", overflow="fold")
    for v in found[:MOST]:
        start = "" if v.start is None else f"{v.start:g}"
        table.add_row(
            *(escape(text) for text in (v.name, "" if v.unit == "1" else v.unit, start, _use(v), v.description))
        )
    if not found:
        return
    out.print(table)
    if len(found) > MOST:
        _say(f"and {len(found) - MOST} more")


def _use(v: Scalar) -> str:
    """The option of wrap that takes it."""
    if v.kind != "Real":
        return f"none: {v.kind}"
    if v.causality == "input":
        return "--input" if v.variability == "continuous" else f"none: {v.variability}"
    if v.causality == "parameter":
        return (
            "--estimate, --parameter"
            if v.variability == "tunable"
            else f"--estimate, --parameter ({v.variability}: slower)"
        )
    if v.causality == "calculatedParameter":
        return "none: calculated"
    return "--output" if v.variability == "continuous" else f"none: {v.variability}"


def _say(text: str) -> None:
    out.print(text, markup=False, highlight=False, soft_wrap=True)
