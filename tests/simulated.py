"""Records of systems whose noises are known, with process noise, which no plant's FMU has."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from scipy.linalg import expm

TS = 0.1
SWING = np.array([[0.0, 1.0], [-1.0, 0.0]])  # the model `moved` of the tests' components
F = expm(SWING * TS)


def added(intensity: float) -> np.ndarray:
    """The covariance that process noise of the speed adds over a sample (Van Loan 1978)."""
    M = expm(np.block([[-SWING, np.diag([0.0, intensity**2])], [np.zeros((2, 2)), SWING.T]]) * TS)
    return M[2:, 2:].T @ M[:2, 2:]


def swing(n: int, seed: int, intensity: float, sensor: float, start: Sequence[float] = (1.0, -0.5)) -> np.ndarray:
    """n samples of the position."""
    rng, x, root = np.random.default_rng(seed), np.array(start), np.linalg.cholesky(added(intensity))
    y = np.empty(n)
    for k in range(n):
        y[k] = x[0] + sensor * rng.normal()
        x = F @ x + root @ rng.normal(size=2)
    return y


def diffusion(
    rate: Callable[[np.ndarray, float], np.ndarray],
    start: Sequence[float],
    intensity: Sequence[float],
    sample_time: float,
    n: int,
    rng: np.random.Generator,
    substeps: int,
) -> np.ndarray:
    """(n, states) at the samples: dx = rate(x, t) dt + intensity dw, the motion by Runge and Kutta, the noise once a substep."""
    h, x, found = sample_time / substeps, np.array(start), np.empty((n, len(start)))
    for k in range(n):
        found[k] = x
        noise = np.sqrt(h) * np.array(intensity) * rng.normal(size=(substeps, len(start)))
        for i in range(substeps):
            t = k * sample_time + i * h
            a = rate(x, t)
            b = rate(x + h / 2 * a, t + h / 2)
            c = rate(x + h / 2 * b, t + h / 2)
            d = rate(x + h * c, np.nextafter(t + h, t))  # an input that is held has not changed yet
            x = x + h / 6 * (a + 2 * b + 2 * c + d) + noise[i]
    return found


def write_log(path: Path, sample_time: float, **columns: np.ndarray) -> Path:
    """A log with the times and these columns."""
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    lines = [",".join(["time", *columns])]
    lines += [",".join([repr(k * sample_time), *map(repr, row)]) for k, row in enumerate(rows)]
    path.write_text("\n".join(lines) + "\n")
    return path
