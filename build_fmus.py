"""Builds the catalogue: every FMU into `fmus/`, every system (.ssp) into `systems/`; or the FMUs of a user's own model.

The same as `observer-fmus build`:

python build_fmus.py                                   everything, for this machine's platform
python build_fmus.py --only duffing_pseudospectral     one FMU, or one system with the FMUs that it needs
python build_fmus.py --platforms all                   one file for Linux, Windows and macOS
python build_fmus.py --file my_model.py                every Component defined in the file
python build_fmus.py --target python                   PythonFMUs: for functions that cannot be compiled
"""

from __future__ import annotations

import runpy
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from cosim.system import Element, System, write_ssp
from fmu_src import export
from observers.component import Component
from reference_models import (
    calvillo_alamir,
    chen_yen_1999,
    closed_loop,
    gong_2007,
    james_baras_1987,
    nikoukhah_1995,
    silverbox,
)
from reference_models.recipe import Recipe, Source

# The papers, the closed loops and the measured circuit, each with its FMUs and systems.
PAPERS = (gong_2007, james_baras_1987, chen_yen_1999, nikoukhah_1995, calvillo_alamir, closed_loop, silverbox)
FMUS: dict[str, Source] = {name: made for paper in PAPERS for name, made in paper.FMUS.items()}
SYSTEMS: dict[str, Recipe] = {name: recipe for paper in PAPERS for name, recipe in paper.SYSTEMS.items()}


def system(name: str, recipe: Recipe, fmu_directory: Path) -> System:
    """The system that `recipe` describes, of the FMUs in `fmu_directory`."""
    elements = {
        element: Element(fmu_directory / f"{fmu}.fmu", dict(recipe.parameters.get(element, {})))
        for element, fmu in recipe.fmus.items()
    }
    connections = list(recipe.connections)
    return System(name, elements, connections, stop=recipe.stop, step=recipe.step, description=recipe.description)


@dataclass
class Build:
    """What to build: FMUs (made by a function, drawn with a plant), then systems."""

    fmus: dict[str, Source] = field(default_factory=dict)
    systems: dict[str, Recipe] = field(default_factory=dict)


def choose(only: Sequence[str]) -> Build:
    """The named FMUs and systems, with the FMUs that the systems need; everything where nothing is named.

    Raises:
        KeyError: a name is neither an FMU nor a system.
    """
    unknown = [name for name in only if name not in FMUS and name not in SYSTEMS]
    if unknown:
        raise KeyError(f"'{unknown[0]}' is neither an FMU ({', '.join(FMUS)}) nor a system ({', '.join(SYSTEMS)})")
    systems = {name: recipe for name, recipe in SYSTEMS.items() if not only or name in only}
    needed = {fmu for recipe in systems.values() for fmu in recipe.fmus.values()}
    return Build({name: made for name, made in FMUS.items() if not only or name in only or name in needed}, systems)


def components_of(path: Path) -> dict[str, tuple[Callable[[], Component], None]]:
    """The Components at module level of a Python file, by their names.

    Modules beside the file can be imported in it, as when Python runs it.

    Raises:
        ValueError: the file is missing, fails, defines none, or defines two of one name.
    """
    if not path.is_file():
        raise ValueError(f"{path}: {'is a folder' if path.is_dir() else 'there is no such file'}")
    beside = str(path.resolve().parent)
    sys.path.insert(0, beside)
    try:
        namespace = runpy.run_path(str(path))
    except (Exception, SystemExit) as error:  # a user's file can fail in any way; one line names it
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        where = f"{path}, line {lines[-1]}" if lines else str(path)
        raise ValueError(f"{where}: {type(error).__name__}: {error}") from error
    finally:
        sys.path.remove(beside)
    found: dict[str, Component] = {}
    for value in namespace.values():
        if isinstance(value, Component) and found.setdefault(value.name, value) is not value:
            raise ValueError(f"{path}: two Components are called '{value.name}', which names their FMU")
    if not found:
        raise ValueError(
            f"{path} defines no Component at module level, such as observer = pseudospectral(model, sample_time=0.1)"
        )
    return {name: (_maker(component), None) for name, component in found.items()}


def _maker(component: Component) -> Callable[[], Component]:
    return lambda: component


def build_all(
    work: Build,
    out: Path,
    platforms: Sequence[str],
    progress: Callable[[str, int, int], None] = lambda name, done, total: None,
    target: str = "native",
) -> list[Path]:
    """Write the FMUs into `out` and the systems into the folder `systems` beside it; returns the files."""
    total = len(work.fmus) + len(work.systems)
    written: list[Path] = []
    for name, (make, driven_by) in work.fmus.items():
        progress(name, len(written), total)
        written.append(export(make(), out, platforms, driven_by() if driven_by else None, target))
    directory = out.resolve().parent / "systems"
    for name, recipe in work.systems.items():
        progress(name, len(written), total)
        path = directory / f"{name}.ssp"
        write_ssp(system(name, recipe, out), path)
        written.append(path)
    progress("done", total, total)
    return written


if __name__ == "__main__":
    # The words of the command line call the functions above, not the other way round: they are wanted here only.
    from commands.app import main

    main(["build", *sys.argv[1:]])
