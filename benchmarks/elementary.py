"""What a sample of the observer by elementary problems costs, and when solving them in parallel pays: python -m benchmarks.elementary."""

from __future__ import annotations

import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import dask
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.native import Experiment, build_driver, drive, unpack
from fmu_src import export
from observers.component import Component
from observers.elementary import elementary
from observers.elementary.iteration import elementary_solution
from observers.elementary.problems import GRID, LQ, decompose
from observers.instance import Instance
from observers.model import Model, Variable
from reference_models.calvillo_alamir import GUESS, SAMPLE_TIME, WEIGHTS_WITHOUT_V
from reference_models.plant import plant
from reference_models.van_der_pol import VAN_DER_POL_KNOWN

N, K = 41, 5
SAMPLES, RUNS = 200, 5
MOST_NS = 50e3  # for LQ, promised
CHAIN = 4  # states of the model whose problems are solved in parallel
NODES = (11, 81, 641)


def measured(model: Model) -> np.ndarray:
    """(SAMPLES, 3): y, u = sin t, mu = 0.1 sin t of the model's motion from its start values."""
    true, rows = Instance(plant(model)), []
    for k in range(SAMPLES):
        t = SAMPLE_TIME * k
        true.set("u", np.sin(t))
        true.set("mu", 0.1 * np.sin(t))
        rows.append([true.get("y"), np.sin(t), 0.1 * np.sin(t)])
        true.step(t, SAMPLE_TIME)
    return np.array(rows)


def nanoseconds(component: Component, samples: np.ndarray, driver: Path, directory: Path) -> np.ndarray:
    """Mean time of a sample in each of RUNS runs, with all K iterations at every sample.

    Raises:
        ExportError, BenchmarkError: it cannot be built, or fails.
    """
    fmu = unpack(export(component, directory), directory / component.name)
    start = {"tuning.epsilon": 0.0}
    return drive(driver, fmu, Experiment(samples, SAMPLE_TIME, ("y", "u", "mu"), ["estimate.x2"], start), RUNS).ns


def chain() -> Model:
    """CHAIN coupled states between bounds, the first one measured."""
    names = [f"x{i}" for i in range(CHAIN)]

    def ode(x: Any, u: Any, p: Any, t: Any) -> list[Any]:
        states = [getattr(x, name) for name in names]
        return [-states[i] + 0.5 * states[(i + 1) % CHAIN] for i in range(CHAIN)]

    return Model(
        name="chain",
        states=[Variable(name, start=1.0, min=-3.0, max=3.0) for name in names],
        outputs=[Variable("y")],
        ode=ode,
        output=lambda x, u, p, t: [x.x0],
    )


@cache
def solution(problem: int, nodes: int) -> ca.Function:
    """The solver of one of the chain's problems; each process makes it once."""
    model = chain()
    return elementary_solution(model, decompose(model, {v.name: GRID for v in model.states})[problem], N, nodes)


def solved(problem: int, nodes: int, arguments: list[Any]) -> np.ndarray:
    """xi of one elementary problem; what a worker is given."""
    return np.asarray(solution(problem, nodes)(*arguments)[0])


def parallel(nodes: int) -> tuple[float, float]:
    """Seconds for all problems of an iteration, each on a grid: one after the other, and by Dask in two processes."""
    data: list[Any] = [
        np.ones((CHAIN, N)),
        np.zeros((0, N - 1)),
        np.ones((1, N)),
        np.ones((1, N)),
        np.zeros((0, N - 1)),
    ]
    data += [np.zeros((0, N - 1)), np.zeros((0, N)), np.ones((1, N - 1)), 2.0, SAMPLE_TIME, []]
    arguments: list[Any] = [*data, [1.0, 1.0], np.zeros((1, N - 1))]

    def once(**how: Any) -> float:
        began = time.perf_counter()
        dask.compute(*[dask.delayed(solved)(problem, nodes, arguments) for problem in range(CHAIN)], **how)
        return time.perf_counter() - began

    once(scheduler="sync")
    alone = min(once(scheduler="sync") for _ in range(3))
    with ProcessPoolExecutor(2) as pool:
        together = [once(scheduler="processes", pool=pool, chunksize=1) for _ in range(6)]
    return alone, min(together)  # the first ones make the solvers


def main() -> None:
    """Print the time of a sample at each level, whether the promise is kept, and the gain of parallel problems against the grid's size."""
    out = Console()
    options: dict[str, Any] = {
        "sample_time": SAMPLE_TIME,
        "N": N,
        "K": K,
        "guess": GUESS,
        "stop_time": 1.0,
        **WEIGHTS_WITHOUT_V,
    }
    linear = Model(
        name="oscillator",
        states=VAN_DER_POL_KNOWN.states,
        inputs=VAN_DER_POL_KNOWN.inputs,
        outputs=VAN_DER_POL_KNOWN.outputs,
        ode=lambda x, u, p, t: [x.x2 + u.u, -9 * x.x1 + 0.1 * u.mu * x.x2],
        output=lambda x, u, p, t: [x.x1],
    )
    all_on_grid = {"x1": GRID, "x2": GRID}
    cases = {
        "LQ (linear oscillator)": (linear, {}),
        "LQ and Gauss-Newton (Van der Pol)": (VAN_DER_POL_KNOWN, {}),
        "grid, 81 nodes (Van der Pol)": (VAN_DER_POL_KNOWN, all_on_grid),
    }
    assert [problem.level for problem in decompose(linear, {})] == [LQ, LQ]
    table = Table("level", "median", "minimum", title=f"Time per sample, N = {N}, {K} iterations each, driven natively")
    first = None
    with tempfile.TemporaryDirectory(prefix="benchmarks-") as scratch:
        directory = Path(scratch).resolve()
        driver = build_driver(directory)
        for number, (label, (model, levels)) in enumerate(cases.items()):
            component = elementary(model, levels=levels, name=f"elementary_{number}", **options)
            ns = nanoseconds(component, measured(model), driver, directory)
            table.add_row(label, f"{np.median(ns) / 1e3:.1f} us", f"{ns.min() / 1e3:.1f} us")
            first = float(np.median(ns)) if first is None else first
    out.print(table)
    kept = "[green]kept[/green]" if first is not None and first <= MOST_NS else "[red]broken[/red]"
    out.print(f"Promised: at most 50 us for LQ. Found: {(first or 0) / 1e3:.1f} us, {kept}.", highlight=False)
    gains = Table(
        "nodes", "one after the other", "two processes", title=f"{CHAIN} grid problems of an iteration, in Python"
    )
    for nodes in NODES:
        alone, together = parallel(nodes)
        gains.add_row(str(nodes), f"{alone * 1e3:.0f} ms", f"{together * 1e3:.0f} ms")
    out.print(gains)


if __name__ == "__main__":
    main()
