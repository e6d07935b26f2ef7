"""Probes of derivatives: directional ones against finite differences, and those of the states in model exchange."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from ctypes import c_double, c_uint

import numpy as np

from fmu_src.compliance.files.description import Variable
from fmu_src.compliance.finding import Finding
from fmu_src.compliance.library.calls import OK, WARNING, status_name
from fmu_src.compliance.library.exchange import ExchangeInstance
from fmu_src.compliance.library.fmu import Fmu
from fmu_src.compliance.library.instance import Instance
from fmu_src.compliance.rules import finding

MOST_STEPS = 200  # of a run that looks for events
_MOST_KNOWNS = 20
_DIFFERENCE = 1e-5  # of a known's size or nominal value
_SMOOTH = 1e-4  # relative: what two finite differences, one half of the other, may differ by where they say anything
_SAME = 1e-3  # relative: of a directional derivative and finite differences


def directional(fmu: Fmu) -> Iterator[Finding]:
    """In co-simulation outputs by inputs, in initialization mode; in model exchange derivatives and outputs by states and inputs."""
    if fmu.subject.interface == "ModelExchange":
        yield from _by_states(fmu)
    else:
        yield from _by_inputs(fmu)


def _by_inputs(fmu: Fmu) -> Iterator[Finding]:
    listed = set(fmu.subject.description.initial_unknowns)
    unknowns = [variable for variable in _outputs(fmu) if variable.index in listed]
    instance = fmu.new().setup()
    instance.legal("fmi2EnterInitializationMode")
    yield from _by_each_input(instance, unknowns, _inputs(fmu))


def _by_states(fmu: Fmu) -> Iterator[Finding]:
    instance = fmu.initialized()
    assert isinstance(instance, ExchangeInstance)
    unknowns = list({variable.name: variable for variable in [*_derivatives(instance), *_outputs(fmu)]}.values())
    x = instance.vector("ContinuousStates")
    for place, known in enumerate(_states(instance)[:_MOST_KNOWNS]):

        def respond(value: float, place: int = place) -> np.ndarray:
            moved = x.copy()
            moved[place] = value
            instance.set_states(moved)
            return _values(instance, unknowns)

        yield from _compare(instance, unknowns, known, float(x[place]), respond)
        instance.set_states(x)
    yield from _by_each_input(instance, unknowns, _inputs(fmu))


def _by_each_input(instance: Instance, unknowns: list[Variable], inputs: list[Variable]) -> Iterator[Finding]:
    for known in inputs[:_MOST_KNOWNS]:

        def respond(value: float, known: Variable = known) -> np.ndarray:
            instance.set(known, value)
            return _values(instance, unknowns)

        assert isinstance(known.start, float)
        yield from _compare(instance, unknowns, known, known.start, respond)
        instance.set(known, known.start)


def _values(instance: Instance, variables: list[Variable]) -> np.ndarray:
    return np.array(list(instance.read(variables).values()), dtype=float)


def _inputs(fmu: Fmu) -> list[Variable]:
    return [v for v in fmu.subject.variables if v.causality == "input" and _is_continuous(v) and v.start is not None]


def _outputs(fmu: Fmu) -> list[Variable]:
    outputs = [v for v in fmu.subject.variables if v.causality == "output" and _is_continuous(v)]
    return list({variable.name: variable for variable in outputs}.values())


def _compare(
    instance: Instance, unknowns: list[Variable], known: Variable, at: float, respond: Callable[[float], np.ndarray]
) -> Iterator[Finding]:
    """The column of `known`, where finite differences of two sizes agree."""
    if not unknowns:
        return
    size = _DIFFERENCE * max(abs(at), abs(known.nominal))
    if not known.min <= at - size <= at + size <= known.max:
        return
    fine, coarse = ((respond(at + d) - respond(at - d)) / (2 * d) for d in (size / 2, size))
    noise = 1e4 * np.finfo(float).eps * np.abs(respond(at)) / size
    made = (c_double * len(unknowns))()
    status = instance.call(
        "fmi2GetDirectionalDerivative",
        (c_uint * len(unknowns))(*[variable.reference for variable in unknowns]),
        len(unknowns),
        (c_uint * 1)(known.reference),
        1,
        (c_double * 1)(1.0),
        made,
    )
    if status not in (OK, WARNING):
        subject = f"fmi2GetDirectionalDerivative by {known.name}"
        yield finding("directional-derivative", subject, "fmi2OK", status_name(status) + instance.reason)
        return
    found = np.array(made)
    smooth = np.abs(fine - coarse) <= _SMOOTH * np.abs(fine) + noise
    wrong = smooth & ~(np.abs(found - fine) <= _SAME * np.abs(fine) + noise)
    for place in np.flatnonzero(wrong):
        subject = f"{unknowns[place].name} by {known.name}"
        yield finding(
            "directional-derivative", subject, f"{fine[place]:.6g}, as finite differences", f"{found[place]:.6g}"
        )


def continuous_states(fmu: Fmu) -> Iterator[Finding]:
    """Read, set to values near by, read again; by reference too."""
    instance = fmu.initialized()
    assert isinstance(instance, ExchangeInstance)
    states = _states(instance)
    nominals, x = instance.vector("NominalsOfContinuousStates"), instance.vector("ContinuousStates")
    for state, nominal in zip(states, nominals, strict=True):
        if not 0 < nominal < np.inf:
            yield finding("continuous-states", state.name, "a positive nominal value", f"{nominal}")
    wanted = x + 0.01 * np.maximum(np.abs(x), 1.0)
    wanted = np.where(wanted <= [state.max for state in states], wanted, x) if states else wanted
    instance.set_states(wanted)
    by_vector = instance.vector("ContinuousStates")
    by_reference = instance.read(states)
    for state, value, read in zip(states, wanted, by_vector, strict=True):
        for place, got in (("fmi2GetContinuousStates", read), ("fmi2GetReal", by_reference[state.name])):
            if got != value:
                yield finding("continuous-states", f"{state.name} by {place}", f"{value} after it was set", f"{got}")


def along_a_run(fmu: Fmu) -> Iterator[Finding]:
    """Derivatives and event indicators; a derivative has the same value as a variable."""
    instance = fmu.initialized()
    assert isinstance(instance, ExchangeInstance)
    variables = _derivatives(instance)
    stop = np.inf if fmu.subject.stop is None else fmu.subject.stop
    for _ in range(MOST_STEPS):
        slopes, indicators = instance.vector("Derivatives"), instance.indicators()
        values = instance.read(variables)
        for variable, slope in zip(variables, slopes, strict=True):
            if not np.isfinite(slope):
                yield finding("state-derivatives", variable.name, "a finite number", f"{slope}")
            elif values[variable.name] != slope:
                expected = f"{slope} as from fmi2GetDerivatives"
                yield finding("state-derivatives", variable.name, expected, str(values[variable.name]))
        for place in np.flatnonzero(~np.isfinite(indicators)):
            yield finding(
                "state-derivatives", f"event indicator {place + 1}", "a finite number", f"{indicators[place]}"
            )
        if not np.all(np.isfinite(slopes)) or instance.progress.ended or instance.time >= stop:
            return
        instance.step()


def events(fmu: Fmu) -> Iterator[Finding]:
    """Event mode at once, then wherever indicators, time or the FMU ask for it, until the end of the experiment."""
    instance = fmu.initialized()
    assert isinstance(instance, ExchangeInstance)
    if not instance.progress.ended:
        instance.handle_event()
    stop = np.inf if fmu.subject.stop is None else fmu.subject.stop
    for _ in range(MOST_STEPS):
        if instance.progress.ended or instance.time >= stop:
            break
        instance.step()
    yield from ()


def _derivatives(instance: Instance) -> list[Variable]:
    variables = instance.subject.variables
    return [variables[index - 1] for index in instance.subject.description.derivatives]


def _states(instance: Instance) -> list[Variable]:
    variables = instance.subject.variables
    return [variables[(derivative.derivative or derivative.index) - 1] for derivative in _derivatives(instance)]


def _is_continuous(variable: Variable) -> bool:
    return variable.type == "Real" and variable.variability == "continuous"
