"""An FMU's library driven through ctypes: raw statuses, messages and memory on record, every call announced.

Runs in a child process. Nothing of fmpy's own slave class: that raises on statuses which a probe wants to see.
"""

from __future__ import annotations

import ctypes
import os
import sys
import time
from collections.abc import Callable, Sequence
from ctypes import c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fmpy
from fmpy import fmi2

from fmu_src.compliance.files.description import Description, Value, Variable
from fmu_src.compliance.finding import Finding
from fmu_src.compliance.rules import finding

OK, WARNING, DISCARD, ERROR, FATAL, PENDING = range(6)
Rows = list[dict[str, Value]]  # by variable, at successive communication points

STATUS = ("fmi2OK", "fmi2Warning", "fmi2Discard", "fmi2Error", "fmi2Fatal", "fmi2Pending")

_KINDS: dict[str, Any] = {"Real": c_double, "Integer": c_int, "Boolean": c_int, "String": c_char_p}
_ACCESS = (c_void_p, c_void_p, c_size_t, c_void_p)
_ARGUMENTS: dict[str, tuple[Any, ...]] = {
    "fmi2FreeInstance": (c_void_p,),
    "fmi2SetDebugLogging": (c_void_p, c_int, c_size_t, c_void_p),
    "fmi2SetupExperiment": (c_void_p, c_int, c_double, c_double, c_int, c_double),
    "fmi2EnterInitializationMode": (c_void_p,),
    "fmi2ExitInitializationMode": (c_void_p,),
    "fmi2Terminate": (c_void_p,),
    "fmi2Reset": (c_void_p,),
    "fmi2GetFMUstate": (c_void_p, c_void_p),
    "fmi2SetFMUstate": (c_void_p, c_void_p),
    "fmi2FreeFMUstate": (c_void_p, c_void_p),
    "fmi2SerializedFMUstateSize": (c_void_p, c_void_p, c_void_p),
    "fmi2SerializeFMUstate": (c_void_p, c_void_p, c_void_p, c_size_t),
    "fmi2DeSerializeFMUstate": (c_void_p, c_void_p, c_size_t, c_void_p),
    "fmi2DoStep": (c_void_p, c_double, c_double, c_int),
    "fmi2GetStatus": (c_void_p, c_int, c_void_p),
    "fmi2SetRealInputDerivatives": (c_void_p, c_void_p, c_size_t, c_void_p, c_void_p),
    "fmi2GetRealOutputDerivatives": (c_void_p, c_void_p, c_size_t, c_void_p, c_void_p),
    **{f"fmi2{verb}{kind}": _ACCESS for verb in ("Get", "Set") for kind in _KINDS},
}


@dataclass(frozen=True)
class Subject:
    """The FMU under test, unpacked. `step`, `start`, `stop` [s]: of the default experiment, or chosen in its place."""

    description: Description
    library: str
    resources: str  # a URI
    start: float
    stop: float | None
    step: float

    @property
    def variables(self) -> tuple[Variable, ...]:
        return self.description.variables


class Broken(Exception):
    """What a probe took for granted does not hold: the probe ends, with this finding of another rule."""

    def __init__(self, finding: Finding):
        super().__init__(str(finding))
        self.finding = finding


class Fmu:
    """The loaded library. `announce` hears of each call before it is made, so that a crash can be told by its name.

    Raises:
        OSError: the library does not load.
    """

    def __init__(self, subject: Subject, announce: Callable[[str], None] = lambda call: None):
        self.subject = subject
        self.announce = announce
        self.refusal = ""  # what the FMU said when it returned no instance
        announce("loading")
        if sys.platform == "win32":
            os.add_dll_directory(str(Path(subject.library).parent))
        self._library = ctypes.CDLL(subject.library)

    def function(self, name: str, result: Any = c_int) -> Any:
        function = self._library[name]
        if name in _ARGUMENTS:
            function.argtypes = _ARGUMENTS[name]
        function.restype = result

        def announced(*arguments: Any) -> Any:
            self.announce(name)
            return function(*arguments)

        return announced

    def instantiate(self, name: str = "instance", guid: str | None = None, logging: bool = False) -> Instance | None:
        """A new instance, or None where the FMU refuses."""
        instance = Instance(self, name)
        call = self.function("fmi2Instantiate", c_void_p)
        instance.pointer = call(
            name.encode(),
            fmi2.fmi2CoSimulation,
            (self.subject.description.guid if guid is None else guid).encode(),
            self.subject.resources.encode(),
            ctypes.byref(instance.callbacks),
            fmi2.fmi2False,
            fmi2.fmi2True if logging else fmi2.fmi2False,
        )
        if instance.pointer is None:
            self.refusal = instance.reason
            return None
        instance.pointer = c_void_p(instance.pointer)
        return instance

    def new(self, name: str = "instance", logging: bool = False) -> Instance:
        """A new instance; Broken where the FMU refuses."""
        instance = self.instantiate(name, logging=logging)
        if instance is None:
            raise Broken(finding("instantiate", "fmi2Instantiate", "an instance", f"a null pointer{self.refusal}"))
        return instance

    def initialized(self, name: str = "instance", logging: bool = False) -> Instance:
        """A new instance, initialized."""
        return self.new(name, logging).initialize()


