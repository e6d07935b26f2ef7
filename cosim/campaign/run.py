"""One run of a campaign: its errors and counts, enough of its trajectories for a figure, and the file that keeps both."""

from __future__ import annotations

import json
import math
import threading
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cosim.errors import SystemFileError
from cosim.fmu import Value
from cosim.master.slave import RunError
from cosim.master.watched import LIMIT, Child
from cosim.report.estimates import pairs
from cosim.results import Result
from cosim.whole import whole

SETTLE = 6.0  # [s]; Gong, Ross & Kang's Example 5 has a window of 5 s
ROWS = 2000  # of the trajectories that are kept of a run, at most
LARGEST_RECORD = 2**28  # bytes, inflated
COUNTERS = ("diagnostics.solver_failures", "diagnostics.rejected_samples")


@dataclass(frozen=True)
class Experiment:
    """What every run of a campaign shares.

    Attributes:
        overrides: start values that do not vary.
        stop, step: stop time and communication step [s].
        settle: how long after the start and after a jump of a true parameter an estimate is not yet settled [s].
        parameters: the columns of true parameters; a change of their value is a jump.
    """

    overrides: Mapping[str, Value]
    stop: float
    step: float
    settle: float
    parameters: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """What is kept of a run.

    Attributes:
        run: its number, from 0.
        values: the values of the varied variables.
        failure: why the run failed; "" if it did not. A failed run has no numbers and no rows.
        numbers: errors and counts by column name (see `rate`).
        time: (m,) [s], m <= ROWS.
        truths, estimates: (m, pairs), in the order of `cosim.estimates.pairs`.
    """

    run: int
    values: Mapping[str, float | int]
    failure: str
    numbers: Mapping[str, float | int]
    time: np.ndarray
    truths: np.ndarray
    estimates: np.ndarray


_here = threading.local()  # a worker may have several threads, and a child does one run at a time


def _child() -> Child:
    """The process in which this thread's runs happen, one after the other; it ends with this one."""
    if not hasattr(_here, "child"):
        _here.child = Child()
    child: Child = _here.child
    return child


