"""Prints what the observer's FMU costs: python -m benchmarks."""

from __future__ import annotations

import platform
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from benchmarks import callgrind
from benchmarks.builds import BuildTimes, build_times, shell_ns
from benchmarks.comparison import NATIVE_RUNS, ROUNDS, Comparison, compare
from benchmarks.errors import BenchmarkError
from benchmarks.example import SAMPLE_TIME, L, N, experiment
from benchmarks.flops import ideal_flops
from benchmarks.native import build_driver, unpack
from benchmarks.structures import STRUCTURES, Cost, cost
from cosim.errors import SystemFileError
from fmu_src import ExportError

FMU = Path("fmus/duffing_pseudospectral.fmu")
FASTER_THAN_IPOPT = 200  # promised
MOST_INSTRUCTIONS = 45_000  # per sample, promised
TOP = 5

out = Console()
err = Console(stderr=True)


def main() -> None:
    """Time the pseudospectral observer's FMU, beside IPOPT on the same problem, and count its instructions."""
    if not FMU.is_file():
        _fail(f"{FMU}: there is no such file (build it first: python build_fmus.py --only {FMU.stem})")
    try:
        with tempfile.TemporaryDirectory(prefix="benchmarks-") as scratch:
            _measure_all(Path(scratch).resolve())
    except (BenchmarkError, ExportError, SystemFileError) as error:
        _fail(str(error))


def _measure_all(scratch: Path) -> None:
    out.print(f"{platform.system()} {platform.machine()}, {_processor()}", highlight=False)
    fmu = unpack(FMU, scratch / FMU.stem)
    with _progress("compiling the driver", 1):
        driver = build_driver(scratch)
    with _progress("Example 1: FMU, IPOPT, FMU, IPOPT, ...", ROUNDS) as (bar, task):
        comparison = compare(fmu, driver, ROUNDS, lambda done: bar.update(task, completed=done))
    _print_comparison(comparison)
    if callgrind.is_installed():
        work = experiment(SAMPLE_TIME)
        with _progress("counting instructions", 2) as (bar, task):
            total = callgrind.per_sample(driver, fmu, work)
            bar.advance(task)
            functions = callgrind.functions_per_sample(driver, fmu, work)
        _print_instructions(total, functions, ideal_flops(N, L, comparison.fmu_iterations))
    else:
        out.print("valgrind is not installed: no instructions are counted")
    costs = []
    with _progress("", len(STRUCTURES)) as (bar, task):
        for structure in STRUCTURES:
            bar.update(task, description="structure N = {}, L = {}, Ts = {:g} s".format(*structure))
            costs.append(cost(*structure, driver, scratch))
            bar.advance(task)
    _print_structures(costs)
    with _progress("shell and build times", 2) as (bar, task):
        shell = shell_ns(driver, scratch)
        bar.advance(task)
        times = build_times(fmu, scratch)
    _print_builds(shell, times)


def _print_comparison(c: Comparison) -> None:
    table = _table(
        "Example 1, time per sample", "", "median", "min", "iterations per sample", "times the FMU's, native"
    )
    base = float(np.median(c.native))
    for label, ns, iterations in (
        ("FMU, driven natively", c.native, c.fmu_iterations),
        ("FMU, driven from Python", c.python, c.fmu_iterations),
        ("CasADi + IPOPT", c.ipopt, c.ipopt_iterations),
    ):
        median = float(np.median(ns))
        table.add_row(label, _time(median), _time(float(np.min(ns))), f"{iterations:.2f}", f"{median / base:.1f}")
    out.print(table)
    out.print(
        f"{ROUNDS} rounds by turns; a native figure is the mean over a run of 500 samples, {len(c.native)} runs.\n"
        f"Estimates of FMU and IPOPT differ by at most {_numbers(c.difference)} (x1, x2, theta); "
        f"the FMU's outputs natively and from Python are {'identical' if c.same_bits else '[red]not identical[/red]'}.",
        highlight=False,
    )
    ratio = float(np.median(c.ipopt)) / base
    _promise(f"at least {FASTER_THAN_IPOPT} times faster than IPOPT", ratio >= FASTER_THAN_IPOPT, f"{ratio:.0f} times")


