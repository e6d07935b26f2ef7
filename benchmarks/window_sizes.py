"""How the pseudospectral observer's cost grows with states, window and segments: python -m benchmarks.window_sizes.

A chain of oscillators with hardening springs, whose ends are measured, its guess at the truth and an arrival cost: every solve then
converges, and what is counted is the usual sample.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks import callgrind
from benchmarks.compiler import compile_c
from benchmarks.native import Experiment, build_driver, drive, unpack
from benchmarks.python_master import drive_from_python
from fmu_src import export
from observers.component import Component
from observers.instance import Instance
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral
from reference_models.plant import plant

SAMPLE_TIME = 0.1  # [s]
ORDER = 5  # of a segment's polynomial
SAMPLES, RUNS = 60, 3  # of a run, and how many there are: the least time counts
NOISE = 1e-2


@dataclass(frozen=True)
class Size:
    """States, samples of the window, segments."""

    nx: int
    L: int
    segments: int


STATES = [Size(nx, 20, 10) for nx in (4, 8, 16, 32)]
WINDOWS = [Size(16, L, L // 2) for L in (10, 20, 40)]
SEGMENTS = [Size(16, 20, segments) for segments in (4, 10, 20)]


@dataclass(frozen=True)
class Cost:
    """Of a sample: instructions (NaN without valgrind), microseconds, Gauss-Newton iterations; of the C: megabytes, seconds to compile."""

    instructions: float
    us: float
    iterations: float
    megabytes: float
    compile: float


def chain(nx: int) -> Model:
    """nx / 2 oscillators, each coupled to its neighbours; the positions of the first and the last are measured."""
    n = nx // 2

    def ode(x: object, u: object, p: object, t: object) -> list[object]:
        q, v = ([getattr(x, f"{letter}{i}") for i in range(n)] for letter in "qv")
        left, right = [q[0], *q[:-1]], [*q[1:], q[-1]]
        pulled = [left[i] - 3 * q[i] + right[i] - 0.2 * q[i] ** 3 - 0.05 * v[i] for i in range(n)]
        return [*v, *pulled]

    starts = np.random.default_rng(0).uniform(-1, 1, nx)
    names = [f"{letter}{i}" for letter in "qv" for i in range(n)]
    return Model(
        name=f"chain_{nx}",
        states=[Variable(name, start=float(value)) for name, value in zip(names, starts, strict=True)],
        outputs=[Variable("y1"), Variable("y2")],
        ode=ode,
        output=lambda x, u, p, t: [x.q0, getattr(x, f"q{n - 1}")],
    )


def observer(size: Size) -> Component:
    return pseudospectral(
        chain(size.nx),
        sample_time=SAMPLE_TIME,
        N=ORDER,
        L=size.L,
        segments=size.segments,
        arrival_cost=True,
        measurement_noise={"y1": NOISE, "y2": NOISE},
        name=f"chain_{size.nx}_{size.L}_{size.segments}",
        stop_time=1.0,
    )


def measured(nx: int) -> np.ndarray:
    """What the chain's ends do from its start values, with noise (SAMPLES x 2)."""
    run, rng = Instance(plant(chain(nx))), np.random.default_rng(1)
    y = np.empty((SAMPLES, 2))
    for k in range(SAMPLES):
        y[k] = [run.get("y1"), run.get("y2")] + NOISE * rng.normal(size=2)
        run.step(k * SAMPLE_TIME, SAMPLE_TIME)
    return y


def cost(size: Size, driver: Path, directory: Path) -> Cost:
    """Of the observer's FMU.

    Raises:
        ExportError, BenchmarkError: it cannot be built, or fails.
    """
    component = observer(size)
    fmu = unpack(export(component, directory), directory / component.name)
    begin = perf_counter()
    functions = fmu.directory / "sources" / "functions.c"
    compile_c([functions], directory / "functions", "-shared", "-lm", cache=directory / f"cache_{component.name}")
    compiled = perf_counter() - begin
    work = Experiment(measured(size.nx), SAMPLE_TIME, ("y1", "y2"), ["estimate.q0"], {})
    natively = drive(driver, fmu, work, RUNS)
    counted = callgrind.per_sample(driver, fmu, work) if callgrind.is_installed() else np.nan
    iterations = drive_from_python(fmu, work).iterations
    return Cost(counted, float(np.min(natively.ns)) / 1e3, iterations, functions.stat().st_size / 1e6, compiled)


def exponent(sizes: Sequence[float], costs: Sequence[float]) -> float:
    """Of the growth between the last two."""
    return float(np.log(costs[-1] / costs[-2]) / np.log(sizes[-1] / sizes[-2]))


def print_growth(out: Console, directory: Path, driver: Path) -> None:
    """A table for each of what is varied, and the exponent of an iteration's cost."""
    known: dict[Size, Cost] = {}
    for title, sizes, varied in (
        ("states", STATES, [s.nx for s in STATES]),
        ("samples of the window, two a segment", WINDOWS, [s.L for s in WINDOWS]),
        ("segments of one window", SEGMENTS, [s.segments for s in SEGMENTS]),
    ):
        table = Table(title, "instructions", "time", "iterations", "C", "compiled in", title="Per sample")
        for size, value in zip(sizes, varied, strict=True):
            known[size] = c = known.get(size) or cost(size, driver, directory)
            shown = [f"{c.instructions:,.0f}", f"{c.us:.0f} us", f"{c.iterations:.2f}", f"{c.megabytes:.2f} MB"]
            table.add_row(str(value), *shown, f"{c.compile:.1f} s")
        out.print(table)
        found = [known[size] for size in sizes]
        each = [(c.instructions if callgrind.is_installed() else c.us) / c.iterations for c in found]
        out.print(f"An iteration grows with the exponent {exponent(varied, each):.2f} between the last two.")


def main() -> None:
    with tempfile.TemporaryDirectory(prefix="benchmarks-") as scratch:
        directory = Path(scratch).resolve()
        print_growth(Console(), directory, build_driver(directory))


if __name__ == "__main__":
    main()
