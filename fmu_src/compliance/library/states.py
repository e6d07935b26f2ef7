"""Probes of FMU states: restored here, and serialised for another process."""

from __future__ import annotations

import ctypes
import json
from collections.abc import Generator, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from fmu_src.compliance.finding import Finding
from fmu_src.compliance.library.calls import OK, status_name
from fmu_src.compliance.library.fmu import Fmu
from fmu_src.compliance.library.instance import Instance, Progress
from fmu_src.compliance.library.lifecycle import STEPS, differences
from fmu_src.compliance.rules import finding


def _state(instance: Instance) -> ctypes.c_void_p:
    state = ctypes.c_void_p()
    instance.legal("fmi2GetFMUstate", ctypes.byref(state))
    return state


def restore(fmu: Fmu) -> Iterator[Finding]:
    """The state amid a run; on to the end; back, and on to the end again."""
    instance = fmu.initialized()
    instance.run(STEPS // 2)
    state, progress = _state(instance), replace(instance.progress)
    expected = [instance.computed(), *instance.run(STEPS // 2)]
    instance.legal("fmi2SetFMUstate", state)
    instance.progress = progress
    found = [instance.computed(), *instance.run(STEPS // 2)]
    yield from differences("state-restore", expected, found, "as before the state was restored")


def free_state(fmu: Fmu) -> Iterator[Finding]:
    instance = fmu.initialized()
    state = _state(instance)
    instance.legal("fmi2FreeFMUstate", ctypes.byref(state))
    if state.value is not None:
        yield finding("state-free", "fmi2FreeFMUstate", "a null pointer afterwards", "another")
        return
    status = instance.call("fmi2FreeFMUstate", ctypes.byref(state))
    if status != OK:
        yield finding("state-free", "fmi2FreeFMUstate of null", "fmi2OK, the call ignored", status_name(status))


def serialize(fmu: Fmu) -> Generator[Finding, None, dict[str, Any]]:
    """Returns the bytes of the state amid a run, and what follows from it here."""
    instance = fmu.initialized()
    instance.run(STEPS // 2)
    state, size = _state(instance), ctypes.c_size_t()
    instance.legal("fmi2SerializedFMUstateSize", state, ctypes.byref(size))
    content = ctypes.create_string_buffer(size.value)
    instance.legal("fmi2SerializeFMUstate", state, content, size)
    progress = asdict(instance.progress)
    yield from ()
    return {
        "state": content.raw.hex(),
        "progress": progress,
        "rows": [instance.computed(), *instance.run(STEPS // 2)],
    }


def resume(fmu: Fmu, saved: Path) -> Iterator[Finding]:
    """From what `serialize` has kept in the file `saved`, in another process."""
    record = json.loads(saved.read_text())
    content = bytes.fromhex(record["state"])
    instance = fmu.initialized()
    state = ctypes.c_void_p()
    instance.legal(
        "fmi2DeSerializeFMUstate", ctypes.create_string_buffer(content, len(content)), len(content), ctypes.byref(state)
    )
    instance.legal("fmi2SetFMUstate", state)
    instance.progress = Progress(**record["progress"])
    found = [instance.computed(), *instance.run(STEPS // 2)]
    yield from differences("state-serialize", record["rows"], found, "as in the process that serialised the state")