def _print_instructions(total: float, functions: dict[str, float], flops: float) -> None:
    table = _table(
        "Example 1, instructions per sample, where they are spent", "function itself", "instructions", "share"
    )
    for name, count in list(functions.items())[:TOP]:
        table.add_row(name, f"{count:,.0f}", f"{100 * count / total:.1f} %")
    table.add_row("all", f"{total:,.0f}", "100.0 %", style="bold")
    out.print(table)
    out.print(
        f"The floor is {flops:,.0f} floating-point operations: {total / flops:.1f} instructions for each.",
        highlight=False,
    )
    _promise(f"at most {MOST_INSTRUCTIONS:,} instructions per sample", total <= MOST_INSTRUCTIONS, f"{total:,.0f}")


def _print_structures(costs: list[Cost]) -> None:
    columns = ("N", "L", "Ts", "time", "iterations", "instructions", "ideal flops", "instructions / flop", "library")
    table = _table("Per sample, for other structures of the observer", *columns)
    for (order, samples, sample_time), c in zip(STRUCTURES, costs, strict=True):
        counted = (
            ("-", "-") if c.instructions is None else (f"{c.instructions:,.0f}", f"{c.instructions / c.flops:.1f}")
        )
        table.add_row(
            *(str(order), str(samples), f"{sample_time:g} s", _time(c.ns), f"{c.iterations:.2f}"),
            *(counted[0], f"{c.flops:,.0f}", counted[1], f"{c.library_bytes / 1024:.0f} KiB"),
        )
    out.print(table)


def _print_builds(shell: float, times: BuildTimes) -> None:
    table = _table("Shell and build", "", "time")
    for label, seconds in (
        ("set, doStep, get of a component that does nothing", shell * 1e-9),
        ("pseudospectral(...), N = 15, L = 8: the component", times.component),
        ("export of it, sources known to the compiler's cache", times.export),
        ("C compiler alone: sources known", times.compile_unchanged),
        ("C compiler alone: functions.c new", times.compile_changed),
        ("C compiler alone: empty cache (zig builds its C library)", times.compile_cold),
    ):
        table.add_row(label, _time(1e9 * seconds))
    out.print(table)


def _promise(what: str, kept: bool, found: str) -> None:
    out.print(f"{what}: {found}, {'[green]kept[/green]' if kept else '[red]broken[/red]'}", highlight=False)


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold")
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i == 0 and not column[:1].isupper() else "right")
    return table


@contextmanager
def _progress(what: str, total: int) -> Iterator[tuple[Progress, TaskID]]:
    columns = (TextColumn("{task.description:<42}"), BarColumn(), TextColumn("{task.completed}/{task.total}"))
    with Progress(*columns, TimeElapsedColumn(), console=err, transient=True) as bar:
        yield bar, bar.add_task(what, total=total)


def _time(ns: float) -> str:
    for unit, size in (("s", 1e9), ("ms", 1e6), ("us", 1e3)):
        if ns >= size:
            return f"{ns / size:.2f} {unit}"
    return f"{ns:.1f} ns"


def _numbers(values: np.ndarray) -> str:
    return ", ".join(f"{value:.1e}" for value in values)


def _processor() -> str:
    """The processor's name; Linux tells it in a file only."""
    file = Path("/proc/cpuinfo")
    lines = file.read_text().splitlines() if file.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown processor"


def _fail(message: str) -> None:
    err.print(f"error: {message}", style="red", markup=False, highlight=False, soft_wrap=True)
    sys.exit(2)


if __name__ == "__main__":
    typer.run(main)
