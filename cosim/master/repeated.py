"""Runs of one system with many start values, in a process where its FMUs stay loaded: the parent's side of `repetition`."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

import numpy as np

from cosim.fmu import Value
from cosim.master.child import Again, Keep, Request, mapped
from cosim.master.repetition import ENDS, Detour
from cosim.master.slave import RunError
from cosim.master.watched import LIMIT, Child, absolute
from cosim.results import Result
from cosim.system import System


class Repeated:
    """Systems that a process of its own keeps loaded.

    Args:
        limit: how long a call of an FMU may take [s].
    """

    def __init__(self, limit: float = LIMIT) -> None:
        self._child, self._limit = Child(), limit
        self._kept: list[Kept] = []

    def __enter__(self) -> Repeated:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._child.kill()
        for kept in self._kept:
            kept.directory.cleanup()

    @property
    def alive(self) -> bool:
        """Has no FMU ended the process?"""
        return self._child.alive

    def load(
        self,
        system: System,
        overrides: Mapping[str, Value],
        inputs: Mapping[str, np.ndarray],
        detour: Detour | None = None,
    ) -> Kept:
        """Load a system, to be run from its start to its stop or less; arguments as of `cosim.master.run`.

        Raises:
            SystemFileError, ExperimentError, RunError: as there; a detour, and an FMU that cannot save its state.
        """
        directory = tempfile.TemporaryDirectory(prefix="cosim-", ignore_cleanup_errors=True)
        kept = Kept(self._child, self._limit, len(self._kept), directory)
        self._kept.append(kept)
        whole = absolute(system)
        kept.load(Keep(Request(whole, kept.folder, None, None, dict(overrides), dict(inputs)), detour))
        return kept


class Kept:
    """A system that is loaded as number `number`, its record in `directory`."""

    def __init__(self, child: Child, limit: float, number: int, directory: tempfile.TemporaryDirectory[str]):
        self._child, self._limit, self._number, self.directory = child, limit, number, directory
        self.folder = Path(directory.name).resolve()

    def load(self, wanted: Keep) -> None:
        self._child.send(wanted)
        _, self._begun = self._child.watch(self.folder, None, self._limit)

    def run(self, overrides: Mapping[str, Value], steps: int) -> Result:
        """The record of the first `steps` steps with these start values.

        Raises:
            ExperimentError: a value that its variable does not take.
            RunError: an FMU failed.
        """
        if not self._child.alive:
            raise RunError("", 0.0, "the process that keeps the FMUs has ended")
        self._child.send(Again(self._number, dict(overrides), steps))
        return self._child.watch(self.folder, None, self._limit, self._begun)[0]

    def ends(self, name: str) -> np.ndarray:
        """The Real output `name` at the ends of the last run's detours, (count,)."""
        (column,) = [column for known, kind, column in self._begun.outline.columns if known == name and kind == "Real"]
        shape, dtype = self._begun.shapes[ENDS]
        return np.array(mapped(self.folder, ENDS, shape, dtype, "r")[:, column])
