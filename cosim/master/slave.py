"""One instance of an FMI 2.0 co-simulation FMU: loading, logging, the calls of its life."""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy import fmi2
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription, ModelVariable

from cosim.errors import one_line
from cosim.fmu import Value
from cosim.results import Message, Result

try:
    from fmpy.logging import addLoggerProxy
except OSError:  # fmpy has no such library for this platform: messages then keep their printf placeholders
    addLoggerProxy = None

STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")
# The name by which an FMU's functions know a variable's type.
FMI_KIND = {"Real": "Real", "Integer": "Integer", "Enumeration": "Integer", "Boolean": "Boolean", "String": "String"}
# The folders in `binaries/` to look into, the first best. FMI 2.0.4, 2.3: "64" means x86, any other processor has FMI 3.0's
# tuple; many tools put aarch64 binaries under the names for x86 nevertheless.
PLATFORMS = (fmpy.platform_tuple, fmpy.platform) if fmpy.architecture == "aarch64" else (fmpy.platform,)
_WORTH_LOGGING = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal", "logStatusPending")
# What an FMU may be at when it goes down or never comes back; the place of a call among these is what `Slave.at` notes.
CALLS = (
    "the loading of its library",
    "fmi2Instantiate",
    "the calls before fmi2EnterInitializationMode",
    "fmi2EnterInitializationMode",
    "fmi2ExitInitializationMode",
    "fmi2SetXXX",
    "fmi2DoStep",
    "fmi2GetXXX",
    "fmi2Terminate",
    "fmi2FreeInstance",
)
LOAD, INSTANTIATE, SET_UP, ENTER, EXIT, SET, STEP, GET, TERMINATE, FREE = range(len(CALLS))
LONGEST = 500  # characters of what went wrong
_ACCESS = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p)
_GET_STATUS = (ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p)
_DO_STEP = (ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int)


class RunError(RuntimeError):
    """An element failed.

    Attributes:
        element: its name; "" where none is known to have done it.
        time: the communication point [s].
        text: what happened, in one line: what an FMU says may hold anything.
        partial: the record up to the failure; None if it failed before the record began.
    """

    def __init__(self, element: str, time: float, message: str):
        self.element = element
        self.time = time
        self.text = one_line(message, LONGEST)
        super().__init__(f"element '{element}' at t = {time:g}: {self.text}" if element else self.text)
        self.partial: Result | None = None


# fmpy changes the working directory, which is the whole process's, while it loads.
_loading = threading.Lock()

# fmpy's proxy, which formats the messages, knows one logger per process; the environment pointer tells the instance.
_sinks: dict[int, Callable[[str, str, str], None]] = {}
_environments: Iterator[int] = itertools.count(1)


def _log(environment: int | None, name: bytes, status: int, category: bytes | None, text: bytes | None) -> None:
    sink = _sinks.get(environment or 0)
    if sink is not None:
        label = STATUS[status] if 0 <= status < len(STATUS) else str(status)
        sink(label, (category or b"").decode("utf-8", "replace"), (text or b"").decode("utf-8", "replace"))


_LOGGER = fmi2.fmi2CallbackLoggerTYPE(_log)
_ALLOCATE = fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
_FREE = fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)


