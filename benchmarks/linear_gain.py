"""What a sample of the Riccati and the least-squares observer costs, and how that grows with n: python -m benchmarks.linear_gain."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.native import Experiment, build_driver, drive, unpack
from fmu_src import export
from observers.component import Component
from observers.least_squares import least_squares
from observers.model import Model, Variable
from observers.riccati import riccati

SIZES = (2, 6, 12, 30)
SAMPLE_TIME = 0.01  # [s]
SAMPLES, RUNS = 1000, 9
MOST_NS = 1000.0  # for n = 2, promised


def chain(n: int) -> Model:
    """n coupled states, each pulled to its neighbours (linear, all entries of A constant), the first one measured."""

    def ode(x: object, u: object, p: object, t: object) -> list[object]:
        states = [getattr(x, f"x{i}") for i in range(n)]
        return [-states[i] + 0.5 * states[(i + 1) % n] - (0.3 * states[i - 1] if i else 0) for i in range(n)]

    return Model(
        name=f"chain_{n}",
        states=[Variable(f"x{i}") for i in range(n)],
        outputs=[Variable("y")],
        ode=ode,
        output=lambda x, u, p, t: [x.x0],
    )


def nanoseconds(component: Component, driver: Path, directory: Path) -> float:
    """Median over RUNS of the mean time of a sample (set y, doStep, get estimates), start included.

    Raises:
        ExportError, BenchmarkError: it cannot be built, or fails.
    """
    fmu = unpack(export(component, directory), directory / component.name)
    samples = np.sin(0.1 * np.arange(SAMPLES))
    outputs = [port.name for port in component.outputs if port.name.startswith("estimate.")]
    return float(np.median(drive(driver, fmu, Experiment(samples, SAMPLE_TIME, "y", outputs, {}), RUNS).ns))


def main() -> None:
    """Print the time for a sample against n, the growth's exponent between two sizes, and whether the promise is kept."""
    makers: dict[str, Callable[[Model], Component]] = {
        "Riccati": lambda model: riccati(model, sample_time=SAMPLE_TIME),
        "least squares": lambda model: least_squares(model, sample_time=SAMPLE_TIME, T=0.5, gamma=10.0),
    }
    out = Console()
    table = Table("observer", *[f"n = {n}" for n in SIZES], "growth", title="Time per sample, driven natively")
    first = {}
    with tempfile.TemporaryDirectory(prefix="benchmarks-") as scratch:
        directory = Path(scratch).resolve()
        driver = build_driver(directory)
        for name, make in makers.items():
            times = [nanoseconds(make(chain(n)), driver, directory) for n in SIZES]
            exponents = np.diff(np.log(times)) / np.diff(np.log(SIZES))
            table.add_row(name, *[f"{t / 1e3:.2f} us" for t in times], ", ".join(f"n^{e:.1f}" for e in exponents))
            first[name] = times[0]
    out.print(table)
    for name, ns in first.items():
        kept = "[green]kept[/green]" if ns <= MOST_NS else "[red]broken[/red]"
        out.print(f"Promised: at most 1 us for n = 2 ({name}). Found: {ns / 1e3:.2f} us, {kept}.", highlight=False)


if __name__ == "__main__":
    main()