class Instance:
    """One instance: `messages` are (instance name, status, category, text), `blocks` what it took and did not give back."""

    def __init__(self, fmu: Fmu, name: str):
        self.fmu = fmu
        self.subject = fmu.subject
        self.name = name
        self.pointer: Any = None
        self.steps = 0
        self.messages: list[tuple[str, int, str, str]] = []
        self.blocks: set[int] = set()

        def log(_: Any, sender: bytes, status: int, category: bytes, text: bytes) -> None:
            words = [(word or b"").decode("utf-8", "replace") for word in (sender, category, text)]
            self.messages.append((words[0], status, words[1], words[2]))

        def allocate(count: int, size: int) -> int | None:
            block: int | None = fmpy.calloc(count, size)
            if block:
                self.blocks.add(block)
            return block

        def free(block: int | None) -> None:
            self.blocks.discard(block or 0)
            fmpy.free(block)

        self.callbacks = fmi2.fmi2CallbackFunctions(
            logger=fmi2.fmi2CallbackLoggerTYPE(log),
            allocateMemory=fmi2.fmi2CallbackAllocateMemoryTYPE(allocate),
            freeMemory=fmi2.fmi2CallbackFreeMemoryTYPE(free),
        )

    @property
    def time(self) -> float:
        """The current communication point; counted, not accumulated."""
        return self.subject.start + self.steps * self.subject.step

    @property
    def reason(self) -> str:
        """The last message, to stand behind what happened."""
        return f": {self.messages[-1][3].strip()}" if self.messages else ""

    def call(self, name: str, *arguments: Any) -> int:
        """Call a function that returns a status; a pending one is waited for."""
        status: int = self.fmu.function(name)(self.pointer, *arguments)
        while status == PENDING:
            answer = c_int(PENDING)
            time.sleep(1e-3)
            if self.fmu.function("fmi2GetStatus")(self.pointer, fmi2.fmi2DoStepStatus, ctypes.byref(answer)) != OK:
                return ERROR
            status = answer.value
        return status

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
        self.setup(stop)
        self.legal("fmi2EnterInitializationMode")
        self.legal("fmi2ExitInitializationMode")
        return self

    def step(self) -> None:
        self.legal("fmi2DoStep", self.time, self.subject.step, 1)
        self.steps += 1

    def run(self, steps: int) -> Rows:
        """Step on; what was computed after each step, by variable."""
        rows = []
        for _ in range(steps):
            self.step()
            rows.append(self.computed())
        return rows

    def computed(self) -> dict[str, Value]:
        """All variables that the FMU computes."""
        shown = ("output", "local", "calculatedParameter", "independent")
        return self.read([variable for variable in self.subject.variables if variable.causality in shown])

    def read(self, variables: Sequence[Variable]) -> dict[str, Value]:
        """The values by name, one call for each kind."""
        values: dict[str, Value] = {}
        for kind in _KINDS:
            of_kind = [variable for variable in variables if variable.kind == kind]
            if of_kind:
                made = (_KINDS[kind] * len(of_kind))()
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


def status_name(status: int) -> str:
    return STATUS[status] if 0 <= status < len(STATUS) else f"the status {status}"


def _references(variables: Sequence[Variable]) -> Any:
    return (c_uint * len(variables))(*[variable.reference for variable in variables])


def _as_c(kind: str, value: Value) -> Any:
    return (_KINDS[kind] * 1)(value.encode() if isinstance(value, str) else value)


def _as_python(value: Any) -> Value:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value
