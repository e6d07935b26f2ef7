"""What varies between the runs of a campaign, and the values of each run: a pure function of the seed and the run's number."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from cosim.errors import ExperimentError, number
from cosim.fmu import INTEGER_LIMIT, Value, limits
from cosim.master import start_values
from cosim.system.resolve import find_variable
from cosim.system.resolved import ResolvedSystem

# The varied variables by path: uniform between two bounds, or (None) distinct whole numbers, such as seeds.
Variations = Mapping[str, tuple[float, float] | None]


def parse(texts: Iterable[str]) -> dict[str, tuple[float, float] | None]:
    """Variations from the command line: `plant.start.x1=-1:1` or `plant.sensor.seed`.

    Raises:
        ExperimentError: another form, or a variable named twice.
    """
    variations: dict[str, tuple[float, float] | None] = {}
    for text in texts:
        path, equals, bounds = (part.strip() for part in text.partition("="))
        low, colon, high = bounds.partition(":")
        if not path or bool(equals) != bool(colon):
            raise ExperimentError(f"--vary {text}: not of the form ELEMENT.VARIABLE=LOW:HIGH or ELEMENT.VARIABLE")
        if path in variations:
            raise ExperimentError(f"--vary {text}: '{path}' is varied twice")
        try:
            variations[path] = (number(low), number(high)) if colon else None
        except ValueError:
            raise ExperimentError(f"--vary {text}: '{low}' and '{high}' must be numbers") from None
    return variations


def check(variations: Variations, resolved: ResolvedSystem, overrides: Mapping[str, Value], runs: int) -> None:
    """Refuse what cannot be varied as asked, before anything runs.

    Raises:
        ExperimentError: an unknown or connected variable, one that is set too, a type other than Real and Integer, a range
            that is empty or leaves the variable's limits, a Real without a range, fewer distinct whole numbers than runs.
    """
    for path, bounds in variations.items():
        if path in overrides:
            raise ExperimentError(f"'{path}' is varied and set to {overrides[path]}: only one is possible")
        try:
            variable = find_variable(resolved.variables, path)[1]
        except ValueError as error:
            raise ExperimentError(str(error)) from None
        if variable.type not in ("Real", "Integer"):
            raise ExperimentError(f"'{path}' cannot be varied: its type is {variable.type}, not Real or Integer")
        if bounds is None:
            if variable.type == "Real":
                raise ExperimentError(f"'{path}' is a Real: it varies in a range, {path}=LOW:HIGH")
            least, count = _whole_numbers(resolved, path)
            if runs > count:
                raise ExperimentError(f"'{path}' has {count} values: too few for {runs} runs of distinct ones")
            start_values(resolved, {path: least})
        else:
            low, high = bounds
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise ExperimentError(f"'{path}': the range {low:g}:{high:g} must be finite and ascend")
            for bound in bounds:
                start_values(resolved, {path: bound})


def draw(variations: Variations, resolved: ResolvedSystem, seed: int, run: int) -> dict[str, float | int]:
    """The values of run `run`. A variable's values do not depend on what else is varied, nor on how many runs there are."""
    values: dict[str, float | int] = {}
    for path, bounds in variations.items():
        if bounds is None:
            # Consecutive numbers from a start of the variable's own, so that no two runs share one.
            least, count = _whole_numbers(resolved, path)
            first = int(np.random.default_rng([seed, *path.encode()]).integers(count))
            values[path] = least + (first + run) % count
            continue
        random = np.random.default_rng([seed, run, *path.encode()])
        low, high = bounds
        if find_variable(resolved.variables, path)[1].type == "Integer":
            values[path] = int(random.integers(int(low), int(high), endpoint=True))
        else:
            values[path] = float(random.uniform(low, high))
    return values


def _whole_numbers(resolved: ResolvedSystem, path: str) -> tuple[int, int]:
    """The least value of an Integer (0 where it has no limit) and how many there are from there on."""
    least, most = limits(find_variable(resolved.variables, path)[1])
    first = math.ceil(least) if math.isfinite(least) else 0
    last = math.floor(most) if math.isfinite(most) else INTEGER_LIMIT - 1
    return first, last - first + 1