def perform(
    system: Path, experiment: Experiment, number: int, values: Mapping[str, float | int], limit: float = LIMIT
) -> Outcome:
    """Run the system with the varied `values`. An FMU that fails, crashes or takes longer than `limit` [s] for a call makes a
    failed outcome, not an exception.

    Raises:
        SystemFileError, ExperimentError: as `cosim.master.run`.
    """
    try:
        overrides = {**experiment.overrides, **values}
        result = _child().run(system, stop=experiment.stop, step=experiment.step, overrides=overrides, limit=limit)
    except RunError as error:
        return failed(number, values, str(error))
    found = pairs(result)
    kept = slice(None, None, -(-len(result.time) // ROWS))
    return Outcome(
        run=number,
        values=values,
        failure="",
        numbers=rate(result, experiment),
        time=result.time[kept],
        truths=np.column_stack([result[pair.truth][kept] for pair in found]),
        estimates=np.column_stack([result[pair.estimate][kept] for pair in found]),
    )


def failed(number: int, values: Mapping[str, float | int], failure: str) -> Outcome:
    """The outcome of a run that failed."""
    return Outcome(number, values, failure, {}, np.empty(0), np.empty((0, 0)), np.empty((0, 0)))


def rate(result: Result, experiment: Experiment) -> dict[str, float | int]:
    """Errors and counts of a run, by column name.

    For each estimate and its truth `rms(...)` and `largest(...)` of the error at all communication points, and
    `settled_rms(...)` of those more than `settle` seconds after the start and after each jump (NaN if there are none). For
    each status output, at how many communication points each of its items held; the last values of the counters;
    `non_finite`, the number of communication points at which an output was not finite.
    """
    numbers: dict[str, float | int] = {}
    settled = settled_rows(result, experiment)
    for pair in pairs(result):
        error, label = pair.error(result), f"({pair.estimate} - {pair.truth})"
        numbers[f"rms{label}"] = float(np.sqrt(np.mean(error**2)))
        numbers[f"largest{label}"] = float(np.max(error))
        numbers[f"settled_rms{label}"] = float(np.sqrt(np.mean(error[settled] ** 2))) if settled.any() else np.nan
    for name, items in result.items.items():
        if name.endswith(".status"):
            numbers |= {f"{name}.{item}": int(np.sum(result[name] == value)) for value, item in items.items()}
    for name in result.names:
        if name.endswith(COUNTERS):
            numbers[name] = int(result[name][-1])
    numbers["non_finite"] = int(np.sum(~np.isfinite(result.values).all(axis=1)))
    return numbers


def settled_rows(result: Result, experiment: Experiment) -> np.ndarray:
    """Which communication points lie more than `settle` after the start and every jump of a true parameter, (n,) of bool."""
    jumps = [result.time[0]]
    for name in experiment.parameters:
        # The old value still holds at the instant of the jump, so the change shows one row later.
        jumps += list(result.time[:-1][np.diff(result[name]) != 0])
    since = np.array([result.time - jump for jump in jumps])
    slack = 1e-6 * experiment.step  # times are rounded
    return np.all((since < slack) | (since > experiment.settle + slack), axis=0) & (since[0] >= slack)


def save(outcome: Outcome, path: Path) -> None:
    """Write an outcome so that the file is there whole or not at all, whenever the process is killed."""
    head = {"run": outcome.run, "values": dict(outcome.values), "failure": outcome.failure}
    text = json.dumps(head | {"numbers": dict(outcome.numbers)})
    with whole(path) as partial, partial.open("wb") as file:
        np.savez_compressed(
            file, head=np.array(text), time=outcome.time, truths=outcome.truths, estimates=outcome.estimates
        )


def load(path: Path, number: int, values: Mapping[str, float | int], pairs: int) -> Outcome:
    """Read what `save` wrote of run `number`, which had `values` and has as many `pairs` of estimates and truths.

    Raises:
        SystemFileError: not that record.
    """
    try:
        made = _outcome(path)
        _check(made, number, values, pairs)
        return made
    except MemoryError:
        reason = "it asks for more memory than there is"
    # The zip file, its compression, numpy's format and JSON have errors of their own each.
    except Exception as error:
        reason = str(error) or type(error).__name__
    raise SystemFileError(f"{path}: not the record of this run ({reason}); delete it to run it again")


def _outcome(path: Path) -> Outcome:
    with zipfile.ZipFile(path) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
        if size > LARGEST_RECORD:
            raise ValueError(f"{size} bytes, more than {LARGEST_RECORD}")
        for name in ("head", "time", "truths", "estimates"):
            _check_header(archive, name)
    with np.load(path, allow_pickle=False) as stored:
        head = json.loads(str(stored["head"]))
        return Outcome(**head, time=stored["time"], truths=stored["truths"], estimates=stored["estimates"])


def _check_header(archive: zipfile.ZipFile, name: str) -> None:
    """Refuse an array whose header promises more than its entry holds, before numpy makes room for it."""
    with archive.open(f"{name}.npy") as entry:
        version = np.lib.format.read_magic(entry)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, kind = read(entry)
    if math.prod(shape) * kind.itemsize > archive.getinfo(f"{name}.npy").file_size:
        raise ValueError(f"the array '{name}' is cut off")


def _check(made: Outcome, number: int, values: Mapping[str, float | int], pairs: int) -> None:
    if made.run != number or dict(made.values) != dict(values):
        raise ValueError("it is that of another run")
    if not isinstance(made.failure, str) or not isinstance(made.numbers, dict):
        raise ValueError("its head is damaged")
    if any(type(value) not in (int, float) for value in made.numbers.values()):
        raise ValueError("one of its numbers is none")
    rows, wide = (0, 0) if made.failure else (len(made.time), pairs)
    shapes = {"time": (rows,), "truths": (rows, wide), "estimates": (rows, wide)}
    for name, shape in shapes.items():
        found = getattr(made, name)
        if found.shape != shape or found.dtype != np.float64:
            raise ValueError(f"the array '{name}' has the shape {found.shape}, not {shape}")
    if not made.failure and not rows:
        raise ValueError("it has no rows")
