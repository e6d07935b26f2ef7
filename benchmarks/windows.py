"""Time per sample with noise, tube, DAE, segments, arrival cost (pseudospectral observer): python -m benchmarks.windows."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

import reference_models
from benchmarks.compiler import compile_c
from benchmarks.native import Experiment, Unpacked, build_driver, drive, unpack
from benchmarks.python_master import drive_from_python
from cosim.replay.log import read_log
from fmu_src import export
from observers.component import Component
from observers.instance import Instance
from observers.pseudospectral import pseudospectral
from reference_models import gong_2007, silverbox
from reference_models.duffing import DUFFING

LOG = Path(reference_models.__file__).parent / "data" / "silverbox.csv.gz"
SILVERBOX_SAMPLES = 2000  # of the record's 30,000
ROUNDS, SECONDS = 3, 1.0  # a case is driven for about SECONDS in each round


@dataclass(frozen=True)
class Case:
    """An observer (in its label: segments x N) and what it is driven with; `most_ns` per sample is promised."""

    label: str
    make: Callable[[], Component]
    experiment: Callable[[], Experiment]
    most_ns: float | None = None


@dataclass
class Cost:
    """Seconds to make the component and to compile its C; nanoseconds per sample of each run; iterations, failed solves."""

    make: float
    compile: float
    ns: list[float]
    iterations: float
    failures: int


def coupled(plant: Component, start: dict[str, float], sample_time: float, samples: int) -> Experiment:
    """What `plant` measures; read are the estimates of its states."""
    run = Instance(plant, start)
    y = np.empty(samples)
    for k in range(samples):
        y[k] = run.get("y")
        run.step(k * sample_time, sample_time)
    return Experiment(y, sample_time, "y", ("estimate.x1", "estimate.x2"), {})


def example_4() -> Experiment:
    recipe = gong_2007.SYSTEMS["gong_example_4_tube"]
    return coupled(gong_2007.duffing(), dict(recipe.parameters["plant"]), 0.1, 600)


def example_5() -> Experiment:
    recipe = gong_2007.SYSTEMS["gong_example_5"]
    return coupled(gong_2007.duffing(), dict(recipe.parameters["plant"]), 0.1, 500)


def example_6() -> Experiment:
    return coupled(gong_2007.rlc(), {}, 0.2, 20)


def clean() -> Experiment:
    """Theta constant."""
    return coupled(gong_2007.duffing(), gong_2007.START, 0.1, 500)


def record() -> Experiment:
    """The beginning of the Silverbox's record."""
    log = read_log(LOG)
    samples = np.column_stack([log.numbers(name)[:SILVERBOX_SAMPLES] for name in ("y", "u")])
    outputs = ("estimate.x1", "estimate.x2", "estimate.k1", "estimate.k3")
    return Experiment(samples, silverbox.SAMPLE_TIME, ("y", "u"), outputs, {})


def catalogue(name: str) -> Callable[[], Component]:
    """The catalogue's observer."""
    return (gong_2007.FMUS | silverbox.FMUS)[name][0]


def segmented(segments: int, order: int) -> Callable[[], Component]:
    """The window of 5 s in so many pieces."""
    return lambda: pseudospectral(
        DUFFING,
        sample_time=0.1,
        N=order,
        L=50,
        segments=segments,
        guess=gong_2007.GUESS,
        name=f"segments_{segments}",
    )


CASES = (
    Case("Ex. 4, 5 x 13", catalogue("duffing_known_pseudospectral"), example_4),
    Case("Ex. 4, tube, 5 x 13", catalogue("duffing_known_pseudospectral_tube"), example_4, 2e6),
    Case("Ex. 5, 5 x 13", catalogue("duffing_pseudospectral_5"), example_5),
    Case("Ex. 5, 1 x 50", segmented(1, 50), example_5),
    Case("no noise, 5 x 13", segmented(5, 13), clean),
    Case("no noise, 1 x 50", segmented(1, 50), clean),
    Case("Ex. 6 (DAE), 1 x 15", catalogue("rlc_pseudospectral"), example_6, 5e4),
    Case("Silverbox, 100 x 6", catalogue("silverbox_pseudospectral"), record),
    Case("Silverbox, arrival, 25 x 6", catalogue("silverbox_pseudospectral_short"), record),
)


def prepare(case: Case, driver: Path, directory: Path) -> tuple[Unpacked, Experiment, int, Cost]:
    """The FMU, what it is driven with, how often a round, and what is known of its cost.

    Raises:
        ExportError, BenchmarkError, RunError: it cannot be built, or fails.
    """
    begin = perf_counter()
    component = case.make()
    made = perf_counter()
    folder = directory / f"{CASES.index(case)}"
    fmu = unpack(export(component, folder), folder / "fmu")
    sources, library = sorted((fmu.directory / "sources").glob("*.c")), folder / "timed"
    # A cache of its own that knows the libraries and the shell, but not the functions.
    functions = next(path for path in sources if path.name == "functions.c")
    compile_c(
        [path for path in sources if path is not functions], folder / "shell", "-shared", cache=directory / "cache"
    )
    known = perf_counter()
    compile_c(sources, library, "-shared", "-s", "-lm", cache=directory / "cache")
    compiled = perf_counter()
    experiment = case.experiment()
    counted = drive_from_python(fmu, experiment)
    ns = drive(driver, fmu, experiment, 1).ns[0]
    runs = max(1, round(1e9 * SECONDS / (ns * len(experiment.samples))))
    cost = Cost(made - begin, compiled - known, [], counted.iterations, counted.failures)
    return fmu, experiment, runs, cost


def print_costs(out: Console, costs: dict[str, Cost]) -> None:
    """The table, then what was promised and found."""
    table = Table(
        title="Pseudospectral observer, driven natively, time per sample",
        box=SIMPLE_HEAD,
        pad_edge=False,
        collapse_padding=True,
    )
    for i, column in enumerate(("segments x N", "median", "min", "iter.", "fails", "build", "zig")):
        table.add_column(column, justify="right" if i else "left", no_wrap=True)
    for label, c in costs.items():
        median, least = (f"{ns / 1e3:.1f} us" for ns in (np.median(c.ns), np.min(c.ns)))
        table.add_row(
            label, median, least, f"{c.iterations:.2f}", str(c.failures), f"{c.make:.1f} s", f"{c.compile:.1f} s"
        )
    out.print(table)
    for case in CASES:
        if case.most_ns is not None:
            ns = float(np.median(costs[case.label].ns))
            kept = "[green]kept[/green]" if ns <= case.most_ns else "[red]broken[/red]"
            text = f"Promised: at most {case.most_ns / 1e3:,.0f} us ({case.label}). Found: {ns / 1e3:.1f} us, {kept}."
            out.print(text, highlight=False)


def main() -> None:
    """Build each observer, drive all by turns, print what a sample costs, and whether the promises are kept."""
    out = Console()
    with tempfile.TemporaryDirectory(prefix="benchmarks-") as scratch:
        directory = Path(scratch).resolve()
        driver = build_driver(directory)
        prepared = {case.label: prepare(case, driver, directory) for case in CASES}
        for _ in range(ROUNDS):
            for fmu, experiment, runs, cost in prepared.values():
                cost.ns.extend(drive(driver, fmu, experiment, runs).ns)
    print_costs(out, {label: cost for label, (_, _, _, cost) in prepared.items()})


if __name__ == "__main__":
    main()
