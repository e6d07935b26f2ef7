"""Probes of an instance's life: creation, the state machine, reset, memory."""

from __future__ import annotations

import ctypes
import json
from collections.abc import Callable, Generator, Iterator
from pathlib import Path

from fmu_src.compliance.finding import Finding
from fmu_src.compliance.library.calls import ERROR, OK, WARNING, status_name
from fmu_src.compliance.library.exchange import ExchangeInstance, argument_lists
from fmu_src.compliance.library.fmu import Fmu
from fmu_src.compliance.library.instance import Instance, Progress, Rows
from fmu_src.compliance.rules import finding

STEPS = 8  # of the default experiment's step size: what a run in a probe is
OTHER_GUID = "{00000000-0000-0000-0000-000000000000}"


def load(fmu: Fmu) -> Iterator[Finding]:
    """Platform and version; that the library loads, the child has seen before."""
    for rule, function, expected in (
        ("types-platform", "fmi2GetTypesPlatform", "default"),
        ("version", "fmi2GetVersion", "2.0"),
    ):
        answer = fmu.function(function, ctypes.c_char_p)()
        if answer != expected.encode():
            found = "a null pointer" if answer is None else repr(answer.decode("utf-8", "replace"))
            yield finding(rule, function, f"'{expected}'", found)


def life(fmu: Fmu) -> Generator[Finding, None, Rows]:
    """A whole legal life; returns what was computed at the start and after each step.

    What happens at its end, terminated and freed, spoils no other probe: a refusal there is a finding only.
    """
    instance = STATES["in initialization mode"](fmu)
    instance.read([variable for variable in fmu.subject.watched if variable.causality == "output"])
    instance.exit_initialization()
    rows = [instance.computed(), *instance.run(STEPS)]
    status = instance.call("fmi2Terminate")
    if status not in (OK, WARNING):
        yield finding("legal-call", "fmi2Terminate", "fmi2OK", status_name(status) + instance.reason)
    instance.free()
    return rows


def guid_mismatch(fmu: Fmu) -> Iterator[Finding]:
    if fmu.instantiate(guid=OTHER_GUID) is not None:
        yield finding("guid-mismatch", "fmi2Instantiate", f"a null pointer for the GUID {OTHER_GUID}", "an instance")


def _instantiated(fmu: Fmu) -> Instance:
    return fmu.new()


def _set_up(fmu: Fmu) -> Instance:
    return fmu.new().setup()


def _initializing(fmu: Fmu) -> Instance:
    instance = fmu.new().setup()
    instance.legal("fmi2EnterInitializationMode")
    return instance


def _initialized(fmu: Fmu) -> Instance:
    return fmu.initialized()


def _in_event_mode(fmu: Fmu) -> Instance:
    """Of model exchange."""
    instance = fmu.initialized()
    instance.legal("fmi2EnterEventMode")
    return instance


def _terminated(fmu: Fmu) -> Instance:
    instance = fmu.initialized()
    instance.run(1)
    instance.legal("fmi2Terminate")
    return instance


STATES: dict[str, Callable[[Fmu], Instance]] = {
    "instantiated": _instantiated,
    "set up": _set_up,
    "in initialization mode": _initializing,
    "initialized": _initialized,
    "terminated": _terminated,
}
EXCHANGE_STATES = STATES | {"in event mode": _in_event_mode}

# Section 4.2.4, the table of calling sequences: what is not allowed in which state.
FORBIDDEN = {
    "instantiated": ("fmi2ExitInitializationMode", "fmi2EnterInitializationMode", "fmi2DoStep", "fmi2Terminate"),
    "set up": ("fmi2ExitInitializationMode", "fmi2DoStep", "fmi2Terminate"),
    "in initialization mode": (
        "fmi2SetupExperiment",
        "fmi2EnterInitializationMode",
        "fmi2DoStep",
        "fmi2Terminate",
    ),
    "initialized": ("fmi2SetupExperiment", "fmi2EnterInitializationMode", "fmi2ExitInitializationMode"),
    "terminated": (
        "fmi2SetupExperiment",
        "fmi2EnterInitializationMode",
        "fmi2ExitInitializationMode",
        "fmi2DoStep",
        "fmi2Terminate",
    ),
}

