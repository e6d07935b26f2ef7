"""A recorded log in place of a simulation's truth: it drives the motions, and observers are judged by how well they predict it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fmpy.model_description import ModelDescription, ModelVariable

from advice.region import Ranges, Region
from advice.streams.motion import Motion
from advice.streams.streams import Values
from advice.streams.verdicts import Tried, driven
from cosim.errors import ExperimentError, suggest
from cosim.replay.log import read_log
from cosim.replay.reading import Reading
from cosim.replay.replay import at_instants
from cosim.replay.sampling import sampling
from cosim.replay.signals import VALID, columns_of, converters, read, signals, time_column, times
from observers.model import Model

FEWEST = 100  # samples
PREDICTIONS = 200  # at most, spread over the record


@dataclass(frozen=True)
class Recorded:
    """A log at its sample instants, `sample_time` [s] apart: by name (n,), NaN where a measurement is missing."""

    path: Path
    sample_time: float
    measured: Values
    inputs: Values

    @property
    def samples(self) -> int:
        return len(next(iter(self.measured.values())))

    def drive(self, seed: int, samples: int) -> Values:
        """The known inputs of a part of the log, another one for each seed; from its end it goes on at its beginning."""
        rows = (np.arange(samples) + seed * samples) % self.samples
        return {name: values[rows] for name, values in self.inputs.items()}

    def region(self, model: Model, around: Region) -> Region:
        """The region of the data: known inputs, and states that are measured as they are."""
        inside = {name: _ends(values) for name, values in self.inputs.items()}
        return Region({**around.estimated, **self._shown(model)}, {**around.driven, **inside})

    def _shown(self, model: Model) -> Ranges:
        eq, bounds = model.equations, {v.name: (v.min, v.max) for v in model.states}
        shown = {}
        for i, output in enumerate(model.outputs):
            name = eq.output[i].name() if eq.output[i].is_symbolic() else ""
            if name in bounds:
                low, high = _ends(self.measured[output.name])
                shown[name] = (max(low, bounds[name][0]), min(high, bounds[name][1]))
        return shown


def recorded(
    path: Path,
    model: Model,
    sample_time: float | None = None,
    mapping: Mapping[str, str] | None = None,
    reading: Reading | None = None,
) -> Recorded:
    """Read a log with a column for each output and known input of the model.

    Args:
        mapping, reading: as for `cosim.replay.replay`.
        sample_time: between the rows of a log without a column `time` [s]; otherwise it is the median between its times.

    Raises:
        ExperimentError: the log cannot be read, lacks a column, is too short, or has a unit that is not the model's.
    """
    log, mapping = read_log(path, reading), mapping or {}
    wanted = (*model.outputs, *model.inputs)
    for v in wanted:
        if v.name not in mapping and log.find(v.name) is None:
            raise ExperimentError(f"{path}: there is no column '{v.name}'; {suggest(v.name, log.heads)}")
    # As an observer's FMU has them: measurements may be missing, known inputs hold their last value.
    inputs = {v.name: ModelVariable(v.name, 0, type="Real", causality="input", unit=v.unit) for v in wanted}
    flags = [f"{VALID}{v.name}" for v in model.outputs]
    inputs |= {name: ModelVariable(name, 0, type="Boolean", causality="input") for name in flags}
    columns = columns_of(log, inputs, mapping, dict.fromkeys(flags, True))
    instants = time_column(log, mapping, sample_time)
    rows = read(log, instants, converters(log, inputs, columns))
    taken = times(log, instants, rows, sample_time)
    if len(taken) < FEWEST:
        raise ExperimentError(f"{path}: {len(taken)} rows are too few to judge observers by, which takes {FEWEST}")
    Ts = float(f"{float(np.median(np.diff(taken))):.6g}")
    if not Ts > 0:
        raise ExperimentError(f"{path}: its times do not ascend")
    sampled = sampling(path, taken, Ts)
    values = signals(log, ModelDescription(unitDefinitions=[]), inputs, columns, rows).values
    outputs = {v.name: at_instants(values[v.name], sampled.rows, True)[:-1] for v in model.outputs}
    return Recorded(
        path, Ts, outputs, {v.name: at_instants(values[v.name], sampled.rows, False)[:-1] for v in model.inputs}
    )


def predictions(record: Recorded, motion: Motion, tried: Tried, ahead: int) -> dict[str, float]:
    """By output: rms of what was measured minus what the model predicts so many samples before, from the observer's estimate.

    The first third of the record is left out: there the observer settles.
    """
    n = record.samples
    rows, _ = driven(tried, record.measured | record.inputs, n, record.sample_time)
    names = [port.name for port in tried.component.outputs]
    estimates = rows[:, [names.index(f"estimate.{name}") for name in motion.estimated]]
    inputs = motion.inputs(record.inputs, n)
    measured = np.column_stack([*record.measured.values()])
    first, last = n // 3, n - ahead - 1
    begun = np.arange(first, last, max((last - first) // PREDICTIONS, 1))
    # What is read after sample k is of sample k + 1.
    shown = [motion.outputs(estimates[k], inputs[k + 1 : k + ahead + 2], (k + 1) * record.sample_time) for k in begun]
    gaps = np.array([last_of[-1] for last_of in shown]) - measured[begun + 1 + ahead]
    there = np.isfinite(measured[begun + 1 + ahead])
    gaps = np.where(there & ~np.isfinite(gaps), np.inf, gaps)
    return {name: float(np.sqrt(np.mean(gaps[there[:, i], i] ** 2))) for i, name in enumerate(record.measured)}


def _ends(values: np.ndarray) -> tuple[float, float]:
    return float(np.nanmin(values)), float(np.nanmax(values))
