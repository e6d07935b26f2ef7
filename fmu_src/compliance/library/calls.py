"""An FMU's library loaded through ctypes: every call announced, messages on record; and what the FMU is driven as.

Runs in a child process. Nothing of fmpy's own slave class: that raises on statuses which a probe wants to see.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable
from ctypes import c_char_p, c_double, c_int, c_size_t, c_void_p
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fmpy import fmi2

from fmu_src.compliance.files.description import Description, Variable
from fmu_src.compliance.finding import Finding
from fmu_src.compliance.library.capture import Capture

OK, WARNING, DISCARD, ERROR, FATAL, PENDING = range(6)
MOST_MESSAGES = 1000  # that are kept of what an FMU logs
LONGEST = 2000  # bytes of one

STATUS = ("fmi2OK", "fmi2Warning", "fmi2Discard", "fmi2Error", "fmi2Fatal", "fmi2Pending")

KINDS: dict[str, Any] = {"Real": c_double, "Integer": c_int, "Boolean": c_int, "String": c_char_p}
_ACCESS = (c_void_p, c_void_p, c_size_t, c_void_p)
_OF_STATES = (
    "SetContinuousStates",
    "GetContinuousStates",
    "GetDerivatives",
    "GetEventIndicators",
    "GetNominalsOfContinuousStates",
)
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
    "fmi2GetDirectionalDerivative": (c_void_p, c_void_p, c_size_t, c_void_p, c_size_t, c_void_p, c_void_p),
    "fmi2EnterEventMode": (c_void_p,),
    "fmi2NewDiscreteStates": (c_void_p, c_void_p),
    "fmi2EnterContinuousTimeMode": (c_void_p,),
    "fmi2CompletedIntegratorStep": (c_void_p, c_int, c_void_p, c_void_p),
    "fmi2SetTime": (c_void_p, c_double),
    **{f"fmi2{name}": (c_void_p, c_void_p, c_size_t) for name in _OF_STATES},
    **{f"fmi2{verb}{kind}": _ACCESS for verb in ("Get", "Set") for kind in KINDS},
}


@dataclass(frozen=True)
class Subject:
    """The FMU under test, unpacked, by one of its interfaces.

    `step`, `start`, `stop` [s]: of the default experiment, or chosen in its place. `watched`: the computed variables that are
    compared. `scratch`: a folder that is the FMU's working directory.
    """

    description: Description
    interface: str  # CoSimulation or ModelExchange
    library: str
    resources: str  # a URI
    start: float
    stop: float | None
    step: float
    watched: tuple[Variable, ...]
    scratch: Path

    @property
    def variables(self) -> tuple[Variable, ...]:
        return self.description.variables

    def says(self, flag: str) -> bool:
        """Is this capability flag true?"""
        return self.description.says(flag, self.interface)

    def settable_in_steps(self, variable: Variable) -> bool:
        """May it be set once the FMU is initialized? In continuous-time mode only what is continuous."""
        if self.interface == "ModelExchange":
            return variable.causality == "input" and variable.type == "Real" and variable.variability == "continuous"
        return variable.settable_in_steps


class Broken(Exception):
    """What a probe took for granted does not hold: the probe ends, with this finding of another rule."""

    def __init__(self, finding: Finding):
        super().__init__(str(finding))
        self.finding = finding


class Library:
    """The loaded library. `announce` hears of each call before it is made, so that a crash can be told by its name.

    `printed`: what the process prints; `patience` [s]: for a step that is pending. `messages`: those of all instances, as
    (instance name, status, category, text), the first MOST_MESSAGES.

    Raises:
        OSError: the library does not load.
    """

    def __init__(self, subject: Subject, announce: Callable[[str], None], printed: Capture | None, patience: float):
        self.subject = subject
        self.announce = announce
        self.printed = printed
        self.patience = patience
        self.refusal = ""  # what the FMU said when it returned no instance
        self.messages: list[tuple[str, int, str, str]] = []
        announce("loading")
        if sys.platform == "win32":
            os.add_dll_directory(str(Path(subject.library).parent))
        self._library = ctypes.CDLL(subject.library)
        self.logger = fmi2.fmi2CallbackLoggerTYPE(self._log)

    def _log(self, _: Any, sender: bytes, status: int, category: bytes, text: bytes) -> None:
        if len(self.messages) < MOST_MESSAGES:
            words = [(word or b"")[:LONGEST].decode("utf-8", "replace") for word in (sender, category, text)]
            self.messages.append((words[0], status, words[1], words[2]))

    def function(self, name: str, result: Any = c_int) -> Any:
        function = self._library[name]
        if name in _ARGUMENTS:
            function.argtypes = _ARGUMENTS[name]
        function.restype = result

        def announced(*arguments: Any) -> Any:
            self.announce(name)
            return function(*arguments)

        return announced


def status_name(status: int) -> str:
    return STATUS[status] if 0 <= status < len(STATUS) else f"the status {status}"