class Slave:
    """An instance of the FMU unpacked in `directory`; `free` it in the end, whatever happened.

    `messages` receives what it logs. Calls that the FMU answers with more than a warning raise RunError. `here` takes the
    number of the call that it is at, counted from `place`: see `CALLS`.
    """

    def __init__(
        self,
        name: str,
        description: ModelDescription,
        directory: Path,
        messages: list[Message],
        start: float,
        here: memoryview | None = None,
        place: int = 0,
    ):
        self.name = name
        self.place = place
        self._here = here if here is not None else np.zeros(1, np.int64).data
        self._messages = messages
        self._dead = False
        self.at(LOAD)
        identifier = description.coSimulation.modelIdentifier
        binaries = directory / "binaries"
        candidates = [binaries / folder / f"{identifier}{fmpy.sharedLibraryExtension}" for folder in PLATFORMS]
        library = next((path for path in candidates if path.is_file()), None)
        if library is None:
            found = ", ".join(sorted(p.name for p in binaries.glob("*"))) or "none"
            raise RunError(name, start, f"the FMU has no binary for {' or '.join(PLATFORMS)}; it has: {found}")
        try:
            with (
                _loading,
                contextlib.chdir(os.getcwd()),
            ):  # fmpy leaves the working directory changed when loading fails
                self._fmu = fmi2.FMU2Slave(
                    guid=description.guid,
                    unzipDirectory=str(directory),
                    modelIdentifier=identifier,
                    instanceName=name,
                    libraryPath=str(library),
                )
        except Exception as error:  # fmpy raises no narrower type
            raise RunError(name, start, str(error)) from error
        self._environment = next(_environments)
        _sinks[self._environment] = lambda *entry: messages.append(Message(name, *entry))
        try:
            self._instantiate(description, start)
        except RunError:
            del _sinks[self._environment]
            self._fmu.freeLibrary()
            raise
        self.component = self._fmu.component
        self.do_step = self._function("fmi2DoStep", _DO_STEP)
        self.get_status = self._function("fmi2GetStatus", _GET_STATUS)

    def _instantiate(self, description: ModelDescription, start: float) -> None:
        callbacks = fmi2.fmi2CallbackFunctions(
            logger=_LOGGER, allocateMemory=_ALLOCATE, freeMemory=_FREE, componentEnvironment=self._environment
        )
        if addLoggerProxy is not None:
            addLoggerProxy(ctypes.byref(callbacks))
        self.at(INSTANTIATE)
        try:
            self._fmu.instantiate(callbacks=callbacks, loggingOn=True)
        except Exception as error:  # fmpy raises no narrower type when the FMU returns NULL
            raise RunError(self.name, start, self._explain("fmi2Instantiate failed", 0)) from error
        declared = {category.name for category in description.logCategories}
        wanted = [category for category in _WORTH_LOGGING if category in declared]
        if wanted:
            self._fmu.setDebugLogging(True, wanted)

    def at(self, call: int) -> None:
        """Note that the next call is number `call` of CALLS."""
        self._here[0] = self.place + call

    def _function(self, name: str, arguments: tuple[Any, ...]) -> Any:
        """The FMU's function with arguments as plain numbers: fmpy's own wrappers cost 100 times as much per call."""
        function = self._fmu.dll[name]
        function.argtypes = arguments
        function.restype = ctypes.c_int
        return function

    def access(self, verb: str, kind: str) -> Any:
        """The function fmi2<verb><kind>(component, address of references, count, address of values) -> status."""
        return self._function(f"fmi2{verb}{kind}", _ACCESS)

    def call(self, time: float, function: Callable[[fmi2.FMU2Slave], object], doing: str = "") -> None:
        """Make a call through fmpy, `function(fmu)`; `doing` says what for, should it fail."""
        logged = len(self._messages)
        try:
            function(self._fmu)
        except FMICallException as error:
            raise self.failure(error.function, error.status, time, logged, doing) from error

    def set(self, variable: ModelVariable, value: Value, time: float) -> None:
        """Set one variable before or in initialisation."""
        kind = FMI_KIND[variable.type]
        self.call(
            time,
            lambda fmu: getattr(fmu, f"set{kind}")([variable.valueReference], [value]),
            f"setting {variable.name} = {value}",
        )

    def failure(self, function: str, status: int, time: float, logged: int = 0, doing: str = "") -> RunError:
        """The error after `function` returned `status`; `logged` is the number of messages before the call."""
        if status == fmi2.fmi2Fatal:
            self._dead = True
        label = STATUS[status] if 0 <= status < len(STATUS) else f"illegal status {status}"
        what = f"{function} failed ({label})" + (f" while {doing}" if doing else "")
        return RunError(self.name, time, self._explain(what, logged))

    def _explain(self, what: str, logged: int) -> str:
        own = [m for m in self._messages[logged:] if m.element == self.name]
        reasons = [m.text for m in own if m.status not in ("ok", "warning")] or [m.text for m in own[-1:]]
        return f"{what}: {reasons[-1].strip()}" if reasons else f"{what}, and the FMU says no more"

    def free(self) -> None:
        """Release the instance and its library. After fmi2Fatal nothing of the FMU may be called: both stay."""
        self.at(FREE)
        if not self._dead:
            self._fmu.freeInstance()
        del _sinks[self._environment]


def references(variables: list[ModelVariable]) -> np.ndarray:
    """The value references of `variables` as fmi2ValueReference, (len(variables),)."""
    return np.array([v.valueReference for v in variables], dtype=np.uint32)
