"""A system whose every name has been found in its FMUs: what `cosim.system.resolve` makes and the master runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fmpy.model_description import ModelDescription, ModelVariable

from cosim.errors import ExperimentError
from cosim.fmu import Value
from cosim.system.system import System
from cosim.system.transformation import Transformation

SHOWN = 4  # names in a note


@dataclass(frozen=True)
class Connection:
    """An output of one element that drives an input of another, after `steps`."""

    source: str
    output: ModelVariable
    target: str
    input: ModelVariable
    steps: tuple[Transformation, ...] = ()

    def __str__(self) -> str:
        return f"{self.source}.{self.output.name} -> {self.target}.{self.input.name}"


@dataclass(frozen=True)
class Supply:
    """An input or parameter of an element that a connector of the system gives its value."""

    connector: str
    target: str
    variable: ModelVariable
    steps: tuple[Transformation, ...]


@dataclass(frozen=True)
class Exposure:
    """An output of an element that a connector of the system shows, in `unit` ("" if it has none)."""

    connector: str
    source: str
    output: ModelVariable
    steps: tuple[Transformation, ...]
    unit: str


@dataclass(frozen=True)
class ResolvedSystem:
    """A system whose every name has been found in its FMUs.

    Attributes:
        system: what was resolved.
        descriptions: the model description of each element.
        variables: the variables of each element by name.
        static: the elements whose FMUs say that they have no state.
        connections: the connections between elements, in the system's order.
        supplies, exposures: those from and to the system's connectors.
        parameters: each element's parameter values, typed as their variables are.
        notes: what whoever runs it should know.
    """

    system: System
    descriptions: dict[str, ModelDescription]
    variables: dict[str, dict[str, ModelVariable]]
    static: frozenset[str]
    connections: list[Connection]
    supplies: list[Supply]
    exposures: list[Exposure]
    parameters: dict[str, dict[str, Value]]
    notes: list[str]

    def drivers(self) -> dict[str, str]:
        """What drives each connected input: the path of an output, or the name of a connector; by the input's path."""
        found = {f"{c.target}.{c.input.name}": f"{c.source}.{c.output.name}" for c in self.connections}
        return found | {f"{s.target}.{s.variable.name}": s.connector for s in self.supplies}

    def sources(self) -> dict[str, frozenset[str]]:
        """For each element those whose outputs drive its inputs."""
        found: dict[str, set[str]] = {name: set() for name in self.system.elements}
        for c in self.connections:
            found[c.target].add(c.source)
        return {name: frozenset(sources) for name, sources in found.items()}

    def experiment(self, stop: float | None = None, step: float | None = None) -> tuple[float, float]:
        """Stop time and step [s]: as given, else as the system says, else as its FMUs' default experiments say.

        Raises:
            ExperimentError: nobody says.
        """
        defaults = [d.defaultExperiment for d in self.descriptions.values() if d.defaultExperiment is not None]
        stops = [float(d.stopTime) for d in defaults if d.stopTime is not None]
        steps = [float(d.stepSize) for d in defaults if d.stepSize is not None]
        return (
            self._first("stop time", stop, self.system.stop, max(stops, default=None)),
            self._first("step size", step, self.system.step, min(steps, default=None)),
        )

    def _first(self, what: str, *candidates: float | None) -> float:
        for value in candidates:
            if value is not None:
                return value
        raise ExperimentError(f"system '{self.system.name}' and its FMUs name no {what}: give one")


def listed(names: Sequence[str]) -> str:
    """The first of `names`, and how many more there are."""
    rest = len(names) - SHOWN
    return ", ".join(names[:SHOWN]) + (f" and {rest} more" if rest > 0 else "")
