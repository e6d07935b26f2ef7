"""Builds the catalogue: every FMU into `fmus/`, every system (.ssp) into `systems/`; or the FMUs of a user's own model.

The same as `observer-fmus build`:

python build_fmus.py                                   everything, for this machine's platform
python build_fmus.py --only duffing_pseudospectral     one FMU, or one system with the FMUs that it needs
python build_fmus.py --platforms all                   one file for Linux, Windows and macOS
python build_fmus.py --file my_model.py                every Component defined in the file
python build_fmus.py --target python                   PythonFMUs: for functions that cannot be compiled
"""

from __future__ import annotations

import os
import runpy
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor, as_completed
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from pathlib import Path
from tempfile import TemporaryDirectory

from cosim.errors import suggest
from cosim.fmu import Value
from cosim.interrupts import interrupts_blocked
from cosim.system import Element, System, write_ssp
from cosim.system.by_name import Ports, connect, element_names, role, undriven
from cosim.system.parameter_set import read_parameter_set, the_one_with
from cosim.system.route import Quantity
from cosim.system.units import EXPONENTS, Unit, conversion
from cosim.whole import whole
from fmu_src import ExportError, export
from fmu_src.archive import check_writable
from fmu_src.description.units import parse
from fmu_src.native.compiler import share_group
from observers.component import Component, Port, estimated
from observers.user_file import namespace_of
from observers.variable import unscaled
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
    """What to build: FMUs (made by a function, drawn with a plant), then systems; `notes`, what their maker should know."""

    fmus: dict[str, Source] = field(default_factory=dict)
    systems: dict[str, Recipe] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def choose(only: Sequence[str]) -> Build:
    """The named FMUs and systems, with the FMUs that the systems need; everything where nothing is named.

    Raises:
        KeyError: a name is neither an FMU nor a system.
    """
    unknown = [name for name in only if name not in FMUS and name not in SYSTEMS]
    if unknown:
        known = [*FMUS, *SYSTEMS]
        raise KeyError(f"'{unknown[0]}' is neither an FMU nor a system of the catalogue; {suggest(unknown[0], known)}")
    systems = {name: recipe for name, recipe in SYSTEMS.items() if not only or name in only}
    needed = {fmu for recipe in systems.values() for fmu in recipe.fmus.values()}
    return Build({name: made for name, made in FMUS.items() if not only or name in only or name in needed}, systems)


def components_of(path: Path) -> dict[str, Source]:
    """The Components at module level of a Python file, by their names, each with the plant among them that drives it.

    Raises:
        ValueError: the file is missing, fails, defines none, or defines two of one name.
    """
    found: dict[str, Component] = {}
    for value in namespace_of(path).values():
        if isinstance(value, Component) and found.setdefault(value.name, value) is not value:
            raise ValueError(f"{path}: two Components are called '{value.name}', which names their FMU")
    if not found:
        raise ValueError(
            f"{path} defines no Component at module level, such as observer = pseudospectral(model, sample_time=0.1)"
        )
    return {name: (_maker(component), _driver(component, found.values())) for name, component in found.items()}


def build_of(path: Path) -> Build:
    """What is to be built of a Python file: its Components, and their systems.

    Raises:
        ValueError: as `components_of`.
    """
    return coupled(components_of(path))


def coupled(fmus: dict[str, Source]) -> Build:
    """The FMUs, and for each with a plant the two as a system, with their sources."""
    components = {name: make() for name, (make, _) in fmus.items()}
    ports = {name: Ports([p.name for p in c.inputs], [p.name for p in c.outputs]) for name, c in components.items()}
    sources = [name for name, one in ports.items() if role(one) == "source"]
    notes = [f"{name}: {note}" for name, component in components.items() for note in unscaled(estimated(component))]
    systems = {}
    for name, (_, driven_by) in fmus.items():
        if driven_by is None:
            continue
        elements = element_names({one: ports[one] for one in (driven_by().name, name, *sources)})
        made = connect({element: ports[one] for one, element in elements.items()})
        notes += undriven(name, made, {fmu: ports[fmu].outputs for fmu in sources})
        used = {end.partition(".")[0] for pair in made.connections for end in pair}
        fmu_of = {element: one for one, element in elements.items() if element in used}
        stop = max(components[one].stop_time for one in fmu_of.values())
        step = min(components[one].step_size for one in fmu_of.values())
        systems[name] = Recipe(f"{driven_by().name} and {name}", fmu_of, {}, stop, step, made.connections)
    return Build(fmus, systems, list(dict.fromkeys(notes)))


def with_parameters(work: Build, path: Path) -> Build:
    """`work` with the values in a parameter set (.ssv) as start values of the one component that has all of its names.

    Raises:
        ValueError: no such file or set, no component with these names, or several; a value that a parameter does not take.
    """
    values = read_parameter_set(path)
    known = {name: [p.name for p in make().parameters] for name, (make, _) in work.fmus.items()}
    name = the_one_with(path, values, known)
    make, driven_by = work.fmus[name]
    component = make()
    try:
        tuned = replace(component, parameters=tuple(_started(p, values) for p in component.parameters))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return Build({**work.fmus, name: (_maker(tuned), driven_by)}, work.systems, work.notes)


