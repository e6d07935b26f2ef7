"""Probes of what an FMU says: to the logger when asked, and nowhere else."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator

from fmu_src.compliance.finding import Finding
from fmu_src.compliance.library.calls import OK, status_name
from fmu_src.compliance.library.fmu import Fmu
from fmu_src.compliance.library.lifecycle import STEPS
from fmu_src.compliance.rules import finding


def silent(fmu: Fmu) -> Iterator[Finding]:
    """A legal life with logging off."""
    instance = fmu.initialized()
    instance.run(STEPS)
    instance.legal("fmi2Terminate")
    for _, status, category, text in fmu.messages[:1]:
        found = f"{status_name(status)}, category '{category}': {text.strip()}"
        yield finding("silent", "logger", "no message while logging is off", found)


def prints(fmu: Fmu) -> Iterator[Finding]:
    """A legal life with logging on; from when the library is loaded until the instance is freed."""
    instance = fmu.initialized(logging=True)
    instance.run(STEPS)
    instance.legal("fmi2Terminate")
    instance.free()
    assert fmu.printed is not None
    printed = fmu.printed.end()
    if fmu.printed.size:
        first = printed.splitlines()[0] if printed else ""
        yield finding("prints", "stdout, stderr", "nothing", f"{fmu.printed.size} bytes, from '{first[:80]}' on")


def logged(fmu: Fmu) -> Iterator[Finding]:
    """Messages of a life with logging on, and of a call that is refused."""
    instance = fmu.initialized("speaker", logging=True)
    instance.run(1)
    instance.call("fmi2SetupExperiment", 0, 0.0, 0.0, 0, 0.0)
    known = fmu.subject.description.categories
    for name, _, category, text in fmu.messages:
        if name != "speaker":
            yield finding("log-messages", text.strip(), "the instance name 'speaker'", f"'{name}'")
            return
        if known and category not in known:
            yield finding("log-messages", text.strip(), f"a category of {', '.join(known)}", f"'{category}'")
            return


def debug_logging(fmu: Fmu) -> Iterator[Finding]:
    instance = fmu.new()
    for category in fmu.subject.description.categories:
        names = (ctypes.c_char_p * 1)(category.encode())
        status = instance.call("fmi2SetDebugLogging", 1, 1, names)
        if status != OK:
            yield finding("debug-logging", f"category {category}", "fmi2OK", status_name(status))
            return
