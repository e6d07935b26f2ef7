"""Which row of a log is the sample of which instant."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cosim.errors import ExperimentError
from cosim.master import MOST_STEPS

COARSER = 1.01  # times the sample time: a log with a longer interval between its rows (median) leaves samples out
RESOLUTION = 1e-7  # of the sample time, that the doubles of the time column must resolve


@dataclass(frozen=True)
class Sampling:
    """The sample instants start + k Ts, k < n, over a log.

    Attributes:
        start: time of the first row [s].
        sample_time: Ts [s].
        rows: (n,) the row recorded nearest to each instant, -1 where none lies within Ts / 2.
        offsets: (n,) by how much that row lies after its instant [s], 0 where there is none.
    """

    start: float
    sample_time: float
    rows: np.ndarray
    offsets: np.ndarray


def sampling(log: Path, time: np.ndarray, sample_time: float) -> Sampling:
    """The rows of the file `log`, recorded at `time` (n,) [s], that an FMU takes which samples every `sample_time` [s].

    Raises:
        ExperimentError: the log is coarser than the sample time, longer than MOST_STEPS, or its times too large to resolve it.
    """
    if np.spacing(np.abs(time).max()) > RESOLUTION * sample_time:
        raise ExperimentError(
            f"{log}: times as large as {np.abs(time).max():.10g} s are too coarse in double precision for a sample time "
            f"of {sample_time:g} s: subtract the first one"
        )
    if len(time) > 1 and np.median(np.diff(time)) > COARSER * sample_time:
        raise ExperimentError(
            f"{log} is recorded every {np.median(np.diff(time)):g} s (median), but the FMU samples every {sample_time:g} s"
        )
    if (time[-1] - time[0]) / sample_time > MOST_STEPS:
        raise ExperimentError(f"{log}: more than {MOST_STEPS} samples of {sample_time:g} s")
    instants = np.rint((time - time[0]) / sample_time).astype(np.int64)
    offsets = time - (time[0] + instants * sample_time)
    rows = np.full(instants[-1] + 1, -1)
    # From the farthest row to the nearest, so that the nearest of an instant is what remains.
    for i in np.argsort(-np.abs(offsets), kind="stable"):
        rows[instants[i]] = i
    return Sampling(float(time[0]), sample_time, rows, np.where(rows >= 0, offsets[rows], 0.0))