def _started(port: Port, values: Mapping[str, Value | Quantity]) -> Port:
    """`port` with its start value from `values`, in its own unit."""
    if port.name not in values:
        return port
    given = values[port.name]
    value, unit = (given.value, given.route.unit) if isinstance(given, Quantity) else (given, None)
    if isinstance(value, str):
        raise ValueError(f"'{port.name}': '{value}' is not a number")
    if unit is not None and port.unit:
        own = parse(port.unit)
        target = Unit(port.unit, tuple(own.exponents.get(base, 0) for base in EXPONENTS), own.factor, own.offset)
        value = conversion(unit, target)(float(value))
    return replace(port, start=float(value))


def _driver(component: Component, among: Iterable[Component]) -> Callable[[], Component] | None:
    """The plant that drives `component` in its documentation: of those that put out all its measurements, the one it is named after.

    A single one serves whatever its name.
    """
    flags = "measurement_valid."
    measured = {port.name.removeprefix(flags) for port in component.inputs if port.name.startswith(flags)}
    able = [other for other in among if measured and measured <= {port.name for port in other.outputs}]
    named = [other for other in able if component.name.startswith(f"{other.name}_")]
    chosen = max(named, key=lambda other: len(other.name)) if named else able[0] if len(able) == 1 else None
    return _maker(chosen) if chosen is not None else None


def _maker(component: Component) -> Callable[[], Component]:
    return lambda: component


def build_all(
    work: Build,
    out: Path,
    platforms: Sequence[str],
    progress: Callable[[str, int, int], None] = lambda name, done, total: None,
    target: str = "native",
) -> list[Path]:
    """Write the FMUs into `out`, on all processors, and the systems into the folder `systems` beside it; returns the files.

    `progress` is told what is being built, how many files are written and how many there will be.
    """
    check_writable(out)
    if work.systems:
        check_writable(out.resolve().parent / "systems")
    total = len(work.fmus) + len(work.systems)
    exported: dict[str, Path] = {}

    def building(name: str) -> None:
        progress(name, len(exported), total)

    with closing(_export_all(work.fmus, out, platforms, target, building)) as made:
        for name, path in made:
            exported[name] = path
    written = [exported[name] for name in work.fmus]
    directory = out.resolve().parent / "systems"
    for name, recipe in work.systems.items():
        progress(name, len(written), total)
        path = directory / f"{name}.ssp"
        write_ssp(system(name, recipe, out), path)
        written.append(path)
    progress("done", total, total)
    return written


def _export_all(
    fmus: dict[str, Source], out: Path, platforms: Sequence[str], target: str, building: Callable[[str], None]
) -> Generator[tuple[str, Path], None, None]:
    """Name and path of each FMU when it is written; `building` is told the name of one that is being built."""
    processes = min(len(fmus), os.cpu_count() or 1)
    # Components do not pickle: other processes make them anew, by their names in the catalogue. A user's file runs once.
    # The Python target compiles next to nothing, and so gains nothing from them.
    if processes < 2 or target != "native" or not fmus.items() <= FMUS.items():
        for name, source in fmus.items():
            building(name)
            yield name, _export(source, out, platforms, target)
        return
    with TemporaryDirectory(ignore_cleanup_errors=True) as scratch, _pool(processes, scratch) as pool:
        with interrupts_blocked():
            waiting = {pool.submit(_export_named, name, scratch, platforms, target): name for name in fmus}
        try:
            building(next(iter(fmus)))
            for done in as_completed(list(waiting)):
                name = waiting.pop(done)
                yield name, _moved(done.result(), out)
                if waiting:
                    building(next(iter(waiting.values())))  # the first that was submitted is being built
        except BrokenExecutor as error:
            raise ExportError("a process that built FMUs was ended from outside: memory may have run out") from error


@contextmanager
def _pool(processes: int, scratch: str) -> Iterator[ProcessPoolExecutor]:
    """Processes whose temporary files are in `scratch`. What ends the block early ends them and their compilers: the pool would wait."""
    pool = ProcessPoolExecutor(processes, get_context("spawn"), _begin, (scratch,))
    try:
        yield pool
    except BaseException:
        for process in list(pool._processes.values()):
            _kill(process)
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _begin(scratch: str) -> None:
    """In a process that builds: it and its compilers are one group, which can be ended as one."""
    tempfile.tempdir = scratch
    if os.name == "posix":
        os.setsid()
        share_group()


def _kill(process: BaseProcess) -> None:
    if os.name == "posix":
        with suppress(ProcessLookupError):  # it has just begun, and no group of its own yet
            os.killpg(process.pid or 0, signal.SIGKILL)
    process.kill()


def _moved(made: Path, out: Path) -> Path:
    path = out / made.name
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole(path) as unfinished:
        shutil.copyfile(made, unfinished)
    made.unlink()
    return path


def _export(source: Source, out: Path, platforms: Sequence[str], target: str) -> Path:
    make, driven_by = source
    return export(make(), out, platforms, driven_by() if driven_by else None, target)


def _export_named(name: str, out: str, platforms: Sequence[str], target: str) -> Path:
    return _export(FMUS[name], Path(out), platforms, target)


if __name__ == "__main__":
    # The command line calls the functions above. By name, for an import here would close a circle.
    sys.argv[1:1] = ["build"]
    runpy.run_module("commands", run_name="__main__")
