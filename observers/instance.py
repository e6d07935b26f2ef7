"""The Python face of a component: the same functions and the same time semantics as the FMU's shell, step by step.

Time is counted, never accumulated: sample instants are t0 + k Ts, and a step moves the clock by h in units of Ts, whatever the master
calls the time (`clock.py`): steps of h = Ts (1 +- 1e-6) take one sample each for as long as the run goes, and masters that add up,
multiply or round their times get identical bits. In a step from t to t + h every sample instant in [t, t + h) jumps with the inputs
that were set before, then the state flows to t + h.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from observers.clock import COARSE, NANOSECONDS, RESOLUTION, SNAP, Clock
from observers.component import Component, bounds, check_sample_time

MOST_SUBSTEPS = 1e6  # in one step: nothing can interrupt them
UNDEFINED = {  # what is said where a function of the component cannot be evaluated
    "start": "the start values give no finite state",
    "flow": "the motion could not be evaluated",
    "jump": "the sample could not be evaluated",
    "output": "the outputs could not be evaluated",
}


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
            finite or cannot be evaluated.
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
        self._evaluate = {name: _evaluation(component, name) for name in component.functions}
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
        self._breaks = sorted(self.p[self._p_index[name]] - t0 for name in component.breaks)  # [s since t0]
        self.clock = Clock(t0, self.sample_time, label=t0)
        self.stop = stop
        self.z = self._evaluate["start"](self.p, t0)
        if failure := self.failure(self.z):
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
            ValueError: there is none; see `outputs`.
        """
        return float(self.outputs()[self._index(self._y_index, "output", name)])

    def outputs(self) -> np.ndarray:
        """All outputs at the current time, in the component's order.

        Raises:
            ValueError: one is not finite, though all inputs are. An input that is not finite may show in an output that it feeds.
        """
        return self._outputs(self.z, self.time)

    @property
    def time(self) -> float:
        """Current time [s]."""
        return self.clock.time

    @property
    def ticks(self) -> int:
        """Sample instants so far."""
        return self.clock.ticks

    def step(self, t: float, h: float, derivatives: np.ndarray | float = 0.0) -> None:
        """From t to t + h: every sample instant in [t, t + h) jumps with the inputs set before, then the state flows to t + h.

        `derivatives` of the inputs (n_u) [their units per s] extrapolate them linearly within this step.

        Raises:
            ValueError: t is half a step or more off the current time, h is not positive or exceeds the sample time of a component that
                samples its inputs, t + h lies beyond the stop time, t is so large that doubles cannot tell steps or sample instants
                apart, h takes more than 10^6 substeps, the state or an output would not be finite, a function of the component
                cannot be evaluated, or its motion cannot go on. The instance is then unchanged.
        """
        component = self.component
        clock = self._clock_after(t, h)
        z, now = self.z, self.clock.elapsed
        for k in range(self.clock.ticks, clock.ticks):
            tick = k * self.sample_time
            if tick > now:
                z = self._flow(z, now, tick, derivatives)
                now = tick
            if component.jump is not None:
                z = self._evaluate["jump"](z, self._inputs(derivatives, tick), self.p, self.clock.t0 + tick)
        z = self._flow(z, now, clock.elapsed, derivatives)
        failure = self.failure(z)
        if failure or not np.all(np.isfinite(z)):
            cause = self.bad_input()
            if failure and not cause:
                raise ValueError(failure)
            if not cause and math.isfinite(component.max_step):
                cause = f"; a model that is stiff there wants a smaller max_step than {component.max_step:.10g}"
            raise ValueError(
                f"{component.name}: the state is not finite after the step from t = {t:.15g} to {clock.time:.15g}{cause}"
            )
        self._outputs(z, clock.time)
        self.clock, self.z = clock, z

    def _clock_after(self, t: float, h: float) -> Clock:
        """The clock after the step, if the step is legal."""
        name, clock, ts, longest = self.component.name, self.clock, self.sample_time, self.component.max_step
        if not (math.isfinite(h) and h > 0):
            raise ValueError(f"{name}: step size h = {h:.10g} must be positive")
        if (off := clock.error_of(t, h)) != 0:
            raise ValueError(
                f"{name}: step from t = {t:.15g}, but the current time is {clock.label:.15g} ({clock.time:.15g} by the count "
                f"of steps): off by {off:.3g} steps of {h:.10g}"
            )
        rounding = RESOLUTION * abs(t + h)
        if self.component.samples_inputs and ts > 0 and h > ts * (1 + SNAP) + rounding:
            raise ValueError(f"{name}: step size h = {h:.10g} exceeds the sample time {ts:.10g}")
        if ts > 0 and rounding > COARSE * ts:
            raise ValueError(
                f"{name}: at t = {t + h:.15g} times are exact to {rounding:.2g} s only, too coarse for the sample time {ts:.10g}"
            )
        if rounding > h / 2:
            raise ValueError(
                f"{name}: at t = {t + h:.15g} times are exact to {rounding:.2g} s only, too coarse for the step size {h:.10g}"
            )
        try:
            after = clock.after(t, h)
        except OverflowError:
            raise ValueError(
                f"{name}: a step to t = {t + h:.15g} is impossible from the current time {clock.time:.15g}"
            ) from None
        end, slack = min(t + h, after.time), max(SNAP * min(ts, 1.0), 1 / NANOSECONDS, RESOLUTION * abs(self.stop))
        if end > self.stop + slack:
            raise ValueError(
                f"{name}: the step from t = {t:.15g} to {end:.15g} goes beyond the stop time {self.stop:.15g}"
            )
        needed = h / longest + (after.ticks - clock.ticks)
        if needed > MOST_SUBSTEPS:
            raise ValueError(
                f"{name}: a step of h = {h:.10g} takes {needed:.3g} substeps (max_step = {longest:.10g}, sample time "
                f"{ts:.10g}), and no more than {MOST_SUBSTEPS:.0f} are taken at once: nothing could interrupt them"
            )
        return after

    def bad_input(self) -> str:
        """Which input is not finite; empty if all are."""
        for name, i in self._u_index.items():
            if not np.isfinite(self.u[i]):
                return f", where the input {name} is {self.u[i]:g}"
        return ""

    def _outputs(self, z: np.ndarray, time: float) -> np.ndarray:
        y = self._evaluate["output"](z, self.u, self.p, time)
        bad = np.flatnonzero(~np.isfinite(y))
        if bad.size and not self.bad_input():
            name = self.component.outputs[bad[0]].name
            raise ValueError(f"{self.component.name}: the output {name} is {y[bad[0]]:g} at t = {time:.15g}")
        return y

    def failure(self, z: np.ndarray) -> str:
        """What the component says of a motion that could not go on; empty where it could."""
        failures = self.component.failures
        if not failures or z[-3] == 0:
            return ""
        failure, time, measure = failures[int(z[-3]) - 1], z[-2], z[-1]
        return f"{self.component.name}: {failure.what} at t = {time:.10g}, where {failure.measure} is {measure:.4g}"

    def _flow(self, z: np.ndarray, start: float, end: float, derivatives: np.ndarray | float) -> np.ndarray:
        """From `start` to `end` [s since t0], cut at the breaks."""
        for instant in self._breaks:
            if start + 1 / NANOSECONDS < instant < end - 1 / NANOSECONDS:
                z = self._substeps(z, start, instant, derivatives)
                start = instant
        return self._substeps(z, start, end, derivatives)

    def _substeps(self, z: np.ndarray, start: float, end: float, derivatives: np.ndarray | float) -> np.ndarray:
        """Inputs that change over a substep are held over each half of it, at what they are after one and after five sixths: their
        integral and first moment are exact then, and the motion is of order 4 in the substep."""
        substeps = max(1, math.ceil((end - start) / self.component.max_step - SNAP))
        h, changing = (end - start) / substeps, bool(np.any(derivatives))
        part = h / 2 if changing else h
        for i in range(substeps):
            s = start + i * h
            t = self.clock.t0 + s
            z = self._evaluate["flow"](z, self._inputs(derivatives, s + h / 6), self.p, t, part)
            if changing:
                z = self._evaluate["flow"](z, self._inputs(derivatives, s + h * 5 / 6), self.p, t + part, part)
        return z

    def _inputs(self, derivatives: np.ndarray | float, s: float) -> np.ndarray:
        """The inputs at time s [s since t0] within the step."""
        return self.u + derivatives * (s - self.clock.elapsed) if np.any(derivatives) else self.u

    def _set_parameter(self, name: str, value: float) -> None:
        index = self._index(self._p_index, "parameter", name)
        port = self.component.parameters[index]
        low, high = bounds(port)
        if math.isinf(value):
            raise ValueError(f"{self.component.name}: {name} = {value:g} must be finite")
        if not low <= value <= high:
            raise ValueError(f"{self.component.name}: {name} = {value:.10g} lies outside [{low:.10g}, {high:.10g}]")
        if port.kind != "Real" and not float(value).is_integer():
            raise ValueError(f"{self.component.name}: {name} = {value:.10g} is not a whole number")
        self.p[index] = value

    def _index(self, known: Mapping[str, int], what: str, name: str) -> int:
        if name not in known:
            raise ValueError(f"{self.component.name} has no {what} '{name}'; known: {', '.join(known) or 'none'}")
        return known[name]


def _evaluation(component: Component, name: str) -> Callable[..., np.ndarray]:
    """The function on columns of doubles, through CasADi's buffers: a call of `Function` itself costs 100 us more."""
    function = component.functions[name]
    made: tuple[Any, Callable[[], None]] = function.buffer()
    buffer, evaluate = made
    arguments = [np.zeros(function.numel_in(i)) for i in range(function.n_in())]
    result = np.zeros(function.numel_out(0))
    for i, argument in enumerate(arguments):
        buffer.set_arg(i, argument.data)
    buffer.set_res(0, result.data)
    time = arguments[1 if name == "start" else 3]

    def call(*values: np.ndarray | float) -> np.ndarray:
        for argument, value in zip(arguments, values, strict=True):
            argument[...] = value
        try:
            evaluate()
            undefined = buffer.ret() != 0  # compiled functions answer so, CasADi's own raise
        except RuntimeError:
            undefined = True
        if undefined:
            raise ValueError(f"{component.name}: {UNDEFINED[name]} at t = {time[0]:.15g}")
        return result.copy()

    return call
