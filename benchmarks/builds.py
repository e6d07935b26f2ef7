"""How long an export takes, and what the shell itself costs."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import casadi as ca
import numpy as np

from benchmarks.compiler import compile_c
from benchmarks.example import SAMPLE_TIME, L, N
from benchmarks.native import Experiment, Unpacked, drive, unpack
from fmu_src import export
from observers.component import Component, Port
from observers.pseudospectral import pseudospectral
from reference_models.duffing import DUFFING

SHELL_STEPS, SHELL_RUNS = 10_000, 30


@dataclass(frozen=True)
class BuildTimes:
    """Seconds. `export` is the whole of it, sources known to zig's cache; the others are the C compiler alone.

    `compile_cold`: with an empty cache, `compile_changed`: when the component's functions are new, `compile_unchanged`:
    when nothing is.
    """

    component: float
    export: float
    compile_cold: float
    compile_changed: float
    compile_unchanged: float


def build_times(fmu: Unpacked, directory: Path) -> BuildTimes:
    """Build times of the observer of Example 1. Its C sources are those of `fmu`; `directory` takes what is built."""
    begin = perf_counter()
    component = pseudospectral(DUFFING, sample_time=SAMPLE_TIME, N=N, L=L)
    made = perf_counter()
    export(component, directory)  # from here on zig's cache knows the sources
    known = perf_counter()
    export(component, directory)
    exported = perf_counter()
    sources = Path(shutil.copytree(fmu.directory / "sources", directory / "sources"))

    def compile_all() -> float:
        start = perf_counter()
        library = directory / fmu.library.name
        compile_c(sorted(sources.glob("*.c")), library, "-shared", "-s", "-lm", cache=directory / "cache")
        return perf_counter() - start

    cold = compile_all()
    functions = sources / "functions.c"
    functions.write_text(functions.read_text() + "\n/* Another content, the same code. */\n")
    changed = compile_all()
    return BuildTimes(made - begin, exported - known, cold, changed, compile_unchanged=compile_all())


def shell_ns(driver: Path, directory: Path) -> float:
    """Nanoseconds for set, doStep and get of a component that does nothing: one state that holds still, no samples."""
    z, u, p, t, h = ca.SX.sym("z"), ca.SX.sym("u"), ca.SX(0, 1), ca.SX.sym("t"), ca.SX.sym("h")
    empty = Component(
        name="empty",
        description="One state that holds still",
        start=ca.Function("start", [p, t], [ca.SX(0)]),
        flow=ca.Function("flow", [z, u, p, t, h], [z]),
        output=ca.Function("output", [z, u, p, t], [z]),
        inputs=(Port("u", "not used"),),
        outputs=(Port("x", "the state"),),
    )
    fmu = unpack(export(empty, directory), directory / empty.name)
    run = drive(driver, fmu, Experiment(np.zeros(SHELL_STEPS), 0.1, "u", ("x",), {}), SHELL_RUNS)
    return float(np.median(run.ns))
