"""What a step costs as native code and as a PythonFMU: python -m benchmarks.python_fmu"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from cosim.master import run

ROOT = Path(__file__).parent.parent
SYSTEMS = ("gong_example_1", "closed_loop_duffing", "closed_loop_motor")
STOP = 10.0  # [s]


def step_us(target: str, directory: Path) -> dict[tuple[str, str], float]:
    """Median microseconds of an fmi2DoStep, by system and element, of the systems built for `target` in `directory`."""
    chosen = [word for name in SYSTEMS for word in ("--only", name)]
    command = [
        sys.executable,
        str(ROOT / "build_fmus.py"),
        *chosen,
        "--target",
        target,
        "--out",
        str(directory / "fmus"),
    ]
    subprocess.run(command, check=True, capture_output=True)
    results = {name: run(directory / "systems" / f"{name}.ssp", stop=STOP) for name in SYSTEMS}
    return {
        (name, element): float(np.median(durations)) / 1e3
        for name, result in results.items()
        for element, durations in result.step_ns.items()
    }


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        native, python = (step_us(target, Path(folder) / target) for target in ("native", "python"))
    table = Table("system", "element", "native", "PythonFMU", title="One fmi2DoStep, median, us")
    for (system, element), value in native.items():
        table.add_row(system, element, f"{value:.1f}", f"{python[system, element]:.0f}")
    Console().print(table)


if __name__ == "__main__":
    main()
