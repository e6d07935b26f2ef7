"""Known inputs of a stream, by name, (samples,)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from advice.streams.streams import Values


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
