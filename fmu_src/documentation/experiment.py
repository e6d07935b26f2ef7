"""The default experiment in Python: a component alone, or coupled with the plant that drives it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fmu_src.errors import ExperimentFailed
from observers.component import Component
from observers.instance import Instance


@dataclass(frozen=True)
class Recording:
    """At the communication points `times` (n) [s]: the component's inputs, its outputs and the plant's, each (n)."""

    times: np.ndarray
    inputs: dict[str, np.ndarray]
    outputs: dict[str, np.ndarray]
    plant: dict[str, np.ndarray] | None


def default_experiment(component: Component, driven_by: Component | None, most_steps: int) -> Recording:
    """Both from time 0 with their start values: get all outputs, set all inputs, step all; at most `most_steps` steps.

    Raises:
        ExperimentFailed: a step of the default experiment fails.
    """
    members = [component] if driven_by is None else [component, driven_by]
    h, steps = component.step_size, steps_of(component, most_steps)
    outputs: list[list[np.ndarray]] = [[] for _ in members]
    inputs = []
    try:
        instances = [Instance(member) for member in members]
        for k in range(steps + 1):
            values = [instance.outputs() for instance in instances]
            for record, now in zip(outputs, values, strict=True):
                record.append(now)
            for instance in instances:
                for other, now in zip(members, values, strict=True):
                    _connect(instance, other, now)
            inputs.append(instances[0].u.copy())
            if k < steps:
                for instance in instances:
                    instance.step(k * h, h)
    except (ValueError, RuntimeError) as error:
        raise ExperimentFailed(f"the default experiment of '{component.name}' fails: {error}") from error
    series = [
        dict(zip([port.name for port in member.outputs], np.array(record).T, strict=True))
        for member, record in zip(members, outputs, strict=True)
    ]
    return Recording(
        times=np.arange(steps + 1) * h,
        inputs=dict(zip([port.name for port in component.inputs], np.array(inputs).T, strict=True)),
        outputs=series[0],
        plant=series[1] if driven_by is not None else None,
    )


def respond(component: Component, inputs: Mapping[str, np.ndarray], steps: int) -> dict[str, np.ndarray]:
    """The outputs, each (steps + 1), to inputs that are given at every communication point, likewise (steps + 1).

    At t_k the inputs are set, then the outputs are taken, then follows the step to t_{k+1}.

    Raises:
        ExperimentFailed: a step fails.
    """
    h = component.step_size
    record = []
    try:
        instance = Instance(component)
        for k in range(steps + 1):
            for name, values in inputs.items():
                instance.set(name, values[k])
            record.append(instance.outputs())
            if k < steps:
                instance.step(k * h, h)
    except (ValueError, RuntimeError) as error:
        raise ExperimentFailed(f"the reference experiment of '{component.name}' fails: {error}") from error
    return dict(zip([port.name for port in component.outputs], np.array(record).T, strict=True))


def steps_of(component: Component, most_steps: int) -> int:
    """How many steps the default experiment has, at least 1 and at most `most_steps`."""
    return max(1, min(most_steps, round(component.stop_time / component.step_size)))


def _connect(instance: Instance, source: Component, values: np.ndarray) -> None:
    """Outputs go to inputs of equal names."""
    names = {port.name for port in instance.component.inputs}
    for port, value in zip(source.outputs, values, strict=True):
        if port.name in names:
            instance.set(port.name, value)
