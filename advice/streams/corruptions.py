"""Twenty ways in which measurements and model part: what a sensor, its line, its clock or the plant does to a stream.

Each acts on one output while `during` holds (a slice of the samples), but for a jump and a mismatch, which stay. Sizes are in units of the
clean output's standard deviation over the stream.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

# (y (n,) with noise, its clean standard deviation, the noise's, during, random numbers) -> y as it arrives, (n,)
Damage = Callable[[np.ndarray, float, float, slice, np.random.Generator], np.ndarray]


@dataclass(frozen=True)
class Corruption:
    """`of_sensor`: what becomes of a noisy output. Otherwise the `plant` does it: "jump", "mismatch" or "jitter" (its clock)."""

    name: str
    of_sensor: Damage | None = None
    plant: str = ""

    @property
    def ends(self) -> bool:
        """Whether the stream is clean again after it."""
        return self.plant in ("", "jitter")


def _outlier(size: float, every: int) -> Damage:
    def damage(y: np.ndarray, std: float, noise: float, during: slice, rng: np.random.Generator) -> np.ndarray:
        hit = np.arange(during.start, during.stop, every)
        y[hit] += size * std * rng.choice([-1.0, 1.0], len(hit))
        return y

    return damage


def _within(change: Callable[[np.ndarray, float, float, np.random.Generator], np.ndarray]) -> Damage:
    def damage(y: np.ndarray, std: float, noise: float, during: slice, rng: np.random.Generator) -> np.ndarray:
        y[during] = change(y[during], std, noise, rng)
        return y

    return damage


def _late(y: np.ndarray, std: float, noise: float, during: slice, rng: np.random.Generator) -> np.ndarray:
    y[during] = y[during.start - LATE : during.stop - LATE].copy()
    return y


def _clipped(y: np.ndarray, std: float, noise: float, rng: np.random.Generator) -> np.ndarray:
    return np.clip(y, *np.quantile(y, [0.3, 0.7]))


def _time(y: np.ndarray) -> np.ndarray:
    return np.arange(len(y), dtype=float)


ONCE = 10**9  # samples between outliers of which there is one
LATE = 3  # samples
CLEAN = Corruption("clean")
CORRUPTIONS = (
    Corruption("outlier", _outlier(10.0, ONCE)),
    Corruption("huge_outlier", _outlier(1e6, ONCE)),
    Corruption("outliers", _outlier(5.0, 7)),
    Corruption("stuck", _within(lambda y, std, noise, rng: np.full_like(y, y[0]))),
    Corruption("offset", _within(lambda y, std, noise, rng: y + 0.5 * std)),
    Corruption("drift", _within(lambda y, std, noise, rng: y + std * _time(y) / len(y))),
    Corruption("nan", _within(lambda y, std, noise, rng: np.full_like(y, np.nan))),
    Corruption("zero", _within(lambda y, std, noise, rng: 0 * y)),
    Corruption("sign", _within(lambda y, std, noise, rng: -y)),
    Corruption("times_1000", _within(lambda y, std, noise, rng: 1000 * y)),
    Corruption("over_1000", _within(lambda y, std, noise, rng: y / 1000)),
    Corruption("gain", _within(lambda y, std, noise, rng: 1.3 * y)),
    Corruption("quantised", _within(lambda y, std, noise, rng: 0.5 * std * np.round(y / (0.5 * std)))),
    Corruption("clipped", _within(_clipped)),
    Corruption("late", _late),
    Corruption("jitter", plant="jitter"),
    Corruption("noise", _within(lambda y, std, noise, rng: y + np.sqrt(24.0) * noise * rng.standard_normal(len(y)))),
    Corruption("hum", _within(lambda y, std, noise, rng: y + 0.3 * std * np.sin(1.4 * _time(y)))),
    Corruption("jump", plant="jump"),
    Corruption("mismatch", plant="mismatch"),
)
