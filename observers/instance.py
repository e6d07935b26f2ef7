"""The Python face of a component: the same functions and the same time semantics as the FMU's shell, step by step.

Time is counted, never accumulated: sample instants are t0 + k Ts, and every time that a master hands in is snapped first to whole
nanoseconds and then to a sample instant nearby, so that masters which accumulate, multiply or round times get identical bits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from observers.component import Component

NANOSECONDS = 1e9
SNAP = 1e-6  # of a sample time: times closer than this to a sample instant are that instant


class Instance:
    """A component with its state, inputs, parameters and clock.

    Args:
        component: what to run.
        parameters: start values that differ from the component's, by name.
        t0: start time [s].
        inputs: input values before the first step, by name.
    """

    def __init__(
        self,
        component: Component,
        parameters: Mapping[str, float] | None = None,
        t0: float = 0.0,
        inputs: Mapping[str, float] | None = None,
    ):
        self.component = component
        self._p_index = {port.name: i for i, port in enumerate(component.parameters)}
        self._u_index = {port.name: i for i, port in enumerate(component.inputs)}
        self._y_index = {port.name: i for i, port in enumerate(component.outputs)}
        self.p = np.array([port.start for port in component.parameters], dtype=float)
        self.u = np.array([port.start for port in component.inputs], dtype=float)
        for name, value in (parameters or {}).items():
            self._set_parameter(name, value)
        for name, value in (inputs or {}).items():
            self.u[self._u_index[name]] = value
        sample_time = component.sample_time
        self.sample_time = float(self.p[self._p_index[sample_time]] if isinstance(sample_time, str) else sample_time)
        self._tolerance = max(SNAP * self.sample_time, 1 / NANOSECONDS)
        self._breaks = sorted(self.p[self._p_index[name]] for name in component.breaks)
        self.t0 = self.time = t0
        self.ticks = 0
        self.z = self._call("start", self.p, t0)

    def set(self, name: str, value: float) -> None:
        """Set an input or a tunable parameter; tunables act from the next flow or jump on."""
        if name in self._u_index:
            self.u[self._u_index[name]] = value
            return
        port = self.component.parameters[self._p_index[name]]
        if port.variability == "fixed":
            raise ValueError(f"{name} is fixed: give it to the constructor")
        self._set_parameter(name, value)

    def get(self, name: str) -> float:
        """The output `name` at the current time."""
        return float(self.outputs()[self._y_index[name]])

    def outputs(self) -> np.ndarray:
        """All outputs at the current time, in the component's order."""
        return self._call("output", self.z, self.u, self.p, self.time)

    def step(self, t: float, h: float) -> None:
        """From t to t + h: every sample instant in [t, t + h) jumps with the inputs set before, then the state flows to t + h.

        Raises:
            ValueError: t is not the current time, h is not positive or exceeds the sample time of a component that samples
                its inputs, or the state would not be finite. The instance is then unchanged.
        """
        component, ts = self.component, self.sample_time
        if not (math.isfinite(h) and h > 0):
            raise ValueError(f"{component.name}: step size h = {h:g} must be positive")
        if not abs(t - self.time) <= self._tolerance:
            raise ValueError(f"{component.name}: step from t = {t:.17g}, but the current time is {self.time:.17g}")
        if component.samples_inputs and ts > 0 and h > ts * (1 + SNAP):
            raise ValueError(f"{component.name}: step size h = {h:g} exceeds the sample time {ts:g}")
        end = self._snap(t + h)
        now, z, ticks = self.time, self.z, self.ticks
        while True:
            tick = self.t0 + ticks * ts if ts > 0 else math.inf
            due = tick < end - self._tolerance
            if due and tick <= now + self._tolerance:
                if component.jump is not None:
                    z = self._call("jump", z, self.u, self.p, tick)
                ticks += 1
                continue
            until = tick if due else end
            for instant in self._breaks:
                if now + 1 / NANOSECONDS < instant < until - 1 / NANOSECONDS:
                    until = instant
                    break
            z = self._flow(z, now, until)
            now = until
            if not due and until == end:
                break
        if not np.all(np.isfinite(z)):
            raise ValueError(f"{component.name}: the state is not finite after the step from t = {t:g} to {t + h:g}")
        self.time, self.z, self.ticks = end, z, ticks

    def _flow(self, z: np.ndarray, start: float, end: float) -> np.ndarray:
        substeps = max(1, math.ceil((end - start) / self.component.max_step - SNAP))
        h = (end - start) / substeps
        for i in range(substeps):
            z = self._call("flow", z, self.u, self.p, start + i * h, h)
        return z

    def _snap(self, t: float) -> float:
        t = self.t0 + float(np.rint((t - self.t0) * NANOSECONDS)) / NANOSECONDS
        if self.sample_time > 0:
            instant = self.t0 + float(np.rint((t - self.t0) / self.sample_time)) * self.sample_time
            if abs(t - instant) <= self._tolerance:
                return instant
        return t

    def _set_parameter(self, name: str, value: float) -> None:
        if name not in self._p_index:
            raise ValueError(
                f"{self.component.name} has no parameter '{name}'; known: {', '.join(self._p_index) or 'none'}"
            )
        port = self.component.parameters[self._p_index[name]]
        if not port.min <= value <= port.max:
            raise ValueError(f"{self.component.name}: {name} = {value:g} lies outside [{port.min:g}, {port.max:g}]")
        self.p[self._p_index[name]] = value

    def _call(self, function: str, *arguments: np.ndarray | float) -> np.ndarray:
        return np.asarray(self.component.functions[function].call(list(arguments))[0].full()).ravel()
