"""Exact response of c' = A c + B u, c(0) = 0, to an input that is held or linear between samples."""

from __future__ import annotations

import numpy as np
from flint import arb

from observers.numerics.exact import in_high_precision, matrix, rounded, table


@in_high_precision
def forced_response(
    A: np.ndarray, B: np.ndarray, sample_time: float, samples: int, times: np.ndarray, kind: str
) -> np.ndarray:
    """The matrix (len(times) nx) x (count nu) from the stacked input values to the stacked c at `times` in [0, samples * sample_time].

    `kind` "held": count = samples, u_i holds on [i Ts, (i + 1) Ts). "linear": count = samples + 1, u_i at i Ts. By the
    exponential of [[A, B, 0], [0, 0, I], [0, 0, 0]], whose second and third blocks are the input's value and slope.
    """
    nx, nu = B.shape
    count = samples + (kind == "linear")
    if nu == 0 or not B.any():
        return np.zeros((len(times) * nx, count * nu))
    augmented = matrix(
        np.block(
            [
                [A, B, np.zeros((nx, nu))],
                [np.zeros((nu, nx + nu)), np.eye(nu)],
                [np.zeros((nu, nx + 2 * nu))],
            ]
        )
    )
    Ts = arb(sample_time)

    def over(tau: arb, i: int, c: np.ndarray) -> np.ndarray:
        """c a time tau into interval i, from c at its start."""
        e = table((augmented * tau).exp())[:nx]
        response = table(matrix(e[:, :nx]) * matrix(c))
        value, slope = e[:, nx : nx + nu], e[:, nx + nu :]
        here, following = slice(i * nu, (i + 1) * nu), slice((i + 1) * nu, (i + 2) * nu)
        if kind == "linear":
            response[:, here] += value - slope / Ts
            response[:, following] += slope / Ts
        else:
            response[:, here] += value
        return response

    at_samples = [np.full((nx, count * nu), arb(0), dtype=object)]
    for i in range(samples):
        at_samples.append(over(Ts, i, at_samples[-1]))
    rows = []
    for time in times:
        i = interval(float(time), sample_time, samples)
        rows.append(over(arb(float(time)) - i * Ts, i, at_samples[i]))
    return rounded(np.vstack(rows))


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
