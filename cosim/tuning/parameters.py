"""What of an FMU is tuned, found by the names of its parameters, and within which range."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from fmpy.model_description import ModelDescription, ModelVariable

from cosim.errors import ExperimentError
from cosim.fmu import Value, limits, unit_of

# Standard deviations and intensities by name, or the Riccati observer's and the least-squares observer's matrices in their place.
PROCESS = ("tuning.process_noise.", "tuning.N.")
MEASUREMENT = ("tuning.measurement_noise.", "tuning.R.")
INITIAL = ("tuning.initial_std.", "tuning.Q0.")
RANGE = 1e4  # times the start value and one over it: how far a value may go
GATE = "tuning.gate"
OPEN = 1e15  # a gate that no sample ever reaches: what is far off must count in a likelihood
# Entries of a tuning matrix, tuning.N[1,2]: whole matrices are not tuned, of which only the product with itself would count.
MATRIX = ("tuning.N[", "tuning.R[", "tuning.Q0[")


@dataclass(frozen=True)
class Parameter:
    """A positive number that is tuned: its name and unit, where the search starts, and the range of it."""

    name: str
    unit: str
    start: float
    least: float
    most: float

    @property
    def initial(self) -> bool:
        """Does it say how uncertain the guess is?"""
        return self.name.startswith(INITIAL)


@dataclass(frozen=True)
class Plan:
    """What is tuned; `zeros`: what could be but is 0; `settings`: what is set beside it, so that every sample counts."""

    parameters: tuple[Parameter, ...]
    zeros: tuple[str, ...]
    settings: Mapping[str, Value]


def plan(description: ModelDescription, held: Collection[str], starts: Mapping[str, Value], likelihood: bool) -> Plan:
    """The noises of an FMU.

    Args:
        description: the FMU's.
        held: names that are not tuned, because their values are given.
        starts: values to start the search from, by name; others start at the FMU's own.
        likelihood: without one the scale of all noises changes no prediction, and the guess says nothing of what follows: the
            measurement noise of the first output and how uncertain the guess is are then not tuned.

    Raises:
        ExperimentError: there is nothing to tune.
    """
    variables = {v.name: v for v in description.modelVariables}
    groups = (*PROCESS, *MEASUREMENT, *(INITIAL if likelihood else ()))
    named = [v for name, v in variables.items() if name.startswith(groups) and v.type == "Real"]
    if not likelihood:
        scales = [v for v in named if v.name.startswith(MEASUREMENT)]
        named = [v for v in named if v not in scales[:1]]
    open_to = [v for v in named if v.name not in held and v.causality == "parameter" and v.variability != "constant"]
    found = [(v, float(starts.get(v.name, v.start))) for v in open_to]
    parameters = tuple(_parameter(v, start) for v, start in found if start > 0)
    if not parameters:
        raise ExperimentError(f"{description.modelName}: {_nothing(variables, named)}")
    settings = {GATE: OPEN} if GATE in variables and GATE not in held else {}
    return Plan(parameters, tuple(v.name for v, start in found if not start > 0), settings)


def _parameter(variable: ModelVariable, start: float) -> Parameter:
    least, most = limits(variable)
    low, high = max(start / RANGE, least), min(start * RANGE, most)
    return Parameter(variable.name, unit_of(variable), start, low if low > 0 else start / RANGE, high)


def _nothing(variables: Mapping[str, ModelVariable], named: Collection[ModelVariable]) -> str:
    """Why nothing is tuned."""
    if named:
        return "nothing is left to tune: " + ", ".join(v.name for v in named) + " are set, or 0"
    matrices = [name for name in variables if name.startswith(MATRIX)]
    if matrices:
        return f"'{matrices[0]}' is an entry of a whole matrix, and these are not tuned: build it with noises by name"
    return (
        "has no noise to tune (tuning.process_noise.*, tuning.measurement_noise.*, tuning.initial_std.*, tuning.N.*, tuning.R.*, "
        "tuning.Q0.*)"
    )


def logarithms(parameters: Collection[Parameter]) -> tuple[list[float], list[tuple[float, float]]]:
    """The start of the search and its bounds, as natural logarithms."""
    return (
        [math.log(p.start) for p in parameters],
        [(math.log(p.least), math.log(p.most)) for p in parameters],
    )


def noises_of(description: ModelDescription, values: Mapping[str, Value]) -> dict[str, float]:
    """Those of the `values` that are noises of the FMU."""
    names = {v.name for v in description.modelVariables if v.name.startswith((*PROCESS, *MEASUREMENT, *INITIAL))}
    return {name: float(value) for name, value in values.items() if name in names}
