"""The Python face of a component: the same functions and the same time semantics as the FMU's shell, step by step.

Time is counted, never accumulated: sample instants are t0 + k Ts, and every time that a master hands in is snapped first to whole
nanoseconds and then to a sample instant nearby, so that masters which accumulate, multiply or round times get identical bits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca
import numpy as np

from observers.component import Component, bounds, check_sample_time

NANOSECONDS = 1e9
SNAP = 1e-6  # of a sample time, or of a second if that is less: times closer than this are the same
RESOLUTION = 4 * float(np.finfo(float).eps)  # of a time: what two masters' sums for it may differ by
COARSE = 0.01  # of a sample time: where RESOLUTION exceeds this, sample instants cannot be told apart


class Instance:
    """A component with its state, inputs, parameters and clock.

    Args:
        component: what to run.
        parameters: start values that differ from the component's, by name.
        t0: start time [s].
        inputs: input values before the first step, by name.
        stop: no step may end later [s].

    Raises:
        ValueError: an unknown name, a parameter outside its bounds, an impossible sample time, a start state that is not
            finite.
    """

    def __init__(
        self,
        component: Component,
        parameters: Mapping[str, float] | None = None,
        t0: float = 0.0,
        inputs: Mapping[str, float] | None = None,
        stop: float = math.inf,
    ):
        self.component = component
        self._evaluate = {name: _evaluation(function) for name, function in component.functions.items()}
        self._p_index = {port.name: i for i, port in enumerate(component.parameters)}
        self._u_index = {port.name: i for i, port in enumerate(component.inputs)}
        self._y_index = {port.name: i for i, port in enumerate(component.outputs)}
        self.p = np.array([port.start for port in component.parameters], dtype=float)
        self.u = np.array([port.start for port in component.inputs], dtype=float)
        for name, value in (parameters or {}).items():
            self._set_parameter(name, value)
        for name, value in (inputs or {}).items():
            self.u[self._index(self._u_index, "input", name)] = value
        if not math.isfinite(t0):
            raise ValueError(f"{component.name}: the start time {t0:g} is not finite")
        sample_time = component.sample_time
        if isinstance(sample_time, str):
            self.sample_time = float(self.p[self._p_index[sample_time]])
            check_sample_time(component.name, sample_time, self.sample_time)
        else:
            self.sample_time = float(sample_time)
        self._breaks = sorted(self.p[self._p_index[name]] for name in component.breaks)
        self.t0 = self.time = t0
        self.stop = stop
        self.ticks = 0
        self.z = self._evaluate["start"](self.p, t0)
        if failure := self._failure(self.z):
            raise ValueError(f"{failure}, for the start values")
        if not np.all(np.isfinite(self.z)):
            raise ValueError(f"{component.name}: the start values give no finite state at t = {t0:g}")

    def set(self, name: str, value: float) -> None:
        """Set an input or a tunable parameter; tunables act from the next flow or jump on.

        Raises:
            ValueError: there is neither of this name, it is a fixed parameter, or the value lies outside its bounds.
        """
        if name in self._u_index:
            self.u[self._u_index[name]] = value
            return
        index = self._index(self._p_index | self._u_index, "input or parameter", name)
        if self.component.parameters[index].variability == "fixed":
            raise ValueError(f"{self.component.name}: {name} is fixed: give it to the constructor")
        self._set_parameter(name, value)

    def get(self, name: str) -> float:
        """The output `name` at the current time.

        Raises:
            ValueError: there is none.
        """
        return float(self.outputs()[self._index(self._y_index, "output", name)])

    def outputs(self) -> np.ndarray:
        """All outputs at the current time, in the component's order."""
        return self._evaluate["output"](self.z, self.u, self.p, self.time)

    def step(self, t: float, h: float, derivatives: np.ndarray | float = 0.0) -> None:
        """From t to t + h: every sample instant in [t, t + h) jumps with the inputs set before, then the state flows to t + h.

        `derivatives` of the inputs (n_u) [their units per s] extrapolate them linearly within this step.

        Raises:
            ValueError: t is not the current time, h is not positive or exceeds the sample time of a component that samples
                its inputs, t + h lies beyond the stop time, t is so large that doubles cannot tell sample instants
                apart, the state would not be finite, or the component's motion cannot go on. The instance is then unchanged.
        """
        component, ts = self.component, self.sample_time
        if not (math.isfinite(h) and h > 0):
            raise ValueError(f"{component.name}: step size h = {h:g} must be positive")
        if not abs(t - self.time) <= self._tolerance(self.time):
            raise ValueError(f"{component.name}: step from t = {t:.15g}, but the current time is {self.time:.15g}")
        if component.samples_inputs and ts > 0 and h > ts * (1 + SNAP):
            raise ValueError(f"{component.name}: step size h = {h:g} exceeds the sample time {ts:g}")
        end = self._snap(t + h)
        if end > self.stop + self._tolerance(self.stop):
            raise ValueError(
                f"{component.name}: the step from t = {t:.15g} to {end:.15g} goes beyond the stop time {self.stop:.15g}"
            )
        if not (end >= self.time and math.isfinite(end)):
            raise ValueError(
                f"{component.name}: a step to t = {end:.15g} is impossible from the current time {self.time:.15g}"
            )
        if ts > 0 and RESOLUTION * abs(end) > COARSE * ts:
            raise ValueError(
                f"{component.name}: at t = {end:.15g} times are exact to {RESOLUTION * abs(end):.2g} s only, "
                f"too coarse for the sample time {ts:g}"
            )
        now, z, ticks, slack = self.time, self.z, self.ticks, self._tolerance(end)
        while True:
            tick = self.t0 + ticks * ts if ts > 0 else math.inf
            due = tick < end - slack
            if due and tick <= now + slack:
                if component.jump is not None:
                    z = self._evaluate["jump"](z, self._inputs(derivatives, tick), self.p, tick)
                ticks += 1
                continue
            until = tick if due else end
            for instant in self._breaks:
                if now + 1 / NANOSECONDS < instant < until - 1 / NANOSECONDS:
                    until = instant
                    break
            z = self._flow(z, now, until, derivatives)
            now = until
            if not due and until == end:
                break
        failure = self._failure(z)
        if failure or not np.all(np.isfinite(z)):
            bad = [
                f", where the input {n} is {self.u[i]:g}"
                for n, i in self._u_index.items()
                if not np.isfinite(self.u[i])
            ]
            cause = bad[0] if bad else ""
            if failure and not cause:
                raise ValueError(failure)
            raise ValueError(
                f"{component.name}: the state is not finite after the step from t = {t:g} to {t + h:g}{cause}"
            )
        self.time, self.z, self.ticks = end, z, ticks

    def _failure(self, z: np.ndarray) -> str:
        """What the component says of a motion that could not go on; empty where it could."""
        failures = self.component.failures
        if not failures or z[-3] == 0:
            return ""
        failure, time, measure = failures[int(z[-3]) - 1], z[-2], z[-1]
        return f"{self.component.name}: {failure.what} at t = {time:.10g}, where {failure.measure} is {measure:.4g}"

    def _flow(self, z: np.ndarray, start: float, end: float, derivatives: np.ndarray | float) -> np.ndarray:
        substeps = max(1, math.ceil((end - start) / self.component.max_step - SNAP))
        h = (end - start) / substeps
        for i in range(substeps):
            t = start + i * h
            z = self._evaluate["flow"](z, self._inputs(derivatives, t + h / 2), self.p, t, h)
        return z

    def _inputs(self, derivatives: np.ndarray | float, t: float) -> np.ndarray:
        """The inputs at time t within the step."""
        return self.u + derivatives * (t - self.time) if np.any(derivatives) else self.u

    def _tolerance(self, t: float) -> float:
        """How far two times at about t may lie apart and still be the same."""
        return max(SNAP * min(self.sample_time, 1.0), 1 / NANOSECONDS, RESOLUTION * abs(t))

    def _snap(self, t: float) -> float:
        t = self.t0 + float(np.rint((t - self.t0) * NANOSECONDS)) / NANOSECONDS
        if self.sample_time > 0:
            instant = self.t0 + float(np.rint((t - self.t0) / self.sample_time)) * self.sample_time
            if abs(t - instant) <= self._tolerance(t):
                return instant
        return t

    def _set_parameter(self, name: str, value: float) -> None:
        index = self._index(self._p_index, "parameter", name)
        port = self.component.parameters[index]
        low, high = bounds(port)
        if not low <= value <= high:
            raise ValueError(f"{self.component.name}: {name} = {value:.10g} lies outside [{low:.10g}, {high:.10g}]")
        if port.kind != "Real" and not float(value).is_integer():
            raise ValueError(f"{self.component.name}: {name} = {value:.10g} is not a whole number")
        self.p[index] = value

    def _index(self, known: Mapping[str, int], what: str, name: str) -> int:
        if name not in known:
            raise ValueError(f"{self.component.name} has no {what} '{name}'; known: {', '.join(known) or 'none'}")
        return known[name]


def _evaluation(function: ca.Function) -> Callable[..., np.ndarray]:
    """`function` on columns of doubles, through CasADi's buffers: a call of `Function` itself costs 100 us more."""
    made: tuple[Any, Callable[[], None]] = function.buffer()
    buffer, evaluate = made
    arguments = [np.zeros(function.numel_in(i)) for i in range(function.n_in())]
    result = np.zeros(function.numel_out(0))
    for i, argument in enumerate(arguments):
        buffer.set_arg(i, argument.data)
    buffer.set_res(0, result.data)

    def call(*values: np.ndarray | float) -> np.ndarray:
        for argument, value in zip(arguments, values, strict=True):
            argument[...] = value
        evaluate()
        if buffer.ret() != 0:
            raise ArithmeticError(f"'{function.name()}' could not be evaluated")
        return result.copy()

    return call
