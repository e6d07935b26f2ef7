"""What a tool is asked to do: run an .ssp file and record all its outputs at every communication point."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cosim.master import count_steps
from cosim.system.resolve import resolve_ssp

# What a tool recorded: columns (n,) by name, `time` [s] first, then `<element>.<variable>`; row 0 after initialisation,
# row i after step i, as in results.csv.
Recording = dict[str, np.ndarray]


class MasterError(RuntimeError):
    """A tool is missing, refused the system, or failed with it; the message names the tool and what it said."""


@dataclass(frozen=True)
class Output:
    """An output of an element; `kind` is its FMI type, "Real", "Integer", "Boolean" or "Enumeration"."""

    element: str
    variable: str
    kind: str

    @property
    def column(self) -> str:
        return f"{self.element}.{self.variable}"


@dataclass(frozen=True)
class Experiment:
    """The default experiment of the .ssp file at `path`: `steps` steps of size `step` from `start` on [s]."""

    path: Path
    start: float
    step: float
    steps: int
    outputs: tuple[Output, ...]


def read_experiment(path: Path) -> Experiment:
    """The experiment that the .ssp file at `path` asks for.

    Raises:
        SystemFileError: the file or one of its FMUs is not sound.
        ExperimentError: the stop time is no whole number of steps away from the start, or nobody names a step.
    """
    with tempfile.TemporaryDirectory(prefix="cosim-") as directory:
        resolved = resolve_ssp(path, Path(directory))
    stop, step = resolved.experiment()
    start = resolved.system.start
    outputs = tuple(
        Output(element, variable.name, variable.type)
        for element, description in resolved.descriptions.items()
        for variable in description.modelVariables
        if variable.causality == "output" and variable.type != "String"
    )
    return Experiment(path, start, step, count_steps(start, stop, step), outputs)
