"""What the benchmarks print, and the promises that they check."""

from __future__ import annotations

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from benchmarks.builds import BuildTimes
from benchmarks.comparison import NOISE_BOUNDS, ROUNDS, Comparison
from benchmarks.structures import STRUCTURES, Cost

FASTER_THAN_IPOPT = 200  # promised
MOST_INSTRUCTIONS = 45_000  # per sample, promised
MOST_MOTOR_NS = 1000  # per sample of the DAE observer's w-form, promised
TOP = 5  # functions shown


def print_comparison(out: Console, c: Comparison) -> None:
    table = _table("Example 1, time per sample", "", "median", "min", "iterations", "ratio")
    base = float(np.median(c.native))
    for label, ns, iterations in (
        ("FMU, driven natively", c.native, c.fmu_iterations),
        ("FMU, driven from Python", c.python, c.fmu_iterations),
        ("CasADi + IPOPT", c.ipopt, c.ipopt_iterations),
    ):
        median = float(np.median(ns))
        table.add_row(label, _time(median), _time(float(np.min(ns))), f"{iterations:.2f}", f"{median / base:.1f}")
    out.print(table)
    counts = f"{len(c.native)}, {len(c.python)} and {len(c.ipopt)} runs"
    _say(out, f"Median and min over {counts} of 50 s, by turns in {ROUNDS} rounds.")
    difference = ", ".join(f"{value:.1e}" for value in np.max(c.difference, axis=0))
    _say(out, f"FMU and IPOPT differ by at most {difference} in x1, x2, theta,")
    _say(out, f"the FMU natively and from Python {'not at all' if c.same_bits else '[red]in some bits[/red]'}.")
    ratio = float(np.median(c.ipopt)) / base
    _promise(out, f"at least {FASTER_THAN_IPOPT} times faster than IPOPT", ratio >= FASTER_THAN_IPOPT, f"{ratio:.0f}")


def print_noisy(out: Console, comparisons: list[Comparison]) -> None:
    """`comparisons`: one for each of NOISE_BOUNDS."""
    columns = ("noise", "FMU, native", "iter.", "failed", "IPOPT", "iter.", "ratio", "apart by")
    table = _table("The same with uniform noise (failed: of 500 samples; apart by: median)", *columns)
    for bound, c in zip(NOISE_BOUNDS, comparisons, strict=True):
        fmu, ipopt = float(np.median(c.native)), float(np.median(c.ipopt))
        found = (_time(fmu), f"{c.fmu_iterations:.2f}", str(c.failures), _time(ipopt), f"{c.ipopt_iterations:.2f}")
        difference = float(np.median(np.max(c.difference, axis=1)))
        table.add_row(f"±{bound:g} m", *found, f"{ipopt / fmu:.0f}", f"{difference:.1e}")
    out.print(table)


def print_instructions(out: Console, total: float, functions: dict[str, float], flops: float) -> None:
    """`total` and `functions` (most first): instructions per sample. `flops`: the ideal count."""
    table = _table("Example 1, instructions per sample", "function itself", "instructions", "share")
    for name, count in list(functions.items())[:TOP]:
        table.add_row(name, f"{count:,.0f}", f"{100 * count / total:.1f} %")
    table.add_row("all", f"{total:,.0f}", "100.0 %", style="bold")
    out.print(table)
    _say(out, f"The floor is {flops:,.0f} floating-point operations: {total / flops:.1f} instructions for each.")
    kept = total <= MOST_INSTRUCTIONS
    _promise(out, f"at most {MOST_INSTRUCTIONS:,} instructions per sample", kept, f"{total:,.0f}")


def print_structures(out: Console, costs: list[Cost]) -> None:
    columns = ("N, L, Ts", "time", "iterations", "instructions", "flops", "ratio", "library")
    table = _table("Other structures, per sample", *columns)
    for structure, c in zip(STRUCTURES, costs, strict=True):
        count, ratio = "-", "-"
        if c.instructions is not None:
            count, ratio = f"{c.instructions:,.0f}", f"{c.instructions / c.flops:.1f}"
        size = f"{c.library_bytes / 1024:.0f} KiB"
        name = "{}, {}, {:g} s".format(*structure)
        table.add_row(name, _time(c.ns), f"{c.iterations:.2f}", count, f"{c.flops:,.0f}", ratio, size)
    out.print(table)


def print_motor(out: Console, times: dict[str, np.ndarray]) -> None:
    """`times`: nanoseconds per sample of each run, by the observer's label; the w-form comes first."""
    table = _table("Nikoukhah's motor, DAE observer, time per sample", "", "median", "min")
    medians = [float(np.median(ns)) for ns in times.values()]
    for label, median, ns in zip(times, medians, times.values(), strict=True):
        table.add_row(label, _time(median), _time(float(np.min(ns))))
    out.print(table)
    kept = medians[0] <= MOST_MOTOR_NS
    _promise(out, "at most 1 us per sample (w-form, motor)", kept, _time(medians[0]))


def print_builds(out: Console, shell: float, times: BuildTimes) -> None:
    """`shell`: nanoseconds for one step of a component that does nothing."""
    table = _table("Shell and build", "", "time")
    for label, ns in (
        ("set, doStep, get of a component that does nothing", shell),
        ("pseudospectral(...), N = 15, L = 8: the component", 1e9 * times.component),
        ("export of it, sources known to zig's cache", 1e9 * times.export),
        ("compiler alone, sources known to zig's cache", 1e9 * times.compile_unchanged),
        ("compiler alone, functions.c new", 1e9 * times.compile_changed),
        ("compiler alone, zig's cache empty", 1e9 * times.compile_cold),
    ):
        table.add_row(label, _time(ns))
    out.print(table)


def _promise(out: Console, what: str, kept: bool, found: str) -> None:
    _say(out, f"Promised: {what}. Found: {found}, {'[green]kept[/green]' if kept else '[red]broken[/red]'}.")


def _say(out: Console, text: str) -> None:
    out.print(text, highlight=False)


def _table(title: str, *columns: str) -> Table:
    table = Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=SIMPLE_HEAD,
        collapse_padding=True,  # the widest fits 80 columns
        pad_edge=False,
    )
    for i, column in enumerate(columns):
        table.add_column(column, justify="right" if i else "left", no_wrap=True)
    return table


def _time(ns: float) -> str:
    for unit, size in (("s", 1e9), ("ms", 1e6), ("us", 1e3)):
        if ns >= size:
            return f"{ns / size:.2f} {unit}"
    return f"{ns:.1f} ns"
