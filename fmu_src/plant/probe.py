"""A plant is tried in a process of its own, for it may end that: is it a function of states, inputs, parameters and time?

`python -m fmu_src.plant.probe REQUEST ANSWER CALL`: files, JSON but for CALL, in which the name of the function stands that is being
called. What it must be able to do is what FMI 2.0.4, 3.2, allows in Continuous-Time Mode: any point after any other.
"""

from __future__ import annotations

import ctypes
import json
import math
import mmap
import sys
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import fmi2
from fmpy.fmi1 import FMICallException, fmi1Error, fmi1Fatal

POINTS = 20  # for each of the sets of parameters
SETS = 3
REACHES = (0.3, 1.0, 3.0)  # nominal values, to either side of the start
DIFFERENCED = 4  # points at which derivatives are taken by differences
SAME = 1e-8  # of the largest value: what a plant that solves equations inside may leave open
STEP = 6e-6
WRONG = 1e-3  # of a derivative, that a directional one may differ by from a difference
SPREAD = 0.2  # of an unknown parameter's value
NAME_BYTES = 80


class Refused(Exception):
    """The plant cannot be used; the message is the rest of a sentence that begins with its name."""


def recorded(slave: Any, call: mmap.mmap) -> Any:
    """The slave, by fmpy, that leaves the name of each function in `call` before it calls it."""
    ask = slave._call

    def recording(name: str, *arguments: Any) -> Any:
        call[:NAME_BYTES] = name.encode().ljust(NAME_BYTES)
        return ask(name, *arguments)

    slave._call = recording
    return slave


class Plant:
    """The plant, initialised, with what the request says of it."""

    def __init__(self, request: dict[str, Any], call: mmap.mmap):
        self.request = request
        self.next_event = math.inf
        self.n = len(request["states"])
        identity = {"guid": request["guid"], "modelIdentifier": request["identifier"]}
        try:
            self.slave = recorded(
                fmi2.FMU2Model(**identity, unzipDirectory=request["folder"], requireFunctions=False), call
            )
        except Exception as error:  # the loader's or fmpy's own, of many kinds
            raise Refused(f"does not load: {error}") from None
        self.callbacks = fmi2.fmi2CallbackFunctions()
        self.callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(lambda *_: None)
        self.callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmi2.calloc)
        self.callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmi2.free)
        try:
            self.slave.instantiate(callbacks=self.callbacks)
        except Exception as error:
            raise Refused(f"refuses to be instantiated ({error})") from None
        self.initialise(None)
        self.starts = np.array(self.read(request["parameters"]))
        self.values = self.starts.copy()

    def initialise(self, parameters: np.ndarray | None) -> None:
        """From anew in Continuous-Time Mode at t = 0."""
        try:
            self.slave.setupExperiment(startTime=0.0)
            if parameters is not None and parameters.size:
                self.slave.setReal(self.request["parameters"], list(parameters))
            self.slave.enterInitializationMode()
            self.slave.exitInitializationMode()
        except FMICallException as error:
            raise Refused(f"cannot be initialized: {_said(error)}") from None
        self._settle()
        if self.next_event < math.inf and parameters is None:
            raise Refused(f"has a time event at t = {self.next_event:g}: nothing happens at one inside an observer")

    def _settle(self) -> None:
        for _ in range(100):
            again, ended, _, _, timed, at = self.slave.newDiscreteStates()
            if ended:
                raise Refused("asks to end the simulation at its initialization")
            if not again:
                self.next_event = at if timed else math.inf
                self.slave.enterContinuousTimeMode()
                return
        raise Refused("comes to no end with its event iteration at the initialization")

    def restart(self) -> None:
        """After an error."""
        try:
            self.slave.reset()
        except FMICallException:  # not every tool can
            self.slave.fmi2FreeInstance(self.slave.component)
            self.slave.instantiate(callbacks=self.callbacks)
        self.initialise(self.values)

    def tune(self, parameters: np.ndarray) -> None:
        """Other parameters: by an event, or where one is fixed by an initialisation."""
        changed = np.flatnonzero(parameters != self.values)
        self.values = parameters.copy()
        if any(self.request["fixed"][i] for i in changed):
            self.restart()
        elif changed.size:
            self.slave.setTime(0.0)
            self.slave.enterEventMode()
            self.slave.setReal(
                [self.request["parameters"][i] for i in changed], [float(parameters[i]) for i in changed]
            )
            self._settle()

    def read(self, references: list[int]) -> list[float]:
        return list(self.slave.getReal(references)) if references else []

    def states(self) -> np.ndarray:
        x = (ctypes.c_double * self.n)()
        self.slave.getContinuousStates(x, self.n)
        return np.array(x)

    def nominals(self) -> np.ndarray:
        x = (ctypes.c_double * self.n)()
        try:
            self.slave.getNominalsOfContinuousStates(x, self.n)
        except FMICallException:
            x[:] = [1.0] * self.n
        return np.array([own or said for own, said in zip(self.request["nominals"], x, strict=True)])

    def set(self, v: np.ndarray, t: float) -> None:
        self.slave.setTime(t)
        self.slave.setContinuousStates((ctypes.c_double * self.n)(*v[: self.n]), self.n)
        if self.request["inputs"]:
            self.slave.setReal(self.request["inputs"], [float(value) for value in v[self.n :]])

    def at(self, v: np.ndarray, t: float) -> np.ndarray:
        """Derivatives and outputs for states and inputs v; NaN where the plant refuses the point, or changes before."""
        if t > self.next_event:
            return np.full(self.n + len(self.request["outputs"]), np.nan)
        try:
            self.set(v, t)
            d = (ctypes.c_double * self.n)()
            self.slave.getDerivatives(d, self.n)
            found = np.array([*d, *self.read(self.request["outputs"])])
            left = self.states()
        except FMICallException as error:
            if error.status == fmi1Fatal:
                raise Refused(f"ends for good at a point near its start: {_said(error)}") from None
            if error.status == fmi1Error:
                self.restart()
            return np.full(self.n + len(self.request["outputs"]), np.nan)
        moved = np.flatnonzero(left != v[: self.n])
        if moved.size:
            i = int(moved[0])
            name = self.request["names"]["states"][i]
            raise Refused(
                f"changes its own states: '{name}' was set to {v[i]:.6g} and is {left[i]:.6g} once its derivatives were asked for"
            )
        return found


