"""Probes of fmi2DoStep: step sizes, communication points, the stop time."""

from __future__ import annotations

from collections.abc import Iterator

from fmu_src.compliance.finding import Finding
from fmu_src.compliance.library.calls import ERROR, OK, WARNING, status_name
from fmu_src.compliance.library.fmu import Fmu
from fmu_src.compliance.rules import finding


def step_size(fmu: Fmu, factor: float) -> Iterator[Finding]:
    instance = fmu.initialized()
    h = factor * fmu.subject.step
    status = instance.call("fmi2DoStep", instance.time, h, 1)
    if status != ERROR:
        yield finding("step-size", f"fmi2DoStep with h = {h:g}", "fmi2Error", status_name(status))


def communication_point(fmu: Fmu, offset: int) -> Iterator[Finding]:
    """After three steps, one that begins `offset` steps away from where they ended."""
    instance = fmu.initialized()
    instance.run(3)
    time = instance.time + offset * fmu.subject.step
    status = instance.call("fmi2DoStep", time, fmu.subject.step, 1)
    if status != ERROR:
        subject = f"fmi2DoStep from t = {time:g} at t = {instance.time:g}"
        yield finding("communication-point", subject, "fmi2Error", status_name(status))


def stop_time(fmu: Fmu) -> Iterator[Finding]:
    instance = fmu.new().initialize(stop=fmu.subject.start + 2 * fmu.subject.step)
    instance.run(2)
    status = instance.call("fmi2DoStep", instance.time, fmu.subject.step, 1)
    if status != ERROR:
        yield finding("stop-time", f"fmi2DoStep beyond {instance.time:g}", "fmi2Error", status_name(status))


def variation(fmu: Fmu) -> Iterator[Finding]:
    """Shorter steps of several sizes; none longer than the default, which an FMU may have reasons to refuse."""
    instance = fmu.initialized()
    time = fmu.subject.start
    for factor in (1.0, 0.5, 0.5, 0.25, 0.75, 1.0, 0.125, 0.875):
        h = factor * fmu.subject.step
        status = instance.call("fmi2DoStep", time, h, 1)
        if status not in (OK, WARNING):
            yield finding(
                "step-variation", f"fmi2DoStep from t = {time:g} with h = {h:g}", "fmi2OK", status_name(status)
            )
            return
        time += h
        instance.computed()
