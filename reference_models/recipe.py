"""What a paper's file says of its experiments: FMUs to build and systems to couple, as names and numbers only."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from observers.component import Component

# An FMU: how to make its component, and the plant that drives it in its documentation's figure.
Source = tuple[Callable[[], Component], Callable[[], Component] | None]


@dataclass(frozen=True)
class Recipe:
    """A system: FMU names by element, parameter values by element, connections, stop time and step [s]."""

    description: str
    fmus: Mapping[str, str]
    parameters: Mapping[str, Mapping[str, float]]
    stop: float
    step: float
    connections: Sequence[tuple[str, str]] = (("plant.y", "observer.y"),)
