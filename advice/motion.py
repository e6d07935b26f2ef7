"""A plant natively, from any state: what the Gramians and the predictions are made of."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from advice.streams.native import sampled
from observers.component import Component
from observers.instance import Instance
from observers.model import Model


class Motion:
    """Runs of a model's plant, `sample_time` [s] from sample to sample, inputs held."""

    def __init__(self, model: Model, plant: Component, sample_time: float):
        self.model = model
        self.estimated = [v.name for v in (*model.states, *model.unknown_parameters)]
        self.driven = [port.name for port in plant.inputs]
        self._plant, self._Ts, self._ny, self._nx = plant, sample_time, len(model.outputs), len(model.states)
        self._sample = sampled(plant, sample_time)
        self._ports = [port.name for port in plant.parameters]
        self._z0 = Instance(plant).z
        self._p0 = np.array([port.start for port in plant.parameters])
        self._places = [self._ports.index(f"parameter.{v.name}") for v in model.unknown_parameters]

    def inputs(self, streams: Mapping[str, np.ndarray], samples: int) -> np.ndarray:
        """(samples, inputs of the plant), those that are missing at their start values."""
        start = {port.name: np.full(samples, port.start) for port in self._plant.inputs}
        return np.column_stack([*(streams.get(name, start[name]) for name in self.driven)] or [np.zeros((samples, 0))])

    def outputs(self, at: np.ndarray, inputs: np.ndarray, t0: float) -> np.ndarray:
        """What the outputs show at each sample, (samples, ny), of the states and unknown parameters `at` from t0 [s] on."""
        p, z = self._p0.copy(), self._z0.copy()
        p[self._places], z[: self._nx] = at[self._nx :], at[: self._nx]
        states = np.empty((len(inputs), len(z)))
        for k, u in enumerate(inputs):
            states[k] = z
            z, _ = self._sample(z, u, p, t0 + k * self._Ts)
        times = t0 + self._Ts * np.arange(len(inputs))
        return np.asarray(self._plant.output(states.T, inputs.T, p, times[None, :]).full()[: self._ny].T)
