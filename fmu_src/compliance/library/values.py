"""Probes of setting and getting: references, what may be set when, start values, values that are no numbers."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator, Sequence

from fmu_src.compliance.files.description import Value, Variable
from fmu_src.compliance.finding import Finding
from fmu_src.compliance.library.calls import ERROR, FATAL, Broken, status_name
from fmu_src.compliance.library.fmu import Fmu
from fmu_src.compliance.library.instance import Instance
from fmu_src.compliance.library.lifecycle import EXCHANGE_STATES, STEPS, other_value
from fmu_src.compliance.rules import finding

MOST_VARIABLES = 20  # of a kind are tried where each needs a process of its own
TOLERANCE = 1e-9  # relative: of a start value, which tools print with fewer digits than a double has
_ANY: dict[str, Value] = {"Real": 0.0, "Integer": 1, "Boolean": True, "String": "text"}


def sample(variables: Sequence[Variable]) -> list[Variable]:
    """At most MOST_VARIABLES of them, evenly spread."""
    stride = math.ceil(len(variables) / MOST_VARIABLES)
    return list(variables[:: max(stride, 1)])


def unknown_reference(fmu: Fmu, function: str) -> Iterator[Finding]:
    kind = function[len("fmi2Get") :]
    taken = {variable.reference for variable in fmu.subject.variables}
    reference = next(number for number in range(2**32 - 2, 0, -1) if number not in taken)
    nobody = Variable(0, "nobody", reference, kind, "local", "", None, None, 0, 0, 1, "", None, None)
    instance = fmu.initialized()
    if function.startswith("fmi2Set"):
        status = instance.try_set(nobody, _ANY[kind])
    else:
        room = (ctypes.c_double * 1)()  # large enough for a value of any kind
        status = instance.call(function, (ctypes.c_uint * 1)(reference), 1, room)
    if status != ERROR:
        yield finding("unknown-reference", f"{function} of {reference}", "fmi2Error", status_name(status))


def refused_set(fmu: Fmu, rule: str, variable: Variable, state: str) -> Iterator[Finding]:
    """`variable` is set, to its start value if it has one, while the instance is in `state`."""
    value = _ANY[variable.kind] if variable.start is None else variable.start
    status = EXCHANGE_STATES[state](fmu).try_set(variable, value)
    if status != ERROR:
        yield finding(rule, variable.name, f"fmi2Error when it is set to {value} while {state}", status_name(status))


def start_values(fmu: Fmu) -> Iterator[Finding]:
    variables = [
        variable
        for variable in fmu.subject.variables
        if variable.start is not None
        and (
            variable.causality == "input"
            or variable.variability == "constant"
            or (variable.causality == "parameter" and variable.initial == "exact")
        )
    ]
    values = fmu.initialized().read(variables)
    for variable in variables:
        assert variable.start is not None
        if not _equal(variable.start, values[variable.name]):
            yield finding("start-value", variable.name, f"{variable.start} as start value", str(values[variable.name]))


def _equal(expected: Value, found: Value) -> bool:
    if isinstance(expected, float) and isinstance(found, float):
        same = repr(expected) == repr(found)  # infinite or NaN
        return same or math.isclose(expected, found, rel_tol=TOLERANCE, abs_tol=0.0)
    return expected == found


def set_get(fmu: Fmu) -> Iterator[Finding]:
    """What is set is read where the standard allows that: in initialization mode, and after the step that follows.

    In the step-complete state of co-simulation nothing is read between setting and stepping (section 4.2.4). Parameters are set
    to their start values before initialization, inputs in it, what can be set later to other values.
    """
    variables = [variable for variable in fmu.subject.variables if variable.start is not None]
    inputs = {variable: _changed(variable) for variable in variables if variable.causality == "input"}
    instance = fmu.new()
    for variable in variables:
        if variable.settable_before_initialization and variable.causality == "parameter":
            assert variable.start is not None
            instance.set(variable, variable.start)
    instance.setup()
    instance.legal("fmi2EnterInitializationMode")
    yield from _set_and_read(instance, inputs, lambda: True)
    instance.exit_initialization()
    later = {variable: _changed(variable) for variable in variables if fmu.subject.settable_in_steps(variable)}
    yield from _set_and_read(instance, later, lambda: _can_step(instance))


def _set_and_read(instance: Instance, wanted: dict[Variable, Value], between: Callable[[], bool]) -> Iterator[Finding]:
    for variable, value in wanted.items():
        instance.set(variable, value)
    if not between():
        return
    values = instance.read(list(wanted))
    for variable, value in wanted.items():
        if not _equal(value, values[variable.name]):
            yield finding("set-get", variable.name, f"{value} after it was set", str(values[variable.name]))


def _can_step(instance: Instance) -> bool:
    """One step; not one that is refused, for all inputs and tunable parameters have just been set to values made up here."""
    try:
        instance.step()
    except Broken:
        return False
    return True


def _changed(variable: Variable) -> Value:
    if variable.type == "Real":
        return other_value(variable.start, variable.min, variable.max)
    if variable.type == "Boolean":
        return not variable.start
    assert variable.start is not None
    if (
        variable.type == "Integer"
        and isinstance(variable.start, int)
        and variable.start + 1 <= min(variable.max, 2**31 - 1)
    ):
        return variable.start + 1
    return variable.start


def nan_input(fmu: Fmu, value: float) -> Iterator[Finding]:
    """All Real inputs take `value` for two steps, which may be refused; no crash, no hang, no fmi2Fatal."""
    instance = fmu.initialized()
    instance.run(1)
    for variable in fmu.subject.variables:
        if variable.causality == "input" and variable.type == "Real" and fmu.subject.settable_in_steps(variable):
            status = instance.try_set(variable, value)
            if status == FATAL:
                yield finding("nan-input", variable.name, f"no fmi2Fatal at {value}", status_name(status))
                return
    for _ in range(2):
        try:
            instance.step()
        except Broken as refused:
            if status_name(FATAL) in refused.finding.found:
                yield finding(
                    "nan-input", refused.finding.subject, f"no fmi2Fatal with inputs of {value}", refused.finding.found
                )
            return
        instance.computed()


def input_derivatives(fmu: Fmu) -> Iterator[Finding]:
    inputs = [
        v
        for v in fmu.subject.variables
        if v.causality == "input" and v.type == "Real" and v.variability == "continuous"
    ]
    instance = fmu.initialized()
    for variable in inputs:
        status = instance.call(
            "fmi2SetRealInputDerivatives",
            (ctypes.c_uint * 1)(variable.reference),
            1,
            (ctypes.c_int * 1)(1),
            (ctypes.c_double * 1)(0.0),
        )
        if status >= ERROR:
            yield finding("input-derivatives", variable.name, "fmi2OK for its first derivative", status_name(status))
            return
    instance.run(STEPS)


def output_derivatives(fmu: Fmu) -> Iterator[Finding]:
    outputs = [
        v
        for v in fmu.subject.variables
        if v.causality == "output" and v.type == "Real" and v.variability == "continuous"
    ]
    instance: Instance = fmu.initialized()
    instance.run(1)
    for variable in outputs:
        status = instance.call(
            "fmi2GetRealOutputDerivatives",
            (ctypes.c_uint * 1)(variable.reference),
            1,
            (ctypes.c_int * 1)(1),
            (ctypes.c_double * 1)(),
        )
        if status >= ERROR:
            yield finding("output-derivatives", variable.name, "fmi2OK for its first derivative", status_name(status))
            return
