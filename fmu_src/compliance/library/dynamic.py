"""All probes of an FMU by one of its interfaces, in the order in which a failure of one makes the next ones pointless."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from fmu_src.compliance.files.description import INTERFACES
from fmu_src.compliance.finding import Report
from fmu_src.compliance.library import derivatives, lifecycle, messages, states, steps, values
from fmu_src.compliance.library.calls import Subject
from fmu_src.compliance.library.lifecycle import EXCHANGE_STATES, FORBIDDEN, FORBIDDEN_EXCHANGE, STATES
from fmu_src.compliance.library.ls_ref import Experiment, replay
from fmu_src.compliance.library.process import Case, Outcome, run

_REFUSED = "fmi2Error"
_GET_AND_SET = tuple(
    f"fmi2{verb}{kind}" for verb in ("Get", "Set") for kind in ("Real", "Integer", "Boolean", "String")
)


_MOST_HANGS = 3


class _Enough(Exception):
    """So many calls did not come back that more of them are not waited for."""


def check_dynamic(
    subject: Subject, experiments: list[Experiment], report: Report, progress: Callable[[str], None]
) -> None:
    """Drive the FMU; findings, rules applied and notes go into `report`."""
    hangs = 0
    # Which of two interfaces it is about stands behind the subject and in front of a note.
    place = f" in {INTERFACES[subject.interface]}" if len(subject.description.interfaces) > 1 else ""
    driven = Report(report.fmu, checked=report.checked)

    def make(case: Case) -> Outcome:
        nonlocal hangs
        progress(case.rule)
        if case.rule not in report.checked:
            report.checked.append(case.rule)
        outcome = run(case, subject)
        report.findings += [replace(found, subject=f"{found.subject}{place}") for found in outcome.findings]
        hangs += outcome.hung
        if hangs == _MOST_HANGS:
            raise _Enough
        return outcome

    try:
        _drive(subject, experiments, driven, make)
    except _Enough:
        driven.notes.append(f"{_MOST_HANGS} calls did not come back, so no further rule was applied")
    report.notes += [f"{place.strip()}: {note}" if place else note for note in driven.notes]


def _drive(subject: Subject, experiments: list[Experiment], report: Report, make: Callable[[Case], Outcome]) -> None:
    if any(found.rule == "load" for found in make(Case("load", "library", lifecycle.load)).findings):
        report.notes.append("the library does not load, so no further rule was applied")
        return
    # The same probe and the next have looked after them.
    report.checked += [rule for rule in ("types-platform", "version", "instantiate") if rule not in report.checked]
    fresh, again, saved = (
        subject.scratch.parent / f"{name}-{subject.interface}" for name in ("fresh", "again", "saved")
    )
    if not make(Case("legal-call", "a legal life", lifecycle.life, keep=fresh)).complete:
        report.notes.append("the FMU cannot be run, so no further rule was applied")
        return
    for case in _cases(subject, experiments):
        make(case)
    if "memory" not in report.checked:
        report.checked.append("memory")  # the probes of `free` have looked after it
    second = make(Case("legal-call", "a legal life", lifecycle.life, keep=again))
    if not second.complete or again.read_bytes() != fresh.read_bytes():
        report.notes.append("two runs in fresh processes differ, so results were not compared")
        return
    for case in _comparisons(subject, fresh):
        make(case)
    serializes = subject.says("canGetAndSetFMUstate") and subject.says("canSerializeFMUstate")
    if serializes and make(Case("state-serialize", "fmi2SerializeFMUstate", states.serialize, keep=saved)).complete:
        make(Case("state-serialize", "fmi2DeSerializeFMUstate", states.resume, (saved,)))


def _cases(subject: Subject, experiments: list[Experiment]) -> Iterator[Case]:
    is_exchange = subject.interface == "ModelExchange"
    yield Case("guid-mismatch", "fmi2Instantiate", lifecycle.guid_mismatch, expected="a null pointer")
    for state, functions in (FORBIDDEN_EXCHANGE if is_exchange else FORBIDDEN).items():
        for function in functions:
            yield Case("call-order", f"{function} when {state}", lifecycle.forbidden_call, (state, function), _REFUSED)
    for function in _GET_AND_SET:
        yield Case("unknown-reference", function, values.unknown_reference, (function,), _REFUSED)
    yield from _refusals(subject)
    yield Case("start-value", "fmi2GetReal", values.start_values)
    yield Case("set-get", "fmi2SetReal", values.set_get)
    for number in (math.nan, math.inf):
        yield Case("nan-input", f"inputs = {number}", values.nan_input, (number,))
    if subject.says("providesDirectionalDerivative"):
        yield Case("directional-derivative", "fmi2GetDirectionalDerivative", derivatives.directional)
    yield from _of_model_exchange() if is_exchange else _of_cosimulation(subject)
    for state in EXCHANGE_STATES if is_exchange else STATES:
        yield Case("free", f"fmi2FreeInstance when {state}", lifecycle.free, (state,), "the instance freed")
    yield Case("free", "fmi2FreeInstance of null", lifecycle.free_null, expected="the call ignored")
    yield Case("silent", "logger", messages.silent)
    yield Case("prints", "stdout, stderr", messages.prints, captures=True)
    yield Case("log-messages", "logger", messages.logged)
    if subject.description.categories:
        yield Case("debug-logging", "fmi2SetDebugLogging", messages.debug_logging)
    if subject.says("canGetAndSetFMUstate"):
        yield Case("state-free", "fmi2FreeFMUstate", states.free_state)
    for experiment in experiments:
        yield Case("ls-ref-replay", experiment.name, replay, (experiment,))


def _of_cosimulation(subject: Subject) -> Iterator[Case]:
    if subject.says("canInterpolateInputs"):
        yield Case("input-derivatives", "fmi2SetRealInputDerivatives", values.input_derivatives)
    if int(subject.description.interfaces[subject.interface].get("maxOutputDerivativeOrder", "0")) > 0:
        yield Case("output-derivatives", "fmi2GetRealOutputDerivatives", values.output_derivatives)
    for factor in (0.0, -1.0, math.nan):
        yield Case("step-size", f"h = {factor} steps", steps.step_size, (factor,), _REFUSED)
    for offset in (-2, 10):
        yield Case("communication-point", f"{offset:+d} steps", steps.communication_point, (offset,), _REFUSED)
    yield Case("stop-time", "fmi2DoStep", steps.stop_time, expected=_REFUSED)
    if subject.says("canHandleVariableCommunicationStepSize"):
        yield Case("step-variation", "fmi2DoStep", steps.variation)


def _of_model_exchange() -> Iterator[Case]:
    yield Case("continuous-states", "fmi2SetContinuousStates", derivatives.continuous_states)
    yield Case("state-derivatives", "fmi2GetDerivatives", derivatives.along_a_run)
    yield Case("event-mode", "fmi2EnterEventMode", derivatives.events)


def _refusals(subject: Subject) -> Iterator[Case]:
    """What must not be set, and when."""
    kinds = {
        "set-constant": [v for v in subject.variables if v.variability == "constant"],
        "set-fixed": [v for v in subject.variables if v.causality == "parameter" and v.variability == "fixed"],
        "set-calculated": [
            v
            for v in subject.variables
            if v.causality in ("output", "local", "calculatedParameter") and v.initial == "calculated"
        ],
    }
    for rule, variables in kinds.items():
        for variable in values.sample(variables):
            for state in ("initialized",) if rule == "set-fixed" else ("instantiated", "initialized"):
                yield Case(rule, variable.name, values.refused_set, (rule, variable, state), _REFUSED)


def _comparisons(subject: Subject, fresh: Path) -> Iterator[Case]:
    """Probes whose results must be those of the run in a fresh process."""
    for state in EXCHANGE_STATES if subject.interface == "ModelExchange" else STATES:
        yield Case("reset", f"when {state}", lifecycle.reset, (state, fresh))
    if not subject.says("canBeInstantiatedOnlyOncePerProcess"):
        yield Case("two-instances", "a second instance", lifecycle.two_instances, (fresh,))
    if subject.says("canGetAndSetFMUstate"):
        yield Case("state-restore", "fmi2SetFMUstate", states.restore)
