"""The filters beside the same filters in plain C, `floor.c`: instructions and time per sample: python -m benchmarks.filters."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks import callgrind
from benchmarks.compiler import compile_c
from benchmarks.native import Experiment, build_driver, drive, execute, unpack
from fmu_src import export
from observers.component import Component
from observers.instance import Instance
from observers.model import Model, Variable
from observers.riccati import riccati
from observers.ukf import ukf
from reference_models.duffing import DUFFING
from reference_models.plant import plant

SIZES = (2, 6, 12, 30, 50)
SAMPLE_TIME = 0.01  # [s], of the chain
DUFFING_SAMPLE_TIME = 0.1
SAMPLES, RUNS = 200, 9
NOISE, OFF = 0.1, 0.5
SOURCE = Path(__file__).with_name("floor.c")
MOST, LARGE, MOST_LARGE = 1.5, 30, 2.0  # wanted ratios, from n = LARGE on the second


@dataclass(frozen=True)
class Case:
    """A filter, and what the compiler makes its floor of."""

    label: str
    model: Model
    make: Callable[..., Component]
    sample_time: float
    defines: tuple[str, ...]

    @property
    def n(self) -> int:
        return len(self.model.states) + len(self.model.unknown_parameters)

    def component(self) -> Component:
        return self.make(self.model, sample_time=self.sample_time, measurement_noise={"y": NOISE})

    def samples(self) -> np.ndarray:
        """What the model's plant measures, its first state moved off where the filter starts (SAMPLES)."""
        first = self.model.states[0]
        moved = Instance(plant(self.model), {f"start.{first.name}": first.start + OFF})
        y = np.empty(SAMPLES)
        for k in range(SAMPLES):
            y[k] = moved.get("y")
            moved.step(k * self.sample_time, self.sample_time)
        return y


@dataclass(frozen=True)
class Cost:
    """Of the FMU and of the floor: instructions per sample (None without valgrind), nanoseconds; how far their last estimates are apart."""

    instructions: tuple[float, float] | None
    ns: tuple[float, float]
    apart: float


def oscillators(n: int) -> Model:
    """n / 2 masses in a row, each held by its neighbours and by a hardening spring; the position of the first is measured."""
    half = n // 2

    def ode(x: object, u: object, p: object, t: object) -> list[object]:
        q, v = ([getattr(x, f"{letter}{i}") for i in range(half)] for letter in "qv")
        left, right = [0, *q[:-1]], [*q[1:], 0]
        pulled = [left[i] - 2 * q[i] + right[i] - 0.1 * v[i] - q[i] ** 3 for i in range(half)]
        return [*v, *pulled]

    return Model(
        name=f"oscillators_{n}",
        states=[Variable(f"{letter}{i}") for letter in "qv" for i in range(half)],
        outputs=[Variable("y")],
        ode=ode,
        output=lambda x, u, p, t: [x.q0],
    )


def cases() -> list[Case]:
    """What is compared."""

    def case(label: str, n: int, make: Callable[..., Component], *more: str) -> Case:
        return Case(f"{label}, n = {n}", oscillators(n), make, SAMPLE_TIME, (f"CHAIN={n}", "STEPS=1", *more))

    defines = ("DUFFING", "STEPS=2", "UNSCENTED")
    duffing = Case("UKF, Duffing", DUFFING, ukf, DUFFING_SAMPLE_TIME, defines)
    fourth = Case("UKF of order 4, Duffing", DUFFING, partial(ukf, order=4), DUFFING_SAMPLE_TIME, defines)
    return [
        *(case("Riccati", n, partial(riccati, order=4)) for n in SIZES),
        duffing,
        fourth,
        *(case("UKF", n, partial(ukf, order=4), "UNSCENTED") for n in SIZES),
    ]


def cost(case: Case, driver: Path, directory: Path) -> Cost:
    """Both driven by the same samples.

    Raises:
        ExportError, BenchmarkError: one cannot be built, or fails.
    """
    component = case.component()
    fmu = unpack(export(component, directory), directory / component.name)
    samples = case.samples()
    outputs = [port.name for port in component.outputs if port.name.startswith("estimate.")]
    work = Experiment(samples, case.sample_time, "y", outputs, {})
    floor, file = directory / f"{component.name}_floor", directory / "samples.bin"
    settings = (*case.defines, f"SAMPLE_TIME={case.sample_time}")
    compile_c([SOURCE], floor, *(f"-D{setting}" for setting in settings), "-lm")
    samples.tofile(file)
    natively = drive(driver, fmu, work, RUNS)
    printed = [float(line) for line in execute([str(floor), str(file), str(RUNS)]).split()]
    instructions = None
    if callgrind.is_installed():
        whole, idle = (callgrind.instructions([str(floor), str(file), runs]) for runs in ("1", "0"))
        instructions = callgrind.per_sample(driver, fmu, work), (whole - idle) / SAMPLES
    apart = float(np.max(np.abs(natively.record[-1] - printed[RUNS:])))
    return Cost(instructions, (float(np.median(natively.ns)), float(np.median(printed[:RUNS]))), apart)


def main() -> None:
    """Print instructions and time of each filter, of its floor, and the ratio, and whether it is as small as wanted."""
    out = Console()
    columns = ("filter", "instructions", "floor", "ratio", "time", "floor", "ratio", "apart by", "wanted")
    table = Table(*columns, title="Per sample, beside plain C")
    with tempfile.TemporaryDirectory(prefix="benchmarks-") as scratch:
        directory = Path(scratch).resolve()
        driver = build_driver(directory)
        for case in cases():
            if sys.argv[1:] and not any(word in case.label for word in sys.argv[1:]):
                continue
            found = cost(case, driver, directory)
            counts = found.instructions or found.ns
            ratio, most = counts[0] / counts[1], MOST_LARGE if case.n >= LARGE else MOST
            shown = [f"{value:,.0f}" for value in counts] if found.instructions else ["-", "-"]
            times = [f"{value / 1e3:.2f} us" for value in found.ns]
            kept = "[green]yes[/green]" if ratio <= most else "[red]no[/red]"
            table.add_row(
                case.label,
                *shown,
                f"{ratio:.2f}",
                *times,
                f"{found.ns[0] / found.ns[1]:.2f}",
                f"{found.apart:.0e}",
                f"{most:g}: {kept}",
            )
    out.print(table)


if __name__ == "__main__":
    main()
