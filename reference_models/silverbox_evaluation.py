"""How well an observer explains the Silverbox's measurement: its stiffness, and what it predicts 20 samples ahead."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from reference_models.silverbox import K1, K3, SAMPLE_TIME, SILVERBOX

SETTLED = 2.0  # [s]: from here on the estimates count
AHEAD = 20  # samples


class Evaluation(NamedTuple):
    """Deviations of the average estimates from the fitted k1 and k3, relative to those, and the rms of y - prediction [V]."""

    k1_deviation: float
    k3_deviation: float
    prediction_rms: float


def evaluate(filtered: np.ndarray, u: np.ndarray, y: np.ndarray) -> Evaluation:
    """Rate the estimates x1, x2, k1, k3 of the sample instants, (n, 4), on the input and output measured there, (n,) [V]."""
    first = round(SETTLED / SAMPLE_TIME)
    k1, k3 = filtered[first:, 2].mean() / K1 - 1, filtered[first:, 3].mean() / K3 - 1
    predicted = predict(filtered[first:], u[first:])
    gap = y[first + AHEAD :] - predicted
    return Evaluation(float(k1), float(k3), float(np.sqrt(np.mean(gap**2))))


def predict(filtered: np.ndarray, u: np.ndarray) -> np.ndarray:
    """y AHEAD samples after each of the estimates (n, 4) [V], (n - AHEAD,): the model with the known input, linear in between."""
    starts = len(filtered) - AHEAD
    k1, k3 = filtered[:starts, 2], filtered[:starts, 3]
    d, c = (variable.start for variable in SILVERBOX.parameters)
    state = filtered[:starts, :2].T.ravel()
    for sample in range(AHEAD):
        now, after = u[sample : sample + starts], u[sample + 1 : sample + 1 + starts]

        def rhs(t: float, z: np.ndarray, now: np.ndarray = now, after: np.ndarray = after) -> np.ndarray:
            x1, x2 = z.reshape(2, -1)
            force = c * (now + (after - now) * t / SAMPLE_TIME)
            return np.concatenate([x2, -d * x2 - k1 * x1 - k3 * x1**3 + force])

        state = solve_ivp(rhs, (0.0, SAMPLE_TIME), state, method="DOP853", rtol=1e-6, atol=1e-9).y[:, -1]
    return state[:starts]
