"""One instance of an FMU: raw statuses, values by variable, its memory on record."""

from __future__ import annotations

import ctypes
import math
import time
from collections.abc import Sequence
from ctypes import c_int, c_uint
from dataclasses import dataclass
from typing import Any

import fmpy
from fmpy import fmi2

from fmu_src.compliance.files.description import Value, Variable
from fmu_src.compliance.library.calls import ERROR, KINDS, OK, PENDING, WARNING, Broken, Library, status_name
from fmu_src.compliance.rules import finding

Rows = list[dict[str, Value]]  # by variable, at successive communication points


@dataclass
class Progress:
    """How far an instance has come: what a state of the FMU does not hold. Times in [s], of model exchange.

    `ended`: the FMU has asked for the end of the simulation.
    """

    time: float
    steps: int = 0
    next_event: float = math.inf
    ended: bool = False


class Instance:
    """An instance in co-simulation. `blocks`: the memory that it took and did not give back."""

    def __init__(self, fmu: Library, name: str):
        self.fmu = fmu
        self.subject = fmu.subject
        self.name = name
        self.pointer: Any = None
        self.progress = Progress(self.subject.start)
        self.blocks: set[int] = set()

        def allocate(count: int, size: int) -> int | None:
            block: int | None = fmpy.calloc(count, size)
            if block:
                self.blocks.add(block)
            return block

        def free(block: int | None) -> None:
            self.blocks.discard(block or 0)
            fmpy.free(block)

        self.callbacks = fmi2.fmi2CallbackFunctions(
            logger=fmu.logger,
            allocateMemory=fmi2.fmi2CallbackAllocateMemoryTYPE(allocate),
            freeMemory=fmi2.fmi2CallbackFreeMemoryTYPE(free),
        )
        _formats_messages(self.callbacks)

    @property
    def time(self) -> float:
        """The current communication point; counted, not accumulated."""
        return self.subject.start + self.progress.steps * self.subject.step

    @property
    def reason(self) -> str:
        """The last message, to stand behind what happened."""
        return f": {self.fmu.messages[-1][3].strip()}" if self.fmu.messages else ""

    def call(self, name: str, *arguments: Any) -> int:
        """Call a function that returns a status; a pending one is waited for.

        Raises:
            Broken: it stays pending.
        """
        status: int = self.fmu.function(name)(self.pointer, *arguments)
        if status != PENDING:
            return status
        begin = time.monotonic()
        answer = c_int(PENDING)
        while time.monotonic() - begin < self.fmu.patience:
            time.sleep(1e-3)
            if self.fmu.function("fmi2GetStatus")(self.pointer, fmi2.fmi2DoStepStatus, ctypes.byref(answer)) != OK:
                return ERROR
            if answer.value != PENDING:
                return answer.value
        raise Broken(finding("legal-call", name, "an end of fmi2Pending", f"fmi2Pending for {self.fmu.patience:g} s"))

    def legal(self, name: str, *arguments: Any, about: str = "") -> None:
        """Call a function that must succeed.

        Raises:
            Broken: it does not.
        """
        status = self.call(name, *arguments)
        if status not in (OK, WARNING):
            subject = f"{name} of {about}" if about else name
            raise Broken(finding("legal-call", subject, "fmi2OK", status_name(status) + self.reason))

    def setup(self, stop: float | None = None) -> Instance:
        defined = stop is not None
        self.legal("fmi2SetupExperiment", 0, 0.0, self.subject.start, int(defined), stop if defined else 0.0)
        return self

    def initialize(self, stop: float | None = None) -> Instance:
        """From instantiated to where steps begin."""
        self.setup(stop)
        self.legal("fmi2EnterInitializationMode")
        return self.exit_initialization()

    def exit_initialization(self) -> Instance:
        self.legal("fmi2ExitInitializationMode")
        return self

    def step(self) -> None:
        self.legal("fmi2DoStep", self.time, self.subject.step, 1)
        self.progress.steps += 1

    def run(self, steps: int) -> Rows:
        """Step on; what was computed after each step, by variable. Less where the FMU asks for the end."""
        rows = []
        for _ in range(steps):
            if self.progress.ended:
                break
            self.step()
            rows.append(self.computed())
        return rows

    def computed(self) -> dict[str, Value]:
        """The watched variables."""
        return self.read(self.subject.watched)

    def read(self, variables: Sequence[Variable]) -> dict[str, Value]:
        """The values by name, one call for each kind."""
        values: dict[str, Value] = {}
        by_kind: dict[str, list[Variable]] = {}
        for variable in variables:
            by_kind.setdefault(variable.kind, []).append(variable)
        for kind, of_kind in by_kind.items():
            made = (KINDS[kind] * len(of_kind))()
            about = of_kind[0].name if len(of_kind) == 1 else f"{len(of_kind)} variables"
            self.legal(f"fmi2Get{kind}", _references(of_kind), len(of_kind), made, about=about)
            values.update(zip([variable.name for variable in of_kind], map(_as_python, made), strict=True))
        return values

    def try_set(self, variable: Variable, value: Value) -> int:
        """The status of setting one variable."""
        return self.call(f"fmi2Set{variable.kind}", _references([variable]), 1, _as_c(variable.kind, value))

    def set(self, variable: Variable, value: Value) -> None:
        made = _as_c(variable.kind, value)
        self.legal(f"fmi2Set{variable.kind}", _references([variable]), 1, made, about=f"{variable.name} = {value}")

    def free(self) -> None:
        self.fmu.function("fmi2FreeInstance", None)(self.pointer)


def _references(variables: Sequence[Variable]) -> Any:
    return (c_uint * len(variables))(*[variable.reference for variable in variables])


def _as_c(kind: str, value: Value) -> Any:
    return (KINDS[kind] * 1)(value.encode() if isinstance(value, str) else value)


def _as_python(value: Any) -> Value:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def _formats_messages(callbacks: fmi2.fmi2CallbackFunctions) -> None:
    """Puts fmpy's formatter before the logger: a message has its arguments as printf has them, which ctypes cannot read."""
    try:
        from fmpy.logging import addLoggerProxy
    except OSError:  # fmpy has none for this machine: messages stay as they come
        return
    addLoggerProxy(ctypes.byref(callbacks))
