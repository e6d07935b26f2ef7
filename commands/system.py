"""observer-fmus system: FMUs become an .ssp file, connected by the names of their inputs and outputs."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Annotated

import typer

from commands.console import fail, out, plain
from cosim.errors import ExperimentError, SystemFileError
from cosim.fmu import read_description
from cosim.system import Element, System, write_ssp
from cosim.system.by_name import Ports, connect, element_names


def system(
    fmus: Annotated[
        list[Path],
        typer.Argument(help="The FMUs: a plant, an observer, sources.", metavar="FILE.fmu ...", show_default=False),
    ],
    path: Annotated[Path, typer.Option("--out", metavar="FILE.ssp", help="The system's file.", show_default=False)],
    stop: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", parser=plain, help="Stop time.", show_default="the longest of the FMUs'"),
    ] = None,
    step: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS", parser=plain, help="Communication step size.", show_default="the smallest of the FMUs'"
        ),
    ] = None,
) -> None:
    """Write a system of FMUs: each input is connected to the output of the same name; what stays open is said.

    \b
    Example:
      observer-fmus system plant.fmu observer.fmu drive.fmu --out x.ssp
    """
    try:
        ports: dict[str, Ports] = {}
        files: dict[str, Path] = {}
        for fmu in fmus:
            variables = read_description(fmu).modelVariables
            name = re.sub(r"\W", "_", fmu.stem)
            if name in ports:
                fail(f"{fmu}: two FMUs are called '{name}'", 2)
            ports[name] = Ports(*([v.name for v in variables if v.causality == kind] for kind in ("input", "output")))
            files[name] = fmu.resolve()
        names = element_names(ports)
        made = connect({names[name]: one for name, one in ports.items()})
        elements = {names[name]: Element(file) for name, file in files.items()}
        write_ssp(System(path.stem, elements, made.connections, stop=stop, step=step), path)
    except (SystemFileError, ExperimentError) as error:
        fail(str(error), 2)
    except OSError as error:
        fail(f"cannot write to {path}: {error.strerror or error}", 2)
    for source, target in made.connections:
        out.print(f"{source} -> {target}", markup=False, soft_wrap=True)
    for target, reason in made.open.items():
        out.print(f"open: {target} keeps its start value, for {reason}", markup=False, soft_wrap=True)
    out.print(os.path.relpath(path), markup=False, soft_wrap=True)
