"""What an entry of the catalogue is, and how its scenario is written down."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from advice.streams.streams import Scenario
from observers.component import Component


@dataclass(frozen=True)
class Entry:
    """An observer: how it is made, what it is tried on, and its guess."""

    make: Callable[[], Component]
    scenario: Callable[[], Scenario]
    parameters: Mapping[str, float] = field(default_factory=dict)


def scenario(
    name: str, plant_of: Callable[[], Component], sample_time: float, samples: int, **more: Any
) -> Callable[[], Scenario]:
    """A scenario that is made when it is wanted, once."""
    return cache(lambda: Scenario(name, plant_of(), sample_time, samples, **more))
