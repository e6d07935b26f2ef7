"""An instance of an FMU, driven through fmpy: messages recorded, memory counted."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)

GUARD = bytes(range(0xA0, 0xB0))  # behind each block of memory
HEADER = 144  # bytes of a serialised state in front of the component's: Header in shell/state.c


class Slave:
    """An instance of an FMU: variables by name, calls by fmpy, messages (status, category, text), memory counted.

    `blocks`: those taken and not given back, or written beyond their end.
    """

    def __init__(self, folder: Path, name: str = "instance", guid: str | None = None, logging: bool = True):
        description = fmpy.read_model_description(str(folder))
        self.variables = {v.name: v for v in description.modelVariables}
        self.messages: list[tuple[int, str, str]] = []
        self.blocks: set[int] = set()
        self.fmu = FMU2Slave(
            guid=guid or description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        libc = ctypes.CDLL(None)
        libc.calloc.restype = ctypes.c_void_p
        libc.calloc.argtypes = [ctypes.c_size_t, ctypes.c_size_t]
        libc.free.argtypes = [ctypes.c_void_p]

        def log(_: Any, __: bytes, status: int, category: bytes, message: bytes) -> None:
            self.messages.append((status, category.decode(), message.decode()))

        ends: dict[int, int] = {}

        def allocate(count: int, size: int) -> int:
            block: int = libc.calloc(1, count * size + len(GUARD))
            ends[block] = block + count * size
            ctypes.memmove(ends[block], GUARD, len(GUARD))
            self.blocks.add(block)
            return block

        def free(block: int) -> None:
            if ctypes.string_at(ends.pop(block), len(GUARD)) == GUARD:
                self.blocks.remove(block)
            libc.free(block)

        self.callbacks = fmi2CallbackFunctions()
        self.callbacks.logger = fmi2CallbackLoggerTYPE(log)
        self.callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(allocate)
        self.callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(free)
        self.fmu.instantiate(callbacks=self.callbacks, loggingOn=logging)

    def initialize(self, start: Mapping[str, float] | None = None, t0: float = 0.0, stop: float | None = None) -> Slave:
        for name, value in (start or {}).items():
            self.set(name, value)
        self.fmu.setupExperiment(startTime=t0, stopTime=stop)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        return self

    def set(self, name: str, value: float) -> None:
        variable = self.variables[name]
        if variable.type == "Real":
            self.fmu.setReal([variable.valueReference], [value])
        elif variable.type == "Boolean":
            self.fmu.setBoolean([variable.valueReference], [bool(value)])
        else:
            self.fmu.setInteger([variable.valueReference], [int(value)])

    def get(self, name: str) -> float:
        variable = self.variables[name]
        read = {"Real": self.fmu.getReal, "Boolean": self.fmu.getBoolean}.get(variable.type, self.fmu.getInteger)
        return float(read([variable.valueReference])[0])

    def outputs(self) -> dict[str, float]:
        """All outputs and shown variables."""
        return {name: self.get(name) for name, v in self.variables.items() if v.initial == "calculated"}

    def step(self, t: float, h: float) -> None:
        self.fmu.doStep(t, h)

    def refuses(self, call: Callable[[], object]) -> str:
        """The one message with which `call` is refused with fmi2Error."""
        self.messages.clear()
        with pytest.raises(FMICallException) as caught:
            call()
        assert caught.value.status == 3, caught.value
        assert [(status, category) for status, category, _ in self.messages] == [(3, "logStatusError")]
        return self.messages[0][2]

    def state(self) -> bytes:
        """The serialised state."""
        handle = self.fmu.getFMUState()
        content = bytes(self.fmu.serializeFMUState(handle))
        self.fmu.freeFMUState(handle)
        return content

    def z(self, n: int) -> np.ndarray:
        """The component's own state (n)."""
        return np.frombuffer(self.state(), count=n, offset=HEADER)
