"""A plant natively, from any state: what Gramians, predictions and fits in hindsight are made of."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from advice.streams.native import sampled
from observers.component import Component


class Motion:
    """Runs of a plant, `sample_time` [s] from sample to sample, its inputs held or `linear` between them.

    `estimated`: the names of its states and unknown parameters; `driven`: of its inputs. `start`: parameters that differ from the plant's.
    """

    def __init__(
        self, plant: Component, sample_time: float, linear: bool = False, start: Mapping[str, float] | None = None
    ):
        parameters = [port.name for port in plant.parameters]
        shown = [port.name.removeprefix("x.") for port in plant.outputs if port.name.startswith("x.")]
        set_by = {name: f"start.{name}" if f"start.{name}" in parameters else f"parameter.{name}" for name in shown}
        self.estimated = shown
        self.driven = [port.name for port in plant.inputs]
        self._plant, self._Ts, self._linear = plant, sample_time, linear
        self._sample = sampled(plant, sample_time, linear)
        self._p = np.array([(start or {}).get(port.name, port.start) for port in plant.parameters])
        self._places = [parameters.index(set_by[name]) for name in shown]
        self._shown = [i for i, port in enumerate(plant.outputs) if "." not in port.name]

    def inputs(self, given: Mapping[str, np.ndarray], samples: int) -> np.ndarray:
        """(samples, inputs of the plant), those that are missing at their start values."""
        start = {port.name: np.full(samples, port.start) for port in self._plant.inputs}
        return np.reshape([given.get(name, start[name]) for name in self.driven], (-1, samples)).T

    def outputs(self, at: np.ndarray, inputs: np.ndarray, t0: float) -> np.ndarray:
        """What the outputs show at each sample, (samples, ny), of the states and unknown parameters `at` from t0 [s] on; not finite where
        the motion is not.
        """
        p = self._p.copy()
        p[self._places] = at
        z = self._plant.start(p, t0).full().ravel()
        slopes = np.diff(inputs, axis=0, append=inputs[-1:]) / self._Ts
        states = np.empty((len(inputs), len(z)))
        for k, u in enumerate(inputs):
            states[k] = z
            z, _ = self._sample(z, np.concatenate([u, slopes[k]]) if self._linear else u, p, t0 + k * self._Ts)
        times = t0 + self._Ts * np.arange(len(inputs))
        return np.asarray(self._plant.output(states.T, inputs.T, p, times[None, :]).full()[self._shown].T)
