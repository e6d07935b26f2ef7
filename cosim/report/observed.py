"""What an observer in a run saw: its measurements beside their predictions, its known inputs, the deviations that it states."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cosim.results import Result


class Measurement(NamedTuple):
    """One measured input of an observer.

    Attributes:
        name, unit: of the input, `<observer>.<name>`.
        measured: (n,) what it was given.
        innovation: (n,) measured minus predicted, of the last sample instant before each row.
        deviation: (n,) the standard deviation that the observer expects of it, where it says so.
        sampled, predicted: the rows (m,) at which a sample was taken, and what the observer expected there (m,).
    """

    name: str
    unit: str
    measured: np.ndarray
    innovation: np.ndarray
    deviation: np.ndarray | None
    sampled: np.ndarray
    predicted: np.ndarray


def measurements(result: Result) -> list[Measurement]:
    """Those of all observers that put out innovations."""
    found = []
    names = set(result.names)
    for element in result.sources:
        inputs = {
            path: given for path, given in result.inputs.items() if path.startswith(f"{element}.") and given.measured
        }
        for i, (path, given) in enumerate(inputs.items(), start=1):
            index = f"[{i}]" if f"{element}.diagnostics.innovation[1]" in names else ""
            column = f"{element}.diagnostics.innovation{index}"
            if column not in names:
                continue
            spread = f"{element}.diagnostics.innovation_std.{path.removeprefix(f'{element}.')}"
            innovation = result[column]
            # The innovation of a sample at the start of a step is there from its end on, and stays until the next.
            sampled = np.flatnonzero(np.diff(innovation) != 0)
            predicted = given.values[sampled] - innovation[sampled + 1]
            deviation = result[spread] if spread in names else None
            found.append(Measurement(path, given.unit, given.values, innovation, deviation, sampled, predicted))
    return found


def known_inputs(result: Result) -> dict[str, tuple[np.ndarray, str]]:
    """Values (n,) and unit of what observers are told beside their measurements, by path."""
    observers = {name.partition(".estimate.")[0] for name in result.names if ".estimate." in name}
    return {
        path: (given.values, given.unit)
        for path, given in result.inputs.items()
        if not given.measured and any(path.startswith(f"{observer}.") for observer in observers)
    }


def deviation_of(result: Result, estimate: str) -> np.ndarray | None:
    """The standard deviation (n,) of the column `<observer>.estimate.<v>`, where the observer says one."""
    observer, _, variable = estimate.partition(".estimate.")
    name = f"{observer}.diagnostics.std.{variable}"
    return result[name] if name in result.names else None
