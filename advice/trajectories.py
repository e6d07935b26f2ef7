"""Motions of the model over its region, driven by inputs that excite it: what observers and observability are tried on.

Every seed is a motion of its own: even seeds are driven by steps, odd ones by sums of sines. One that leaves the bounds of its states, or
is not finite, is drawn again from a region half as wide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from advice.region import AdviceError, Ranges, Region, excluded
from advice.streams.corruptions import CLEAN, CORRUPTIONS
from advice.streams.inputs import bands, steps
from advice.streams.streams import Scenario, Streams, Values
from observers.model import Model, Variable

SETTLED = 0.3  # of the samples: until then an observer should have found the truth
STEPS = 20  # of an input, in a stream
SLOWEST = 40  # samples of the fastest sine's period
HALVINGS = 6
FACTORS = (
    1.25,
    0.8,
    1.1,
    0.9,
)  # of an unknown parameter that jumps, and of a known one that is not what the observer is told

Drive = Callable[[int, int], Values]


@dataclass(frozen=True)
class Trajectories:
    """Makes the streams of a seed. `scenario`: the plant and how it is measured; `recorded`: what drives known inputs in place of steps
    and sines.
    """

    model: Model
    region: Region
    scenario: Scenario
    recorded: Drive | None = None

    def streams(self, seed: int) -> Streams:
        """The streams of the motion `seed`, with a jump and a mismatch where the model has parameters for them.

        Raises:
            AdviceError: no motion from around the start values stays within the bounds.
        """
        reason = ""
        for halvings in range(HALVINGS + 1):
            scenario = self._scenario(seed, self.region.shrunk(0.5**halvings))
            made = Streams(scenario)
            reason = self._unfit(made, "clean", seed)
            if not reason:
                return self._changed(made, seed)
        raise AdviceError(
            f"model '{self.model.name}': no motion from around the start values can be followed: {reason}"
        )

    def _scenario(self, seed: int, region: Region) -> Scenario:
        states = {v.name for v in self.model.states}
        known = {v.name for v in self.model.inputs} if self.recorded else set()
        driven = {name: ends for name, ends in region.driven.items() if name not in known}
        excited, recorded = excitation(driven, self.scenario.sample_time), self.recorded
        start = {f"{'start' if n in states else 'parameter'}.{n}": value for n, value in region.start(seed).items()}
        return replace(
            self.scenario,
            start=start,
            spread=0.0,
            inputs=lambda number, n: excited(number, n) | (recorded(number, n) if recorded else {}),
        )

    def _changed(self, streams: Streams, seed: int) -> Streams:
        for change, variables in (("jump", self.model.unknown_parameters), ("mismatch", self.model.parameters)):
            for name, factor in _changes(streams.scenario, variables):
                changes = {change: (name, factor)}
                tried = Streams(replace(streams.scenario, **changes))  # type: ignore[arg-type]
                if not self._unfit(tried, change, seed):
                    streams = tried
                    break
        return streams

    def _unfit(self, streams: Streams, corruption: str, seed: int) -> str:
        """Why the motion cannot be followed; empty if it can."""
        try:
            stream = streams.stream(next(c for c in (CLEAN, *CORRUPTIONS) if c.name == corruption), seed)
        except ValueError as error:
            return str(error)
        bounded = (*self.model.states, *self.model.unknown_parameters)
        name = excluded(np.column_stack([stream.truth[f"x.{v.name}"] for v in bounded]), bounded)
        return f"'{name}' leaves its bounds" if name else ""


def excitation(ranges: Ranges, sample_time: float) -> Drive:
    """Inputs that move within their ranges: steps for even seeds, sums of sines for odd ones."""

    def drive(seed: int, samples: int) -> Values:
        if seed % 2 == 0:
            return steps(seed, samples, max(samples // STEPS, 1), **ranges)
        highest = 1 / (SLOWEST * sample_time)
        waves = bands(seed, samples, sample_time, highest, **{name: (b - a) / 4 for name, (a, b) in ranges.items()})
        return {name: np.clip((a + b) / 2 + waves[name], a, b) for name, (a, b) in ranges.items()}

    return drive


def _changes(scenario: Scenario, variables: Sequence[Variable]) -> list[tuple[str, float]]:
    """The first of the variables that a factor changes, with the factors that leave it within its bounds."""
    for v in variables:
        value = float(scenario.start.get(f"parameter.{v.name}", v.start))
        if value:
            return [(v.name, factor) for factor in FACTORS if v.min <= factor * value <= v.max]
    return []
