"""The largest value of a function of logarithms of noises, without derivatives, and how sharply the data determine it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

Loss = Callable[[np.ndarray], float]

SCALES = math.log(10) * np.arange(-4, 5)  # where each noise for itself is looked for
REACH = 1.0  # of the logarithms: first radius of a round
CLOSE = 3e-3  # the last one
ROUNDS = 4  # at most; each starts where the one before ended, and looks as far around as that did
GAIN = 0.1  # of a log-likelihood: a round that gains less was the last
EVALUATIONS = 30  # of a round, at most, for each parameter, and as many besides
LOST = 1e6  # what is added to the largest loss so far where there is none: the optimiser wants a number
STEP = 0.2  # of the logarithms, for the curvature
FLAT = 1e-4  # the least curvature


@dataclass(frozen=True)
class Found:
    """The place of the least loss, the loss there, and the number of evaluations that it took."""

    x: np.ndarray
    loss: float
    evaluations: int


def search(
    loss: Loss, start: Sequence[float], bounds: Sequence[tuple[float, float]], progress: Callable[[int, int], None]
) -> Found:
    """The least loss from `start` on, by COBYQA (Ragonneau 2022), which models the loss by quadratics within bounds.

    It begins where each noise for itself, the others as they were, explains most. So one that is much too small beside the others begins
    large: once others explain the data for it, its slope is 0. A round that ended in a valley or at a failure of the FMU is followed by one
    that looks as far around again. `progress` is called with the evaluations done and the most that there can be.
    """
    kept = _Kept(loss, progress, (len(SCALES) + ROUNDS * EVALUATIONS) * (len(start) + 1))
    begin, best = _scanned(kept, np.array(start), np.array(bounds)), math.inf
    for _ in range(ROUNDS):
        minimize(
            kept,
            kept.x if math.isfinite(best) else begin,
            method="COBYQA",
            bounds=bounds,
            options={
                "initial_tr_radius": REACH,
                "final_tr_radius": CLOSE,
                "maxfev": EVALUATIONS * (len(start) + 1),
            },
        )
        if best - kept.least < GAIN:
            break
        best = kept.least
    return Found(kept.x, kept.least, kept.count)


def _scanned(loss: Loss, start: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """For each entry of `start` what is best of SCALES of it within the bounds, the others as they are."""
    found = np.array(start)
    for i, (least, most) in enumerate(bounds):
        tried = start[i] + SCALES[(start[i] + SCALES >= least) & (start[i] + SCALES <= most)]
        points = np.where(np.arange(len(start)) == i, tried[:, None], start)
        found[i] = tried[int(np.argmin([loss(x) for x in points]))]
    return found


class _Kept:
    """A loss that remembers the best place; a number everywhere."""

    def __init__(self, loss: Loss, progress: Callable[[int, int], None], most: int):
        self._loss, self._progress, self._most = loss, progress, most
        self.least, self._largest, self.count = math.inf, 0.0, 0
        self.x = np.zeros(0)

    def __call__(self, x: np.ndarray) -> float:
        value = self._loss(x)
        self.count += 1
        self._progress(self.count, self._most)
        if not math.isfinite(value):
            return self._largest + LOST
        self._largest = max(self._largest, value)
        if value < self.least:
            self.least, self.x = value, np.array(x)
        return value


def spread(loss: Loss, x: np.ndarray, least: float) -> np.ndarray:
    """Standard deviations (n) of the logarithms `x` (n) of the least loss, by its curvature there; large where it is flat."""
    n = len(x)
    steps = STEP * np.eye(n)
    up, down = np.array([loss(x + s) for s in steps]), np.array([loss(x - s) for s in steps])
    H = np.diag(up + down - 2 * least)
    for i in range(n):
        for j in range(i):
            H[i, j] = H[j, i] = loss(x + steps[i] + steps[j]) - up[i] - up[j] + least
    H = np.where(np.isfinite(H), H / STEP**2, 0.0)
    curvatures, directions = np.linalg.eigh(H)
    return np.sqrt((directions**2 / np.maximum(curvatures, FLAT)).sum(axis=1))
