"""All probes of a co-simulation FMU, in the order in which a failure of one makes the next ones pointless."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

from fmu_src.compliance.finding import Report
from fmu_src.compliance.library import lifecycle, messages, states, steps, values
from fmu_src.compliance.library.fmu import Subject
from fmu_src.compliance.library.lifecycle import FORBIDDEN, STATES
from fmu_src.compliance.library.ls_ref import Experiment, replay
from fmu_src.compliance.library.process import Case, Outcome, run

_REFUSED = "fmi2Error"
_GET_AND_SET = tuple(
    f"fmi2{verb}{kind}" for verb in ("Get", "Set") for kind in ("Real", "Integer", "Boolean", "String")
)


def check_dynamic(
    subject: Subject, experiments: list[Experiment], report: Report, progress: Callable[[str], None]
) -> None:
    """Drive the FMU; findings, rules applied and notes go into `report`."""

    def make(case: Case) -> Outcome:
        progress(case.rule)
        if case.rule not in report.checked:
            report.checked.append(case.rule)
        outcome = run(case, subject)
        for found in outcome.findings:
            if found not in report.findings:
                report.findings.append(found)
        return outcome

    if any(found.rule == "load" for found in make(Case("load", "library", lifecycle.load)).findings):
        report.notes.append("the library does not load, so no further rule was applied")
        return
    report.checked += ["types-platform", "version", "instantiate"]  # the same probe and the next have looked after them
    first = make(Case("legal-call", "a legal life", lifecycle.life))
    if first.value is None:
        report.notes.append("the FMU cannot be run, so no further rule was applied")
        return
    for case in _cases(subject, experiments):
        make(case)
    report.checked.append("memory")  # the probes of `free` have looked after it
    second = make(Case("legal-call", "a legal life", lifecycle.life))
    if repr(second.value) != repr(first.value):
        report.notes.append("two runs in fresh processes differ, so results were not compared")
        return
    for case in _comparisons(subject, first.value):
        make(case)
    if subject.description.says("canGetAndSetFMUstate") and subject.description.says("canSerializeFMUstate"):
        saved = make(Case("state-serialize", "fmi2SerializeFMUstate", states.serialize))
        if saved.value is not None:
            make(Case("state-serialize", "fmi2DeSerializeFMUstate", states.resume, saved.value))


def _cases(subject: Subject, experiments: list[Experiment]) -> Iterator[Case]:
    description = subject.description
    yield Case("guid-mismatch", "fmi2Instantiate", lifecycle.guid_mismatch, expected="a null pointer")
    for state, functions in FORBIDDEN.items():
        for function in functions:
            yield Case("call-order", f"{function} when {state}", lifecycle.forbidden_call, (state, function), _REFUSED)
    for function in _GET_AND_SET:
        yield Case("unknown-reference", function, values.unknown_reference, (function,), _REFUSED)
    yield from _refusals(subject)
    yield Case("start-value", "fmi2GetReal", values.start_values)
    yield Case("set-get", "fmi2SetReal", values.set_get)
    for number in (math.nan, math.inf):
        yield Case("nan-input", f"inputs = {number}", values.nan_input, (number,))
    if description.says("canInterpolateInputs"):
        yield Case("input-derivatives", "fmi2SetRealInputDerivatives", values.input_derivatives)
    if int(description.flags.get("maxOutputDerivativeOrder", "0")) > 0:
        yield Case("output-derivatives", "fmi2GetRealOutputDerivatives", values.output_derivatives)
    for factor in (0.0, -1.0, math.nan):
        yield Case("step-size", f"h = {factor} steps", steps.step_size, (factor,), _REFUSED)
    for offset in (-2, 10):
        yield Case("communication-point", f"{offset:+d} steps", steps.communication_point, (offset,), _REFUSED)
    yield Case("stop-time", "fmi2DoStep", steps.stop_time, expected=_REFUSED)
    if description.says("canHandleVariableCommunicationStepSize"):
        yield Case("step-variation", "fmi2DoStep", steps.variation)
    for state in STATES:
        yield Case("free", f"fmi2FreeInstance when {state}", lifecycle.free, (state,), "the instance freed")
    yield Case("free", "fmi2FreeInstance of null", lifecycle.free_null, expected="the call ignored")
    yield Case("silent", "logger", messages.silent)
    yield Case("prints", "stdout, stderr", messages.prints)
    yield Case("log-messages", "logger", messages.logged)
    if description.categories:
        yield Case("debug-logging", "fmi2SetDebugLogging", messages.debug_logging)
    if description.says("canGetAndSetFMUstate"):
        yield Case("state-free", "fmi2FreeFMUstate", states.free_state)
    for experiment in experiments:
        yield Case("ls-ref-replay", experiment.name, replay, (experiment,))


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


def _comparisons(subject: Subject, fresh: list[dict[str, Any]]) -> Iterator[Case]:
    """Probes whose results must be those of the run in a fresh process."""
    for state in STATES:
        yield Case("reset", f"when {state}", lifecycle.reset, (state, fresh))
    if not subject.description.says("canBeInstantiatedOnlyOncePerProcess"):
        yield Case("two-instances", "a second instance", lifecycle.two_instances, (fresh,))
    if subject.description.says("canGetAndSetFMUstate"):
        yield Case("state-restore", "fmi2SetFMUstate", states.restore)
