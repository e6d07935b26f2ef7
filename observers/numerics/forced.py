"""Exact response of c' = A c + B u, c(0) = 0, to an input that is held or linear between samples."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm


def forced_response(A: np.ndarray, B: np.ndarray, sample_time: float, samples: int, times: np.ndarray, kind: str) -> np.ndarray:
    """The matrix (len(times) nx) x (count nu) from the stacked input values to the stacked c at `times` in [0, samples * sample_time].

    `kind` "held": count = samples, u_i holds on [i Ts, (i + 1) Ts). "linear": count = samples + 1, u_i at i Ts. By the
    exponential of [[A, B, 0], [0, 0, I], [0, 0, 0]], whose second and third blocks are the input's value and slope.
    """
    nx, nu = B.shape
    count = samples + (kind == "linear")
    augmented = np.block(
        [
            [A, B, np.zeros((nx, nu))],
            [np.zeros((nu, nx + nu)), np.eye(nu)],
            [np.zeros((nu, nx + 2 * nu))],
        ]
    )

    def over(tau: float, i: int, c: np.ndarray) -> np.ndarray:
        """c a time tau into interval i, from c at its start."""
        e = expm(augmented * tau)[:nx]
        response = e[:, :nx] @ c
        value, slope = e[:, nx : nx + nu], e[:, nx + nu :]
        if kind == "linear":
            response[:, i * nu : (i + 1) * nu] += value - slope / sample_time
            response[:, (i + 1) * nu : (i + 2) * nu] += slope / sample_time
        else:
            response[:, i * nu : (i + 1) * nu] += value
        return response

    at_samples = [np.zeros((nx, count * nu))]
    for i in range(samples):
        at_samples.append(over(sample_time, i, at_samples[-1]))
    rows = []
    for time in times:
        i = interval(float(time), sample_time, samples)
        rows.append(over(float(time) - i * sample_time, i, at_samples[i]))
    return np.vstack(rows) if rows else np.zeros((0, count * nu))


def input_at(sample_time: float, samples: int, times: np.ndarray, kind: str) -> np.ndarray:
    """The weights (len(times) x count) of the input values in u(time)."""
    w = np.zeros((len(times), samples + (kind == "linear")))
    for row, time in zip(w, times, strict=True):
        i = interval(float(time), sample_time, samples)
        fraction = float(time) / sample_time - i
        if kind == "linear":
            row[i], row[i + 1] = 1 - fraction, fraction
        else:
            row[i] = 1.0
    return w


def interval(time: float, sample_time: float, samples: int) -> int:
    """Index of the sample interval that holds `time`; the window's end belongs to the last one."""
    return int(np.clip(np.floor(time / sample_time + 1e-9), 0, samples - 1))
