"""What it costs that the plant is an FMU inside: observers from equations and from an FMU, side by side.

    python -m benchmarks.plant_inside

The FMUs are those of tests/plants/plants.c, whose right-hand sides are the equations, operation by operation.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.compiler import FMI_HEADERS, compile_c
from benchmarks.native import Experiment, build_driver, drive, execute, unpack
from fmu_src import PlantFMU, export
from observers.component import Component
from observers.model import Model
from observers.pseudospectral import pseudospectral
from observers.riccati import riccati
from observers.ukf import ukf

TESTS = Path(__file__).resolve().parents[1] / "tests"
SAMPLE_TIME = 0.05  # [s]
SAMPLES, RUNS = 1000, 9
MOST_NS = 50.0  # of an evaluation, beside the plant's own functions: promised
EVALUATIONS = 12  # of the rates, for a point and a step of order 8
MAKERS: dict[str, Callable[..., Component]] = {
    "ukf": ukf,
    "riccati": riccati,
    "pseudospectral": partial(pseudospectral, N=6, L=5),
}


def main() -> int:
    """Print the table; 1 where the promise is not kept."""
    sys.path.insert(0, str(TESTS))
    plant_fmu = import_module("plant_fmu")  # of the tests, beside which this is run

    out = Console()
    table = Table(
        "plant",
        "observer",
        "equations",
        "FMU inside",
        "ratio",
        "largest difference",
        title="Time per sample, driven natively",
    )
    with tempfile.TemporaryDirectory(prefix="benchmarks-") as scratch:
        folder = Path(scratch).resolve()
        driver = build_driver(folder)
        library = plant_fmu.compiled(folder)
        pairs: dict[str, tuple[Model, dict[str, Any]]] = {
            "van_der_pol": (plant_fmu.van_der_pol(), {"unknown_parameters": ["mu"]}),
            "pendulum": (plant_fmu.pendulum(), {"parameters": ["mass.m"], "unknown_parameters": ["spring.c"]}),
        }
        extra = 0.0
        for kind, (twin, chosen) in pairs.items():
            path = plant_fmu.write(folder / f"{kind}.fmu", library, kind, slopes=True)
            foreign = PlantFMU(path, outputs=["y"], inputs=["force"], **chosen)
            # A window does not converge on what is no motion of the pendulum.
            for name, make in list(MAKERS.items())[: 3 if kind == "van_der_pol" else 2]:
                times, records = [], []
                for label, model in (("equations", twin), ("inside", foreign)):
                    component = make(model, sample_time=SAMPLE_TIME)
                    fmu = unpack(export(component, folder / label), folder / label / component.name)
                    found = drive(driver, fmu, experiment(component), RUNS)
                    times.append(float(found.ns.min()))
                    records.append(found.record)
                apart = f"{np.nanmax(np.abs(records[1] - records[0])):.2g}"
                table.add_row(
                    kind,
                    name,
                    f"{times[0] / 1e3:.2f} us",
                    f"{times[1] / 1e3:.2f} us",
                    f"{times[1] / times[0]:.1f}",
                    apart,
                )
                if kind == "van_der_pol" and name == "ukf":
                    points = 2 * (len(twin.states) + len(twin.unknown_parameters)) + 1
                    extra = (times[1] - times[0]) / (points * (EVALUATIONS + 1))
        out.print(table)
        alone = inner(folder, library)
    kept = extra - alone <= MOST_NS
    out.print(
        f"An evaluation of the filter for van der Pol costs {extra:.0f} ns more inside, parameter changes and all; the plant's own "
        f"functions take {alone:.0f} ns of that, which leaves {extra - alone:.0f} (promised: {MOST_NS:.0f}): "
        f"{'kept' if kept else 'NOT KEPT'}"
    )
    return 0 if kept else 1


def inner(folder: Path, library: bytes) -> float:
    """Nanoseconds of the plant's own functions for an evaluation, the least of RUNS."""
    path, program = folder / "plants.so", folder / "inner"
    path.write_bytes(library)
    compile_c([Path(__file__).with_name("inner.c")], program, "-I", FMI_HEADERS, "-ldl")
    return min(float(execute([str(program), str(path), "van_der_pol", "2000000"]).split()[0]) for _ in range(RUNS))


def experiment(component: Component) -> Experiment:
    """The plant's motion is none of the samples'; both observers see the same."""
    times = SAMPLE_TIME * np.arange(SAMPLES)
    samples = np.column_stack([1.0 + 0.2 * np.sin(0.7 * times), 0.1 * np.cos(times)])
    outputs = [port.name for port in component.outputs if port.name.startswith("estimate.")]
    return Experiment(samples, SAMPLE_TIME, ("y", "force"), outputs, {})


if __name__ == "__main__":
    sys.exit(main())
