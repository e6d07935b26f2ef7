"""The same system in several tools: what each records, and how far they lie apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from cosim.errors import ExperimentError, suggest
from cosim.master.watched import LIMIT as CALL_LIMIT
from cosim.masters import fmpy, process
from cosim.masters.experiment import Recording, read_experiment

# Our master needs no process of its own; the others are named like their modules in cosim/masters.
MASTERS = ("fmpy", "ecos", "libcosim")
LIMIT = 1e-12  # relative


def record_all(system: Path, masters: Sequence[str], call_limit: float = CALL_LIMIT) -> dict[str, Recording]:
    """The recordings of the .ssp file at `system` by each of `masters`, by name.

    A call of an FMU, and in other tools a step of all of them, may take `call_limit` [s].

    Raises:
        ExperimentError: an unknown master, or less than two different ones.
        SystemFileError: the file is not sound.
        RunError, MasterError: one of them could not run it.
    """
    for name in masters:
        if name not in MASTERS:
            raise ExperimentError(f"there is no master '{name}'; {suggest(name, MASTERS)}")
    if len(masters) < 2 or len(set(masters)) < len(masters):
        raise ExperimentError(f"masters '{','.join(masters)}': a comparison needs two or more different ones")
    experiment = read_experiment(system)
    return {
        name: fmpy.record(experiment, call_limit) if name == "fmpy" else process.record(name, system, call_limit)
        for name in masters
    }


def differences(reference: Recording, other: Recording) -> dict[str, float | None]:
    """The largest difference of each column of `reference`; None where `other` has none."""
    return {name: _difference(column, other[name]) if name in other else None for name, column in reference.items()}


def _difference(a: np.ndarray, b: np.ndarray) -> float:
    """The largest of `differing`; infinite where the lengths differ."""
    return float(np.max(differing(a, b), initial=0.0)) if a.shape == b.shape else np.inf


def differing(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """|a - b| / max(|a|, |b|), (n,): relative to the column's largest. Equal values and two NaNs differ by 0, and infinitely two values of
    which only one is finite.
    """
    unequal = ~((a == b) | (np.isnan(a) & np.isnan(b)))
    found, both = np.zeros(len(a)), np.isfinite(a) & np.isfinite(b)
    if unequal.any():
        found[unequal & ~both] = np.inf
        finite = np.concatenate([a[np.isfinite(a)], b[np.isfinite(b)], [0.0]])
        compared = unequal & both
        found[compared] = np.abs(a - b)[compared] / np.max(np.abs(finite))
    return found


def largest(found: Mapping[str, float | None]) -> float:
    """The largest of the differences that there are."""
    return max((value for value in found.values() if value is not None), default=0.0)
