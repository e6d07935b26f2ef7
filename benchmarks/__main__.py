"""Prints what the observer's FMU costs: python -m benchmarks."""

from __future__ import annotations

import platform
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from benchmarks import callgrind, tables
from benchmarks.builds import build_times, shell_ns
from benchmarks.comparison import NOISE_BOUNDS, NOISY_ROUNDS, ROUNDS, compare
from benchmarks.errors import BenchmarkError
from benchmarks.example import SAMPLE_TIME, L, N, experiment
from benchmarks.flops import ideal_flops
from benchmarks.motor import OBSERVERS, motor_ns
from benchmarks.native import build_driver, unpack
from benchmarks.structures import STRUCTURES, cost
from cosim.errors import SystemFileError
from cosim.master.slave import RunError
from fmu_src import ExportError

FMU = Path("fmus/duffing_pseudospectral.fmu")

out = Console()
err = Console(stderr=True)


def main() -> None:
    """Time the pseudospectral observer's FMU, beside IPOPT on the same problem, count its instructions; time the DAE observer's."""
    if not FMU.is_file():
        _fail(f"{FMU}: there is no such file (build it first: python build_fmus.py --only {FMU.stem})", 2)
    try:
        with tempfile.TemporaryDirectory(prefix="benchmarks-") as scratch:
            _measure_all(Path(scratch).resolve())
    except SystemFileError as error:
        _fail(str(error), 2)
    except (BenchmarkError, ExportError, RunError) as error:
        _fail(str(error), 1)


def _measure_all(scratch: Path) -> None:
    out.print(f"{platform.system()} {platform.machine()}, {_processor()}", markup=False, highlight=False)
    fmu = unpack(FMU, scratch / FMU.stem)
    with _progress("compiling the driver", 1):
        driver = build_driver(scratch)
    with _progress("Example 1: FMU, IPOPT, FMU, IPOPT, ...", ROUNDS) as (bar, task):
        comparison = compare(fmu, driver, ROUNDS, progress=lambda: bar.advance(task))
    tables.print_comparison(out, comparison)
    with _progress("the same with noise", NOISY_ROUNDS * len(NOISE_BOUNDS)) as (bar, task):
        noisy = [compare(fmu, driver, NOISY_ROUNDS, bound, lambda: bar.advance(task)) for bound in NOISE_BOUNDS]
    tables.print_noisy(out, noisy)
    if callgrind.is_installed():
        work = experiment(SAMPLE_TIME)
        with _progress("counting instructions", 2) as (bar, task):
            total = callgrind.per_sample(driver, fmu, work)
            bar.advance(task)
            functions = callgrind.functions_per_sample(driver, fmu, work)
        tables.print_instructions(out, total, functions, ideal_flops(N, L, comparison.fmu_iterations))
    else:
        out.print("valgrind is not installed: no instructions are counted")
    costs = []
    with _progress("", len(STRUCTURES)) as (bar, task):
        for structure in STRUCTURES:
            bar.update(task, description="structure N = {}, L = {}, Ts = {:g} s".format(*structure))
            costs.append(cost(*structure, driver, scratch))
            bar.advance(task)
    tables.print_structures(out, costs)
    with _progress("Nikoukhah's motor", len(OBSERVERS)) as (bar, task):
        motor = {}
        for label, name in OBSERVERS.items():
            motor[label] = motor_ns(name, driver, scratch)
            bar.advance(task)
    tables.print_motor(out, motor)
    with _progress("shell and build times", 2) as (bar, task):
        shell = shell_ns(driver, scratch)
        bar.advance(task)
        times = build_times(fmu, scratch)
    tables.print_builds(out, shell, times)


@contextmanager
def _progress(what: str, total: int) -> Iterator[tuple[Progress, TaskID]]:
    columns = (TextColumn("{task.description:<42}"), BarColumn(), TextColumn("{task.completed}/{task.total}"))
    with Progress(*columns, TimeElapsedColumn(), console=err, transient=True, disable=not err.is_terminal) as bar:
        yield bar, bar.add_task(what, total=total)


def _processor() -> str:
    """The processor's name; Linux tells it in a file only."""
    file = Path("/proc/cpuinfo")
    lines = file.read_text().splitlines() if file.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown processor"


def _fail(message: str, code: int) -> NoReturn:
    """End with one red message; `code` is 2 for a user's mistake, 1 for a measurement that failed."""
    err.print(f"error: {message}", style="red", markup=False, highlight=False, soft_wrap=True)
    sys.exit(code)


if __name__ == "__main__":
    typer.run(main)