def examine(plant: Plant) -> dict[str, Any]:
    """What the parent wants to know; Refused where the plant is no function."""
    request, n = plant.request, plant.n
    start = np.array([*plant.states(), *request["input_starts"]])
    nominal = np.array([*plant.nominals(), *request["input_nominals"]])
    here = plant.at(start, 0.0)
    bad = [name for name, value in zip(_results(request), here, strict=True) if not np.isfinite(value)]
    if bad:
        raise Refused(f"gives no number for '{bad[0]}' at its own start")
    points, times, sets = _points(request, start, nominal, plant.starts)
    shuffled = np.random.default_rng(1).permutation(len(points)).tolist()
    low, high = np.array(request["min"]), np.array(request["max"])
    found = []
    for order, side in ((range(len(points)), -1), (sorted(shuffled, key=lambda i: -(i // POINTS)), 1)):
        results = np.empty((len(points), here.size))
        far = np.clip(start + side * max(REACHES) * nominal, low, high)  # from where it comes to every point
        for i in order:
            plant.tune(sets[i // POINTS])
            plant.at(far, times[i])
            results[i] = plant.at(points[i], times[i])
        found.append(results)
    scale = _compare(request, found)
    plant.tune(plant.starts)
    derivatives = [_slopes(plant, points[k], times[k], nominal) for k in range(DIFFERENCED)]
    said = [_directional(plant, points[k], times[k], J, scale, nominal) for k, J in enumerate(derivatives)]
    depends = np.any([J != 0 for J in derivatives], axis=0)
    _complete_steps(plant, points[1], scale, start)
    return {
        "start": start[:n].tolist(),
        "nominal": nominal[:n].tolist(),
        "parameters": plant.starts.tolist(),
        "directional": [bool(all(s[0] for s in said)), bool(all(s[1] for s in said))],
        "depends": depends.tolist(),
    }


def _results(request: dict[str, Any]) -> list[str]:
    return [*request["names"]["derivatives"], *request["names"]["outputs"]]


def _points(
    request: dict[str, Any], start: np.ndarray, nominal: np.ndarray, parameters: np.ndarray
) -> tuple[list[np.ndarray], list[float], list[np.ndarray]]:
    """Points (states, inputs), POINTS for each set of parameters, and times, around the start and within the bounds; first the start."""
    random = np.random.default_rng(0)
    low, high = np.array(request["min"]), np.array(request["max"])
    points, times = [start], [0.0]
    for k in range(SETS * POINTS - 1):
        reach = REACHES[k % len(REACHES)] * nominal
        points.append(np.clip(start + random.uniform(-1, 1, start.size) * reach, low, high))
        times.append(float(random.uniform(0, request["stop"])))
    sets = [parameters]
    unknown = np.array(request["unknown"], dtype=bool)
    size = np.where(parameters != 0, np.abs(parameters), request["parameter_nominals"])
    for _ in range(SETS - 1):
        moved = parameters + random.uniform(-SPREAD, SPREAD, parameters.size) * size * unknown
        sets.append(np.clip(moved, request["parameter_min"], request["parameter_max"]))
    return points, times, sets


def _compare(request: dict[str, Any], found: list[np.ndarray]) -> np.ndarray:
    """Largest results; Refused where the two orders have different ones."""
    one, other = found
    both = np.isfinite(one) & np.isfinite(other)
    if not both.any():
        raise Refused(f"gives no derivatives at any of {len(one)} points around its start")
    scale: np.ndarray = np.nanmax(np.abs(np.where(both, one, np.nan)), axis=0)
    scale = np.where(np.isfinite(scale) & (scale > 0), scale, 1.0)
    apart = (np.abs(one - other) > SAME * scale) | (np.isfinite(one) != np.isfinite(other))
    if apart.any():
        row, column = (int(i) for i in np.argwhere(apart)[0])
        raise Refused(
            f"remembers: {_results(request)[column]} at the same point is {one[row, column]:.6g} or {other[row, column]:.6g}, by what was "
            "asked before"
        )
    return scale


def _slopes(plant: Plant, v: np.ndarray, t: float, nominal: np.ndarray) -> np.ndarray:
    """Derivatives of the results by states and inputs, by central differences (results x variables)."""
    columns = []
    for j in range(v.size):
        step = np.zeros(v.size)
        step[j] = STEP * max(abs(v[j]), nominal[j])
        columns.append((plant.at(v + step, t) - plant.at(v - step, t)) / (2 * step[j]))
    return np.nan_to_num(np.array(columns).T)


def _directional(
    plant: Plant, v: np.ndarray, t: float, J: np.ndarray, scale: np.ndarray, nominal: np.ndarray
) -> tuple[bool, bool]:
    """Whether the plant's own directional derivatives are those of the differences: of the derivatives, of the outputs."""
    request, n = plant.request, plant.n
    if not request["directional"]:
        return False, False
    known = [*request["states"], *request["inputs"]]
    good = []
    for rows, unknown in ((slice(0, n), request["derivatives"]), (slice(n, None), request["outputs"])):
        right = True
        for j in range(v.size):
            seed = [float(i == j) for i in range(v.size)]
            try:
                plant.set(v, t)
                column = np.array(plant.slave.getDirectionalDerivative(unknown, known, seed))
            except FMICallException as error:
                if error.status >= fmi1Error:
                    plant.restart()
                right = False
                break
            size = np.maximum(np.abs(J[rows, j]), 1e-2 * scale[rows] / nominal[j])
            right = right and bool(np.all(np.abs(column - J[rows, j]) <= WRONG * size))
        good.append(right)
    return good[0], good[1]


def _complete_steps(plant: Plant, point: np.ndarray, scale: np.ndarray, start: np.ndarray) -> None:
    """Refused where completed steps leave something behind: a delay, a choice of states."""
    if not plant.request["completes_steps"]:
        return
    span = plant.request["stop"] / 10
    for k in range(10):
        plant.at(start + (k + 1) * 1e-3 * (point + 1), k * span)
        event, _ = plant.slave.completedIntegratorStep()
        if event:
            raise Refused(
                f"keeps a memory between steps (a delay, or a choice of states): it wants an event after the step to t = {k * span:g}"
            )
    after = plant.at(point, 9 * span)
    plant.restart()
    anew = plant.at(point, 9 * span)
    apart = np.flatnonzero(np.abs(after - anew) > SAME * scale)
    if apart.size:
        name = _results(plant.request)[apart[0]]
        raise Refused(
            f"keeps a memory between steps (a delay): {name} at the same point is {anew[apart[0]]:.6g}, after steps {after[apart[0]]:.6g}"
        )


def _said(error: Any) -> str:
    status = {2: "fmi2Discard", 3: "fmi2Error", 4: "fmi2Fatal"}.get(error.status, str(error.status))
    return f"{error.function} answers {status}"


def main() -> None:
    request, answer, call = (Path(argument) for argument in sys.argv[1:])
    call.write_bytes(b" " * NAME_BYTES)
    with call.open("r+b") as file:
        shared = mmap.mmap(file.fileno(), NAME_BYTES)
        try:
            result = examine(Plant(json.loads(request.read_text()), shared))
        except Refused as refused:
            result = {"refused": str(refused)}
        except FMICallException as error:
            result = {"refused": f"cannot be asked: {_said(error)}"}
        answer.write_text(json.dumps(result))


if __name__ == "__main__":
    main()
