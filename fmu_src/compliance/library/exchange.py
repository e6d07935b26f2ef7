"""An instance in model exchange: integrated by explicit Euler steps, with its events."""

from __future__ import annotations

import ctypes
import math
from ctypes import c_double, c_int
from typing import Any

import numpy as np
from fmpy import fmi2

from fmu_src.compliance.library.calls import Broken
from fmu_src.compliance.library.instance import Instance
from fmu_src.compliance.rules import finding

MOST_ITERATIONS = 100  # of an event
CHANGE = 0.1  # of a state in a step, at most, in units of its size or nominal value: no model is unstable then in a few steps


class ExchangeInstance(Instance):
    """Between steps it is in continuous-time mode."""

    @property
    def time(self) -> float:
        return self.progress.time

    def exit_initialization(self) -> ExchangeInstance:
        self.legal("fmi2ExitInitializationMode")
        self.finish_event()
        return self

    @property
    def n_states(self) -> int:
        return len(self.subject.description.derivatives)

    def vector(self, what: str, size: int | None = None) -> np.ndarray:
        """The array (n) that fmi2Get<what> gives; without states or indicators, none, without a call."""
        size = self.n_states if size is None else size
        made = (c_double * size)()
        if size > 0:
            self.legal(f"fmi2Get{what}", made, size)
        return np.array(made)

    def indicators(self) -> np.ndarray:
        return self.vector("EventIndicators", self.subject.description.indicators)

    def set_states(self, x: np.ndarray) -> None:
        if x.size > 0:
            self.legal("fmi2SetContinuousStates", (c_double * x.size)(*x), x.size)

    def finish_event(self) -> None:
        """From event mode to continuous-time mode; Broken where the iteration does not end."""
        for _ in range(MOST_ITERATIONS):
            info = fmi2.fmi2EventInfo()
            self.legal("fmi2NewDiscreteStates", ctypes.byref(info))
            if info.terminateSimulation:
                self.progress.ended = True
                return
            if not info.newDiscreteStatesNeeded:
                self.progress.next_event = info.nextEventTime if info.nextEventTimeDefined else math.inf
                self.legal("fmi2EnterContinuousTimeMode")
                return
        expected = f"an end of the event iteration within {MOST_ITERATIONS} calls"
        raise Broken(finding("event-mode", "fmi2NewDiscreteStates", expected, "newDiscreteStatesNeeded = fmi2True"))

    def handle_event(self) -> None:
        self.legal("fmi2EnterEventMode")
        self.finish_event()

    def step(self) -> None:
        """One Euler step, shorter than the default experiment's where a state would change by more than CHANGE."""
        x, slope = self.vector("ContinuousStates"), self.vector("Derivatives")
        before = self.indicators()
        size = np.maximum(np.abs(x), self.vector("NominalsOfContinuousStates"))
        rate = float(np.max(np.abs(slope) / size, initial=0.0))
        h = min(self.subject.step, CHANGE / rate) if rate > 0 else self.subject.step
        end = min(self.progress.time + h, max(self.progress.next_event, self.progress.time))
        self.legal("fmi2SetTime", end)
        self.set_states(x + (end - self.progress.time) * slope)
        self.progress.time = end
        self.progress.steps += 1
        crossed = bool(np.any((self.indicators() > 0) != (before > 0)))
        enter, end_wanted = c_int(), c_int()
        self.legal("fmi2CompletedIntegratorStep", 1, ctypes.byref(enter), ctypes.byref(end_wanted))
        if end_wanted.value:
            self.progress.ended = True
        elif enter.value or crossed or end >= self.progress.next_event:
            self.handle_event()


def argument_lists() -> dict[str, tuple[Any, ...]]:
    """By function of model exchange, arguments for a call that the state machine forbids."""
    return {
        "fmi2NewDiscreteStates": (ctypes.byref(fmi2.fmi2EventInfo()),),
        "fmi2CompletedIntegratorStep": (1, ctypes.byref(c_int()), ctypes.byref(c_int())),
    }
