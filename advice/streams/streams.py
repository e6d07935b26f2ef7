"""Streams of measurements with their truth: a plant, its known inputs, Gaussian sensor noise, and what corrupts them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from advice.streams.corruptions import Corruption
from observers.component import Component
from observers.instance import Instance

BEGIN, END = 0.4, 0.6  # of a stream's samples: while its sensor is corrupted
JITTER = 0.5  # of a sample time: the latest that a sample is taken after its instant
Values = dict[str, np.ndarray]


def no_inputs(seed: int, samples: int) -> Values:
    """Of a plant without known inputs, or whose inputs stay at their start values."""
    return {}


@dataclass(frozen=True)
class Scenario:
    """A plant and how it is measured: `samples` every `sample_time` [s], `noise` by output (standard deviations).

    `inputs`: (seed, samples) -> by input (samples,), held over a sample, or `linear` between samples. `start`: the plant's parameters;
    `spread`, by which part the start of a state differs at most from seed to seed. `jump`: a parameter and the factor by which it jumps
    when the corruption begins; `mismatch`: a known parameter and the plant's factor; None where the model has none. `settled`: samples
    after which an observer should have found the truth.
    """

    name: str
    plant: Component
    sample_time: float
    samples: int
    noise: Mapping[str, float]
    settled: int
    inputs: Callable[[int, int], Values] = no_inputs
    linear: bool = False
    start: Mapping[str, float] = field(default_factory=dict)
    spread: float = 0.1
    jump: tuple[str, float] | None = None
    mismatch: tuple[str, float] | None = None

    def allows(self, corruption: Corruption) -> bool:
        """Whether the model has what the corruption changes."""
        return {"jump": self.jump, "mismatch": self.mismatch}.get(corruption.plant, ()) is not None

    @property
    def during(self) -> slice:
        """The samples that a sensor's corruption acts on."""
        return slice(round(BEGIN * self.samples), round(END * self.samples))


@dataclass(frozen=True)
class Stream:
    """What arrives at the observer, `measured` by output and `inputs` by input, (n,); and the `truth` by the plant's outputs (`x.<name>`,
    `z.<name>`), (n + 1,), at t_0 to t_n.
    """

    scenario: Scenario
    corruption: Corruption
    seed: int
    measured: Values
    inputs: Values
    truth: Values


class Streams:
    """Makes the streams of a scenario; each motion of its plant is simulated once."""

    def __init__(self, scenario: Scenario):
        self.scenario = scenario
        self._simulated: dict[tuple[str, int], tuple[Values, Values]] = {}

    def stream(self, corruption: Corruption, seed: int) -> Stream:
        scenario = self.scenario
        outputs, truth = self._simulation(corruption.plant, seed)
        rng = np.random.default_rng([seed, 17])
        n = scenario.samples
        measured = {name: outputs[name] + std * rng.standard_normal(n) for name, std in scenario.noise.items()}
        if corruption.of_sensor is not None:
            victim = list(measured)[seed % len(measured)]
            spread, noise = float(np.std(outputs[victim])), scenario.noise[victim]
            measured[victim] = corruption.of_sensor(measured[victim], spread, noise, scenario.during, rng)
        return Stream(scenario, corruption, seed, measured, scenario.inputs(seed, n), truth)

    def _simulation(self, change: str, seed: int) -> tuple[Values, Values]:
        if (change, seed) not in self._simulated:
            self._simulated[change, seed] = _simulate(self.scenario, change, seed)
        return self._simulated[change, seed]


def slopes_of(scenario: Scenario, inputs: Values) -> np.ndarray:
    """Those of the plant's inputs over each sample (n, inputs); 0 where they are held, or stay at their start values."""
    still = np.zeros(scenario.samples)
    changes = [
        np.diff(inputs[p.name], append=inputs[p.name][-1]) if p.name in inputs else still for p in scenario.plant.inputs
    ]
    return np.reshape(changes, (-1, scenario.samples)).T / scenario.sample_time * scenario.linear


def _simulate(scenario: Scenario, change: str, seed: int) -> tuple[Values, Values]:
    """Clean outputs at the instants of measurement, (n,), and the truth at t_0 to t_n, (n + 1,), by name."""
    component, Ts, n, during = scenario.plant, scenario.sample_time, scenario.samples, scenario.during
    rng = np.random.default_rng([seed, 4])
    parameters = {port.name: port.start for port in component.parameters} | dict(scenario.start)
    for name, value in parameters.items():
        if name.startswith("start."):
            parameters[name] = value * (1 + scenario.spread * rng.uniform(-1, 1))
    if change == "mismatch" and scenario.mismatch:
        parameters[f"parameter.{scenario.mismatch[0]}"] *= scenario.mismatch[1]
    run = Instance(component, parameters)
    inputs = scenario.inputs(seed, n)
    names = [port.name for port in component.outputs]
    slopes = slopes_of(scenario, inputs)
    rows, measured = [], []
    for k in range(n):
        for name, values in inputs.items():
            run.set(name, values[k])
        if change == "jump" and scenario.jump and k == during.start:
            name, factor = scenario.jump
            run.set(f"parameter.{name}", parameters[f"parameter.{name}"] * factor)
        rows.append(run.outputs())
        delay = JITTER * Ts * rng.uniform() if change == "jitter" and during.start <= k < during.stop else 0.0
        if delay:
            run.step(run.time, delay, slopes[k])
            for i, port in enumerate(component.inputs):
                if port.name in inputs:
                    run.set(port.name, inputs[port.name][k] + slopes[k, i] * delay)
        measured.append(run.outputs())
        run.step(run.time, Ts - delay, slopes[k])
    rows.append(run.outputs())
    true, seen = np.array(rows), np.array(measured)
    outputs = {name: seen[:, names.index(name)] for name in scenario.noise}
    return outputs, {name: true[:, i] for i, name in enumerate(names) if "." in name}
