"""The one slave of all PythonFMUs: it reads a component from the FMU's resources and runs it as the Python face does.

`python_target` packs this file, and what it imports of `observers`, under names of their own: all FMUs of a process share sys.modules.
PythonFMU's library knows only exceptions, which it answers with fmi2Fatal and freed objects. So no method lets one out: a refusal is one
message with the status error, nothing has changed, and the relay around the library answers fmi2Error.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Sequence
from functools import cache, wraps
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from pythonfmu import Fmi2Slave
from pythonfmu.enums import Fmi2Status

from observers.clock import Clock
from observers.component import Component, Enumeration, Failure, Port, bounds
from observers.instance import Instance

INTEGERS = range(-(2**31), 2**31)  # fmi2Integer
DERIVATIVES = 0x40000000  # value references from here on: derivatives of the inputs, between relay and slave
INSTANTIATED, INITIALIZATION, STEP_COMPLETE, TERMINATED = range(4)
LIFECYCLES = ("instantiated", "in initialization mode", "initialized", "terminated")
SETTABLE = (INSTANTIATED, INITIALIZATION, STEP_COMPLETE)
PORTS = ("inputs", "parameters", "outputs", "constants")
TIME = 0x50000000  # this one: the time
CLOCK = struct.Struct("<qqqdddddd")  # lifecycle, whole, steps, label, phase, carry, step, t0, stop


@cache
def read_component(resources: str) -> Component:
    """The component that `python_target.resources` packed into this folder."""
    folder = Path(resources)
    fields: dict[str, Any] = json.loads((folder / "component.json").read_text())
    for group in PORTS:
        fields[group] = tuple(_port(port) for port in fields[group])
    for group in ("breaks", "counters"):
        fields[group] = tuple(fields[group])
    fields["failures"] = tuple(Failure(**failure) for failure in fields["failures"])
    for path in folder.glob("*.casadi"):
        fields[path.stem] = ca.Function.deserialize(path.read_text())
    return Component(**fields)


def _port(fields: dict[str, Any]) -> Port:
    enumeration = fields.pop("enumeration")
    if enumeration is not None:
        enumeration = Enumeration(enumeration["name"], tuple((item, text) for item, text in enumeration["items"]))
    return Port(**fields, enumeration=enumeration)


def answering(refusal: Callable[..., object]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """A method that reports what it raises as one message; `refusal` makes what PythonFMU's library then gets, of its arguments."""

    def decorate(method: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(method)
        def answer(self: ComponentSlave, *arguments: Any) -> Any:
            try:
                return method(self, *arguments)
            except ValueError as error:  # a refused call
                self.log(str(error), Fmi2Status.error, "logStatusError")
            except Exception as error:  # a function of the component can fail in any way
                self.log(f"{type(error).__name__}: {error}", Fmi2Status.error, "logStatusError")
            return refusal(*arguments)

        return answer

    return decorate


class ComponentSlave(Fmi2Slave):
    """One instance. Value references: inputs, parameters, outputs, constants, in the component's order."""

    def __init__(self, **kwargs: Any):
        super().__init__(**kwargs)
        self.component = read_component(kwargs["resources"])
        c = self.component
        self.ports = (*c.inputs, *c.parameters, *c.outputs, *c.constants)
        self.first_parameter = len(c.inputs)
        self.first_output = self.first_parameter + len(c.parameters)
        self.first_constant = self.first_output + len(c.outputs)
        self.lifecycle = INSTANTIATED
        self.values = np.array([0.0 if self.is_output(k) else port.start for k, port in enumerate(self.ports)])
        self.counters = [self.first_output + [port.name for port in c.outputs].index(name) for name in c.counters]
        self.counts = np.zeros(len(self.counters))
        self.derivatives = np.zeros(self.first_parameter)  # of the inputs, within the next step
        self.t0, self.stop = 0.0, math.inf
        self.run: Instance | None = None  # none until the start state is asked for; anew whenever a start value changes
        self.stale_outputs = True

    def is_output(self, reference: int) -> bool:
        return self.first_output <= reference < self.first_constant

    def allow(self, function: str, lifecycles: Sequence[int]) -> None:
        if self.lifecycle not in lifecycles:
            raise ValueError(f"{function} must not be called while the instance is {LIFECYCLES[self.lifecycle]}.")

    def started(self) -> Instance:
        """The run, started from the current values where it has not begun yet."""
        if self.run is None:
            self.run = self._start(self.values, self.t0, self.stop)
            self.stale_outputs = True
        return self.run

    def _start(self, values: np.ndarray, t0: float, stop: float) -> Instance:
        c = self.component
        inputs = {port.name: values[k] for k, port in enumerate(c.inputs)}
        parameters = {port.name: values[self.first_parameter + k] for k, port in enumerate(c.parameters)}
        return Instance(c, parameters, t0, inputs, stop)

    def refresh_outputs(self) -> None:
        run = self.started()
        if self.stale_outputs:
            self.values[self.first_output : self.first_constant] = run.outputs()
            self.stale_outputs = False

    @answering(lambda *_: None)
    def setup_experiment(self, start_time: float, stop_time: float | None = None, _: float | None = None) -> None:
        """PythonFMU calls it from fmi2EnterInitializationMode; the relay has looked at the times."""
        self.allow("fmi2SetupExperiment", (INSTANTIATED,))
        self.t0, self.stop = start_time, math.inf if stop_time is None else stop_time
        self.run = None

    @answering(lambda *_: None)
    def enter_initialization_mode(self) -> None:
        self.allow("fmi2EnterInitializationMode", (INSTANTIATED,))
        self.lifecycle = INITIALIZATION

    @answering(lambda *_: None)
    def exit_initialization_mode(self) -> None:
        self.allow("fmi2ExitInitializationMode", (INITIALIZATION,))
        run = self.started()
        self.lifecycle = STEP_COMPLETE
        self.log(
            f"{self.component.name}: initialized at t = {run.clock.t0:.15g}, sample time {run.sample_time:.10g}.",
            Fmi2Status.ok,
            "logEvents",
        )

    @answering(lambda *_: None)
    def terminate(self) -> None:
        self.allow("fmi2Terminate", (STEP_COMPLETE,))
        self.lifecycle = TERMINATED
        self.log(f"{self.component.name}: terminated at t = {self.started().time:.15g}.", Fmi2Status.ok, "logEvents")

    @answering(lambda *_: False)
    def do_step(self, current_time: float, step_size: float) -> bool:
        self.allow("fmi2DoStep", (STEP_COMPLETE,))
        run = self.started()
        before = run.z, run.clock
        run.step(current_time, step_size, self.derivatives)
        self.stale_outputs = True
        if self.counters:
            try:
                self.refresh_outputs()
            except Exception:
                run.z, run.clock = before
                raise
            self._warn_of_counters(run.time)
        self.derivatives[:] = 0
        return True

    def _warn_of_counters(self, time: float) -> None:
        """One warning for each counter that rose in the step. The step is fine: importers stop at less than fmi2OK."""
        counts = self.values[self.counters]
        for k, count in enumerate(counts):
            if count > self.counts[k]:
                name = self.ports[self.counters[k]].name
                self.log(
                    f"{self.component.name}: {name} rose to {count:.10g} at t = {time:.15g}.",
                    Fmi2Status.warning,
                    "logStatusWarning",
                )
        self.counts = counts

    def _find(self, function: str, reference: int, kind: str) -> Port:
        """The port of this value reference and type. Enumerations count as Integer, as in the standard."""
        if not 0 <= reference < len(self.ports):
            raise ValueError(
                f"{function}: no variable has the value reference {reference}, the largest is {len(self.ports) - 1}."
            )
        port = self.ports[reference]
        found = "Integer" if port.kind == "Enumeration" else port.kind
        if found != kind:
            raise ValueError(
                f"{function}: {port.name} (value reference {reference}) is not of type {kind} but {found}."
            )
        return port

    def _get(self, function: str, references: Sequence[int], kind: str) -> np.ndarray:
        if TIME in references:
            self.allow("fmi2GetRealStatus", (STEP_COMPLETE, TERMINATED))
            return np.array([self.started().time])
        ports = [self._find(function, reference, kind) for reference in references]
        for reference, port in zip(references, ports, strict=True):
            if self.is_output(reference) and self.lifecycle == INSTANTIATED:
                raise ValueError(f"{function}: {port.name} is not known before initialization mode.")
        if any(self.is_output(reference) for reference in references):
            self.refresh_outputs()
        values = self.values[list(references)]
        for reference, port, value in zip(references, ports, values, strict=True):
            if self.is_output(reference) and not math.isfinite(value):
                self._warn_of_value(port.name, value)
                break
        return values

    def _warn_of_value(self, name: str, value: float) -> None:
        """An output that is not finite because an input that feeds it is not; the relay answers fmi2Warning."""
        run = self.started()
        self.log(
            f"{self.component.name}: the output {name} is {value:g} at t = {run.time:.15g}{run.bad_input()}.",
            Fmi2Status.warning,
            "logStatusWarning",
        )

    def _set(self, function: str, references: Sequence[int], values: Sequence[float], kind: str) -> None:
        """Every entry is checked before the first is written: a refused call changes nothing."""
        self.allow(function, SETTABLE)
        if any(reference >= DERIVATIVES for reference in references):
            self.derivatives[np.array(references) - DERIVATIVES] = values
            return
        for reference, value in zip(references, values, strict=True):
            self._check(function, reference, value, kind)
        for reference, value in zip(references, values, strict=True):
            self.values[reference] = value
        if self.lifecycle == STEP_COMPLETE:
            run = self.started()
            for reference in references:
                run.set(self.ports[reference].name, float(self.values[reference]))
            self.stale_outputs = True
        else:
            self.run = None

    def _check(self, function: str, reference: int, value: float, kind: str) -> None:
        port = self._find(function, reference, kind)
        if reference < self.first_parameter:  # anything may come out of a sensor, NaN included
            return
        if reference >= self.first_output:
            what = "an output" if self.is_output(reference) else "a constant"
            raise ValueError(f"{function}: {port.name} is {what}, it cannot be set (to {value:.10g}).")
        if port.variability == "fixed" and self.lifecycle == STEP_COMPLETE:
            raise ValueError(
                f"{function}: {port.name} is a fixed parameter, {value:.10g} cannot be set after initialization."
            )
        low, high = bounds(port)
        if math.isinf(value):
            raise ValueError(f"{function}: {port.name} = {value:g} must be finite.")
        if not low <= value <= high:
            raise ValueError(f"{function}: {port.name} = {value:.10g} lies outside [{low:.10g}, {high:.10g}].")

    @answering(lambda references: [math.nan] * len(references))
    def get_real(self, vrs: list[int]) -> list[float]:
        return [float(value) for value in self._get("fmi2GetReal", vrs, "Real")]

    @answering(lambda references: [0] * len(references))
    def get_integer(self, vrs: list[int]) -> list[int]:
        values = self._get("fmi2GetInteger", vrs, "Integer")
        for reference, value in zip(vrs, values, strict=True):
            if not INTEGERS[0] <= value <= INTEGERS[-1]:
                raise ValueError(
                    f"fmi2GetInteger: {self.ports[reference].name} = {value:.10g} lies outside "
                    f"[{INTEGERS[0]}, {INTEGERS[-1]}]."
                )
        return [int(np.rint(value)) for value in values]

    @answering(lambda references: [False] * len(references))
    def get_boolean(self, vrs: list[int]) -> list[bool]:
        return [bool(value) for value in self._get("fmi2GetBoolean", vrs, "Boolean")]

    @answering(lambda references: [""] * len(references))
    def get_string(self, vrs: list[int]) -> list[str]:
        self._no_such_type("fmi2GetString", vrs)
        return []

    @answering(lambda *_: None)
    def set_real(self, vrs: list[int], values: list[float]) -> None:
        self._set("fmi2SetReal", vrs, values, "Real")

    @answering(lambda *_: None)
    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        self._set("fmi2SetInteger", vrs, values, "Integer")

    @answering(lambda *_: None)
    def set_boolean(self, vrs: list[int], values: list[bool]) -> None:
        self._set("fmi2SetBoolean", vrs, [float(bool(value)) for value in values], "Boolean")

    @answering(lambda *_: None)
    def set_string(self, vrs: list[int], values: list[str]) -> None:
        self._no_such_type("fmi2SetString", vrs)

    def _no_such_type(self, function: str, references: list[int]) -> None:
        """No component has String variables: any value reference is of the wrong type."""
        for reference in references:
            self._find(function, reference, function.removeprefix("fmi2")[3:])

    @answering(lambda *_: b"")
    def _get_fmu_state(self) -> bytes:
        """The whole state: clock, then doubles. To whom it belongs, and whether it is sound, is the relay's to say."""
        run = self.run
        clock = Clock(self.t0, 0.0, self.t0) if run is None else run.clock
        packed = CLOCK.pack(
            self.lifecycle,
            -1 if run is None else clock.whole,  # -1: the run has not been started
            clock.steps,
            clock.label,
            clock.phase,
            clock.carry,
            clock.step,
            self.t0,
            self.stop,
        )
        z = np.zeros(self.component.n_z) if run is None else run.z
        return packed + np.concatenate([self.values[: self.first_output], self.derivatives, self.counts, z]).tobytes()

    @answering(lambda *_: None)
    def _set_fmu_state(self, state: bytes) -> None:
        sizes = (self.first_output, len(self.derivatives), len(self.counts), self.component.n_z)
        if len(state) != CLOCK.size + 8 * sum(sizes):
            raise ValueError(f"fmi2SetFMUstate: {len(state)} bytes are no state of {self.component.name}.")
        lifecycle, whole, steps, label, phase, carry, step, t0, stop = CLOCK.unpack_from(state)
        numbers = np.frombuffer(state, dtype=float, offset=CLOCK.size).copy()
        known, derivatives, counts, z = np.split(numbers, np.cumsum(sizes)[:-1])
        started = lifecycle in (STEP_COMPLETE, TERMINATED)
        sound = (
            lifecycle in range(len(LIFECYCLES))
            and math.isfinite(t0)
            and stop >= t0
            and (whole >= 0 or (whole == -1 and not started))
            and all(self._is_sound(k, value) for k, value in enumerate(known))
            and np.all(np.isfinite(counts))
        )
        run = self._start(known, t0, stop) if sound and whole >= 0 else None
        if sound and run is not None:
            clock = Clock(t0, run.sample_time, label, whole, phase, carry, steps, step)
            sound = clock.is_sound() and np.all(np.isfinite(z)) and not run.failure(z)
            run.z, run.clock = z, clock
        if not sound:
            raise ValueError(f"fmi2SetFMUstate: the state holds what no instance of {self.component.name} can hold.")
        self.lifecycle, self.t0, self.stop, self.counts, self.run = lifecycle, t0, stop, counts, run
        self.derivatives, self.values[: self.first_output] = derivatives, known
        self.stale_outputs = True

    def _is_sound(self, reference: int, value: float) -> bool:
        """Can the input or parameter have this value?"""
        port = self.ports[reference]
        if port.kind != "Real" and not (math.isfinite(value) and value.is_integer()):
            return False
        low, high = (0, 1) if port.kind == "Boolean" else bounds(port)
        inside = math.isfinite(value) and low <= value <= high
        return inside or (reference < self.first_parameter and port.kind != "Boolean")

    @staticmethod
    def _fmu_state_to_bytes(state: bytes) -> bytes:
        return state

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> bytes:
        return state
