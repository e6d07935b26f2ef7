"""observer-fmus wrap: an FMU for model exchange gets an observer."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from build_fmus import build_all, coupled
from commands.console import err, fail, out, plain, split_assignments
from fmu_src import ExportError, ExportWarning, PlantFMU
from fmu_src.plant.model import identifier
from observers.component import Component
from observers.pseudospectral import pseudospectral
from observers.riccati import riccati
from observers.ukf import ukf
from reference_models.plant import plant

OBSERVERS: dict[str, Callable[..., Component]] = {"ukf": ukf, "riccati": riccati, "pseudospectral": pseudospectral}
_NAMED = "NAME=VALUE"


def wrap(
    fmu: Annotated[
        Path, typer.Argument(help="The plant, FMI 2.0 for model exchange.", metavar="PLANT.fmu", show_default=False)
    ],
    outputs: Annotated[
        list[str], typer.Option("--output", help="What is measured. May be repeated.", show_default=False)
    ],
    sample_time: Annotated[
        float,
        typer.Option(metavar="SECONDS", parser=plain, help="From a measurement to the next.", show_default=False),
    ],
    inputs: Annotated[
        list[str] | None, typer.Option("--input", help="A known input. May be repeated.", show_default=False)
    ] = None,
    parameters: Annotated[
        list[str] | None,
        typer.Option("--parameter", help="A parameter that can be set in the observer, too. May be repeated."),
    ] = None,
    estimated: Annotated[
        list[str] | None,
        typer.Option("--estimate", help="A parameter that is estimated beside the states. May be repeated."),
    ] = None,
    observer: Annotated[str, typer.Option(help=f"{', '.join(OBSERVERS)}.")] = "ukf",
    process_noise: Annotated[
        list[str] | None,
        typer.Option(metavar=_NAMED, help="How fast a state or parameter may leave the model, per sqrt(s)."),
    ] = None,
    measurement_noise: Annotated[
        list[str] | None, typer.Option(metavar=_NAMED, help="Standard deviation of a sample of an output.")
    ] = None,
    initial_std: Annotated[
        list[str] | None, typer.Option(metavar=_NAMED, help="Standard deviation of a guess.")
    ] = None,
    guess: Annotated[
        list[str] | None,
        typer.Option(metavar=_NAMED, help="Where the estimate begins.", show_default="the plant's own start"),
    ] = None,
    name: Annotated[
        str | None, typer.Option(help="Of the model, and so of the files.", show_default="the plant's")
    ] = None,
    platforms: Annotated[
        str, typer.Option(help="As of build: host, all (those the plant has), or names of platforms, with commas.")
    ] = "host",
    redistribute: Annotated[
        bool,
        typer.Option(
            "--redistribute", help="The plant's owner allows that its files travel in the FMUs that are made."
        ),
    ] = False,
    out_directory: Annotated[
        Path,
        typer.Option("--out", metavar="DIR", help="Folder for the FMUs; the system goes into 'systems' beside it."),
    ] = Path("fmus"),
) -> None:
    """Make an observer for a plant that exists only as an FMU; names are the plant's own, as describe lists them.

    Written are the observer, the plant as a co-simulation FMU with sensor noise, and the system that couples both.

    \b
    Example:
      observer-fmus wrap pendulum.fmu --output mass.s --input extForce \\
        --estimate spring.c --sample-time 0.05
    """
    if observer not in OBSERVERS:
        fail(f"--observer {observer}: must be one of {', '.join(OBSERVERS)}", 2)
    options = {
        "process_noise": _values(process_noise, "--process-noise"),
        "measurement_noise": _values(measurement_noise, "--measurement-noise"),
        "initial_std": _values(initial_std, "--initial-std"),
        "guess": _values(guess, "--guess"),
    }
    try:
        with warnings.catch_warnings(record=True) as notes:
            warnings.simplefilter("always", ExportWarning)
            with err.status(escape(f"asking {fmu.name} for points")):
                model = PlantFMU(
                    fmu,
                    outputs=outputs,
                    inputs=inputs or (),
                    parameters=parameters or (),
                    unknown_parameters=estimated or (),
                    name=name,
                    redistribute=redistribute,
                )
            with err.status(f"making the {observer} observer"):
                made = _observer(observer, model, sample_time, options)
                driving = _plant(model, sample_time)
            work = coupled({driving.name: (lambda: driving, None), made.name: (lambda: made, lambda: driving)})
            with err.status("building") as status:
                written = build_all(
                    work,
                    out_directory,
                    [one.strip() for one in platforms.split(",")],
                    lambda what, done, total: status.update(escape(f"building {what} ({done + 1} of {total})")),
                )
    except OSError as error:
        fail(f"cannot write to {out_directory}: {error.strerror or error}", 2)
    except (ExportError, ValueError) as error:
        fail(str(error), 2)
    for path in written:
        out.print(f"{os.path.relpath(path)}  {path.stat().st_size / 1024:.0f} KiB", markup=False, soft_wrap=True)
    for note in notes:
        err.print(f"note: {note.message}", style="yellow", markup=False, highlight=False, soft_wrap=True)


def _values(texts: list[str] | None, option: str) -> dict[str, float]:
    """Numbers by the model's names: the plant's are taken too."""
    try:
        return {identifier(name): plain(value) for name, value in split_assignments(texts, option, _NAMED).items()}
    except typer.BadParameter as error:
        fail(f"{option}: {error.message}", 2)


def _observer(kind: str, model: PlantFMU, sample_time: float, options: Mapping[str, dict[str, float]]) -> Component:
    given: dict[str, Any] = {name: values for name, values in options.items() if values}
    return OBSERVERS[kind](model, sample_time=sample_time, stop_time=_stop(model), **given)


def _plant(model: PlantFMU, sample_time: float) -> Component:
    """Under a name of its own: the plant's FMU may lie where this one goes."""
    return replace(plant(model, stop_time=_stop(model), step_size=sample_time), name=f"{model.name}_plant")


def _stop(model: PlantFMU) -> float:
    return model.guest.plant.stop or 10.0
