"""Where a model is tried: between which values its states and unknown parameters start, and its inputs move."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from observers.model import Model, Variable

PART = 0.5  # of the nominal value to either side of the start value, for states and unknown parameters
NOISE = 0.01  # of an output's nominal value, where nobody says what its noise is

Ranges = Mapping[str, tuple[float, float]]


class AdviceError(ValueError):
    """Nothing can be advised; the message names the model and why."""


@dataclass(frozen=True)
class Region:
    """Smallest and largest value by name: of `estimated` (states and unknown parameters) at the start, of `driven` inputs ever."""

    estimated: Ranges
    driven: Ranges

    def shrunk(self, part: float) -> Region:
        """The same around its middle, `part` as wide."""
        return Region(_shrunk(self.estimated, part), _shrunk(self.driven, part))

    def start(self, seed: int) -> dict[str, float]:
        """A value for each of `estimated`."""
        rng = np.random.default_rng([seed, 4])
        return {name: float(rng.uniform(low, high)) for name, (low, high) in self.estimated.items()}


def region(model: Model) -> Region:
    """Half a nominal value around the start values within the bounds; inputs between their bounds, or a nominal value around theirs."""
    return Region(
        {v.name: _around(v, PART) for v in (*model.states, *model.unknown_parameters)},
        {v.name: _bounded(v) for v in (*model.inputs, *model.unknown_disturbances)},
    )


def noise_of(model: Model, given: Mapping[str, float]) -> dict[str, float]:
    """The standard deviation of a sample of each output.

    Raises:
        AdviceError: one is given for what is no output, or is not positive and finite.
    """
    known = [v.name for v in model.outputs]
    for name, value in given.items():
        if name not in known:
            raise AdviceError(f"noise of '{name}': model '{model.name}' has no such output; known: {', '.join(known)}")
        if not (value > 0 and math.isfinite(value)):
            raise AdviceError(f"noise of '{name}' = {value:g} must be positive and finite")
    return {v.name: given.get(v.name, NOISE * v.nominal) for v in model.outputs}


def excluded(values: np.ndarray, variables: Sequence[Variable]) -> str:
    """The first of `variables` that leaves its bounds in `values` (n, variables), or is not finite; empty if none does."""
    for v, column in zip(variables, values.T, strict=True):
        if not (np.isfinite(column).all() and v.min <= column.min() and column.max() <= v.max):
            return v.name
    return ""


def _around(v: Variable, part: float) -> tuple[float, float]:
    return max(v.min, v.start - part * v.nominal), min(v.max, v.start + part * v.nominal)


def _bounded(v: Variable) -> tuple[float, float]:
    return (v.min, v.max) if math.isfinite(v.max - v.min) else _around(v, 1.0)


def _shrunk(ranges: Ranges, part: float) -> dict[str, tuple[float, float]]:
    return {
        name: ((low + high - part * (high - low)) / 2, (low + high + part * (high - low)) / 2)
        for name, (low, high) in ranges.items()
    }
