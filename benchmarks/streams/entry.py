"""What an entry of the catalogue is, and how its scenario and inputs are written down."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from benchmarks.streams.streams import Scenario, Values
from observers.component import Component


@dataclass(frozen=True)
class Entry:
    """An observer: how it is made, what it is tried on, and its guess."""

    make: Callable[[], Component]
    scenario: Callable[[], Scenario]
    parameters: Mapping[str, float] = field(default_factory=dict)


def steps(seed: int, samples: int, every: int, **bounds: tuple[float, float]) -> Values:
    """Inputs that jump to random values between their bounds every so many samples."""
    rng = np.random.default_rng([seed, 9])
    return {
        name: np.repeat(rng.uniform(low, high, samples // every + 1), every)[:samples]
        for name, (low, high) in bounds.items()
    }


def bands(seed: int, samples: int, sample_time: float, highest: float, **deviations: float) -> Values:
    """Inputs of twenty sines with random phases up to the `highest` frequency [Hz], by their standard deviations."""
    rng, times = np.random.default_rng([seed, 9]), sample_time * np.arange(samples)
    angles = 2 * np.pi * np.outer(highest * np.arange(1, 21) / 20, times)
    return {
        name: std / np.sqrt(10) * np.sum(np.sin(angles + rng.uniform(0, 2 * np.pi, (20, 1))), axis=0)
        for name, std in deviations.items()
    }


def waves(sample_time: float, samples: int, **waves: Callable[[np.ndarray], np.ndarray]) -> Values:
    """Inputs as functions of time."""
    return {name: wave(sample_time * np.arange(samples)) for name, wave in waves.items()}


def scenario(
    name: str, plant_of: Callable[[], Component], sample_time: float, samples: int, **more: Any
) -> Callable[[], Scenario]:
    """A scenario that is made when it is wanted, once."""
    return cache(lambda: Scenario(name, plant_of(), sample_time, samples, **more))