# Section 3.2.3, the same for model exchange; "initialized" is continuous-time mode.
_EVENTS = ("fmi2EnterEventMode", "fmi2NewDiscreteStates", "fmi2EnterContinuousTimeMode", "fmi2CompletedIntegratorStep")
_INITIALIZATION = ("fmi2SetupExperiment", "fmi2EnterInitializationMode", "fmi2ExitInitializationMode")
FORBIDDEN_EXCHANGE = {
    "instantiated": ("fmi2ExitInitializationMode", "fmi2EnterInitializationMode", *_EVENTS, "fmi2Terminate"),
    "set up": ("fmi2ExitInitializationMode", *_EVENTS, "fmi2Terminate"),
    "in initialization mode": ("fmi2SetupExperiment", "fmi2EnterInitializationMode", *_EVENTS, "fmi2Terminate"),
    "in event mode": (*_INITIALIZATION, "fmi2EnterEventMode", "fmi2CompletedIntegratorStep"),
    "initialized": (*_INITIALIZATION, "fmi2NewDiscreteStates", "fmi2EnterContinuousTimeMode"),
    "terminated": (*_INITIALIZATION, *_EVENTS, "fmi2Terminate"),
}


def forbidden_call(fmu: Fmu, state: str, function: str) -> Iterator[Finding]:
    instance = EXCHANGE_STATES[state](fmu)
    arguments: tuple[object, ...] = ()
    if function == "fmi2DoStep":
        arguments = (instance.time, fmu.subject.step, 1)
    elif function == "fmi2SetupExperiment":
        arguments = (0, 0.0, fmu.subject.start, 0, 0.0)
    elif isinstance(instance, ExchangeInstance):
        arguments = argument_lists().get(function, ())
    status = instance.call(function, *arguments)
    if status != ERROR:
        yield finding("call-order", f"{function} when {state}", "fmi2Error", status_name(status))


def reset(fmu: Fmu, state: str, fresh: Path) -> Iterator[Finding]:
    """Reset from `state`, after a few steps where that has any, then the life of a fresh instance."""
    instance = EXCHANGE_STATES[state](fmu)
    if state == "initialized":
        for variable in fmu.subject.variables:
            if fmu.subject.settable_in_steps(variable) and variable.type == "Real" and variable.start is not None:
                instance.set(variable, other_value(variable.start, variable.min, variable.max))
        instance.run(2)
    instance.legal("fmi2Reset", about=f"an instance that is {state}")
    instance.progress = Progress(fmu.subject.start)
    instance.initialize()
    rows = [instance.computed(), *instance.run(STEPS)]
    yield from differences("reset", kept(fresh), rows, f"as from a fresh instance (it was {state})")


def free(fmu: Fmu, state: str) -> Iterator[Finding]:
    """Freed in `state`; the probe is that it survives, and that the memory is back."""
    instance = EXCHANGE_STATES[state](fmu)
    instance.free()
    if instance.blocks:
        found = f"{len(instance.blocks)} blocks kept"
        yield finding("memory", f"fmi2FreeInstance when {state}", "all memory given back", found)


def free_null(fmu: Fmu) -> Iterator[Finding]:
    fmu.function("fmi2FreeInstance", None)(None)
    yield from ()


def two_instances(fmu: Fmu, alone: Path) -> Iterator[Finding]:
    """A second instance, with other inputs, steps between the steps of the first."""
    first, second = fmu.initialized("first"), fmu.new("second").setup()
    second.legal("fmi2EnterInitializationMode")
    for variable in fmu.subject.variables:
        if variable.causality == "input" and variable.type == "Real" and variable.start is not None:
            second.set(variable, other_value(variable.start, variable.min, variable.max))
    second.exit_initialization()
    rows = [first.computed()]
    for k in range(STEPS):
        if k % 2 == 0:
            second.run(1)
        rows.extend(first.run(1))
    second.free()
    yield from differences("two-instances", kept(alone), rows, "as without the other")


def kept(file: Path) -> Rows:
    """The rows that an earlier case has left."""
    rows: Rows = json.loads(file.read_text())
    return rows


def other_value(start: object, low: float, high: float) -> float:
    """Another value than `start` that [low, high] allows, near by: to be told apart, not to be extreme."""
    assert isinstance(start, (int, float))
    step = 0.125 * max(abs(start), 1.0)
    for value in (start + step, start - step, (start + high) / 2, (start + low) / 2):
        if low <= value <= high and value != start:
            return float(value)
    return float(start)


def differences(rule: str, expected: Rows, found: Rows, what: str) -> Iterator[Finding]:
    """A finding for each variable that differs, at its first communication point; NaN equals NaN."""
    if len(expected) != len(found):
        yield finding(rule, "the run", f"{len(expected) - 1} steps, {what}", f"{len(found) - 1} until the FMU ended it")
    seen: set[str] = set()
    for k, (row, other) in enumerate(zip(expected, found, strict=False)):
        for name, value in row.items():
            if name not in seen and repr(value) != repr(other[name]):
                seen.add(name)
                yield finding(rule, name, f"{value!r} after {k} steps, {what}", repr(other[name]))
