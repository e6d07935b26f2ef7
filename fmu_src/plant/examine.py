"""The parent of `probe`: what a plant answered, or one sentence that says what stands in the way."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fmu_src.errors import PlantError
from fmu_src.plant.description import PlantDescription, Scalar

PATIENCE = 120.0  # [s] for all points together


@dataclass(frozen=True)
class Selection:
    """What of a plant an observer uses: its known inputs, known and unknown parameters, and the outputs that are measured."""

    inputs: tuple[Scalar, ...]
    known: tuple[Scalar, ...]
    unknown: tuple[Scalar, ...]
    outputs: tuple[Scalar, ...]

    @property
    def parameters(self) -> tuple[Scalar, ...]:
        return (*self.known, *self.unknown)


@dataclass(frozen=True)
class Behaviour:
    """What the plant answered.

    `start`, `nominal` (nx) of its states; `parameters`, their values; `directional`: whether its directional derivatives of rates and of
    outputs are right; `rate`, `output`: which of states and inputs (columns) they depend on.
    """

    start: tuple[float, ...]
    nominal: tuple[float, ...]
    parameters: tuple[float, ...]
    directional: tuple[bool, bool]
    rate: np.ndarray
    output: np.ndarray


def examine(folder: Path, plant: PlantDescription, chosen: Selection) -> Behaviour:
    """The behaviour of the plant unpacked in `folder`.

    Raises:
        PlantError: it does not load, remembers, ends the process, or takes longer than PATIENCE.
    """
    where = f"plant '{plant.file}'"
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as scratch:
        request, answer, call = (Path(scratch) / name for name in ("request", "answer", "call"))
        request.write_text(json.dumps(_request(folder, plant, chosen)))
        command = [sys.executable, "-m", "fmu_src.plant.probe", str(request), str(answer), str(call)]
        try:
            done = subprocess.run(
                command,
                cwd=Path(__file__).resolve().parents[2],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                timeout=PATIENCE,
            )
        except subprocess.TimeoutExpired:
            raise PlantError(f"{where} does not come back from {_last(call)} within {PATIENCE:g} s") from None
        if not answer.is_file():
            raise PlantError(
                f"{where} {_ended(done)} in {_last(call)}: it cannot be asked for points of an observer's choice"
            )
        found = json.loads(answer.read_text())
    if "refused" in found:
        raise PlantError(f"{where} {found['refused']}")
    nx = len(plant.states)
    found_to_depend = np.array(found["depends"], dtype=bool).reshape(nx + len(chosen.outputs), nx + len(chosen.inputs))
    rows = [*plant.derivatives, *chosen.outputs]
    columns = [*plant.states, *chosen.inputs]
    pattern = _pattern(plant, rows, columns, found_to_depend)
    return Behaviour(
        tuple(found["start"]),
        tuple(found["nominal"]),
        tuple(found["parameters"]),
        (found["directional"][0], found["directional"][1]),
        pattern[:nx],
        pattern[nx:],
    )


def _request(folder: Path, plant: PlantDescription, chosen: Selection) -> dict[str, object]:
    def references(scalars: Sequence[Scalar]) -> list[int]:
        return [v.reference for v in scalars]

    around = (*plant.states, *chosen.inputs)
    return {
        "folder": str(folder),
        "guid": plant.guid,
        "identifier": plant.identifier,
        "states": references(plant.states),
        "derivatives": references(plant.derivatives),
        "inputs": references(chosen.inputs),
        "parameters": references(chosen.parameters),
        "outputs": references(chosen.outputs),
        "names": {
            "states": [v.name for v in plant.states],
            "derivatives": [v.name for v in plant.derivatives],
            "outputs": [v.name for v in chosen.outputs],
        },
        "nominals": [v.nominal for v in plant.states],
        "fixed": [v.variability == "fixed" for v in chosen.parameters],
        "unknown": [False] * len(chosen.known) + [True] * len(chosen.unknown),
        "input_starts": [v.start or 0.0 for v in chosen.inputs],
        "input_nominals": [v.nominal or 1.0 for v in chosen.inputs],
        "min": [max(v.min, -sys.float_info.max) for v in around],
        "max": [min(v.max, sys.float_info.max) for v in around],
        "parameter_min": [max(v.min, -sys.float_info.max) for v in chosen.parameters],
        "parameter_max": [min(v.max, sys.float_info.max) for v in chosen.parameters],
        "parameter_nominals": [v.nominal or 1.0 for v in chosen.parameters],
        "directional": plant.directional,
        "completes_steps": plant.completes_steps,
        "stop": plant.stop or 1.0,
    }


def _pattern(
    plant: PlantDescription, rows: Sequence[Scalar], columns: Sequence[Scalar], found: np.ndarray
) -> np.ndarray:
    """Which columns each row depends on: as declared, unless something declared is not true; then everything on everything."""
    declared: np.ndarray = np.ones(found.shape, dtype=bool)
    for i, row in enumerate(rows):
        if row.name in plant.dependencies:
            declared[i] = [column.name in plant.dependencies[row.name] for column in columns]
    return declared if not np.any(found & ~declared) else np.ones(found.shape, dtype=bool)


def _last(call: Path) -> str:
    name = call.read_bytes().split(b"\0")[0].decode().strip() if call.is_file() else ""
    return name or "its loading"


def _ended(done: subprocess.CompletedProcess[bytes]) -> str:
    if done.returncode < 0:
        return f"ends the process that asks it ({signal.Signals(-done.returncode).name})"
    lines = done.stderr.decode(errors="replace").strip().splitlines()
    return f"ends the process that asks it (exit code {done.returncode}{': ' + lines[-1][:200] if lines else ''})"
