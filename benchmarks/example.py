"""Gong, Ross & Kang 2007, Example 1: the measurements that all is timed on, and where the observer starts."""

from __future__ import annotations

import numpy as np

from benchmarks.native import Experiment
from observers.instance import Instance
from reference_models.duffing import DUFFING
from reference_models.plant import plant

SAMPLE_TIME, N, L = 0.1, 15, 8
STOP = 50.0  # [s]
GUESS = {"x1": 0.0, "x2": 0.0, "theta": 0.1}


def measurements(sample_time: float, noise_bound: float = 0.0) -> np.ndarray:
    """y of the plant at t = 0, Ts, ... up to but without STOP, (STOP / Ts,).

    Args:
        sample_time: Ts [s].
        noise_bound: half-width of the uniform noise of the plant's sensor [m].
    """
    duffing = Instance(plant(DUFFING), {"sensor.noise_bound": noise_bound, "sensor.sample_time": sample_time})
    y = np.empty(round(STOP / sample_time))
    for k in range(len(y)):
        y[k] = duffing.get("y")
        duffing.step(duffing.time, sample_time)
    return y


def experiment(sample_time: float, noise_bound: float = 0.0) -> Experiment:
    """What the observer is driven with: read are the estimates of the current time, then those of the last sample."""
    return Experiment(
        samples=measurements(sample_time, noise_bound),
        step=sample_time,
        input="y",
        outputs=[f"{group}.{name}" for group in ("estimate", "filtered") for name in GUESS],
        start={f"guess.{name}": value for name, value in GUESS.items()},
    )
