"""How a model moves by itself, from its start values with its inputs held at theirs, and the longest step with which a method follows that.

A model that is slow where it starts may be fast where it goes: a relaxation oscillator, an ignition.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import LSODA

from observers.model import Model
from observers.numerics.algebraic import followed, motion
from observers.numerics.runge_kutta import Tableau, runge_kutta

HORIZON = 10_000  # of the longest steps
STRIDE = 100  # of the longest steps, which the implicit method does not exceed: it would not see a pulse, or a bound
POINTS = 500  # of an implicit method's steps at most: some periods of an oscillation, all of what comes to rest
FAR = 1e6  # times the nominal or the start value: what goes there is left to grow by inputs that nobody drives
DWELL = 10  # steps: what is passed faster than in so many of them does not grow however unstable the method is
MOST_HALVINGS = 12
MAJORITY = 0.25  # of the points that a halving mends
SHORTER = ((2, 4), (3, 8), (5, 8))  # pairs of how many steps: across a jump one of them may be near the other by luck

# step(x, z, t, h) -> x: states (nx x N), algebraic variables (nz x N) and times (1 x N) of N points, each moved by h.
Step = Callable[[ca.DM, ca.DM, ca.DM, float], ca.DM]


@dataclass(frozen=True)
class FreeMotion:
    """Points of a motion, as far as it stays within the model's bounds and where its equations hold.

    `times` (N), `states` (nx x N), `algebraic` (nz x N), `scale` (nx): the largest values on the way, or the nominal ones. `rate`: function
    (x, z, t) -> (x', z), z from a value nearby; everything else is at its start value. `jacobian` (x, z, t) -> dx'/dx.
    """

    times: np.ndarray
    states: np.ndarray
    algebraic: np.ndarray
    scale: np.ndarray
    rate: ca.Function
    jacobian: ca.Function

    def thinned(self, most: int) -> FreeMotion:
        """At most so many of the points."""
        every = slice(None, None, -(-len(self.times) // most))
        return replace(self, times=self.times[every], states=self.states[:, every], algebraic=self.algebraic[:, every])


def free_motion(model: Model, longest: float) -> FreeMotion | None:
    """The motion from t = 0 over HORIZON steps of `longest` [s]; None where there is none, or it grows out of all bounds."""
    functions = _functions(model)
    rhs = _Rhs(functions.rate, [v.start for v in model.algebraic])
    start, nominal, low, high = (np.array([getattr(v, what) for v in model.states]) for what in _FIELDS)
    points: list[tuple[float, np.ndarray, np.ndarray]] = []
    ended = False
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # of a solver that fails
        solver = LSODA(rhs, 0.0, start, HORIZON * longest, max_step=STRIDE * longest, rtol=1e-6, atol=1e-8 * nominal)
        while len(points) < POINTS:
            rhs(solver.t, solver.y)
            if np.any(np.abs(solver.y) > FAR * np.maximum(nominal, np.abs(start))):
                return None
            within = np.all((low <= solver.y) & (solver.y <= high))  # false for NaN
            ended = not within or solver.status == "failed" or not functions.goes_on(solver.y, rhs.z, solver.t, points)
            if ended:
                break
            points.append((solver.t, solver.y.copy(), rhs.z.copy()))
            if solver.status == "finished":
                break
            solver.step()
    # Near its end a motion may be arbitrarily fast: no step follows it there.
    kept = [point for point in points if not ended or point[0] <= points[-1][0] - DWELL * longest]
    if not kept:
        return None
    x = np.array([point[1] for point in kept]).T
    scale = np.maximum(nominal, np.abs(x).max(axis=1))
    z = np.array([point[2] for point in kept]).T
    return FreeMotion(np.array([point[0] for point in kept]), x, z, scale, functions.rate, functions.jacobian)


class _Rhs:
    """(t, x) -> x' for scipy, without CasADi's overhead of a call; `z` is solved from its last value."""

    def __init__(self, rate: ca.Function, z: list[float]) -> None:
        self._x, self.z, self._t = np.zeros(rate.numel_in(0)), np.array(z), np.zeros(1)
        self._moved, self._solved = np.zeros_like(self._x), np.zeros_like(self.z)
        made: tuple[Any, Callable[[], None]] = rate.buffer()
        self._buffer, self._evaluate = made
        for i, given in enumerate((self._x, self.z, self._t)):
            self._buffer.set_arg(i, given.data)
        for i, result in enumerate((self._moved, self._solved)):
            self._buffer.set_res(i, result.data)

    def __call__(self, t: float, x: np.ndarray) -> np.ndarray:
        self._x[:], self._t[0] = x, t
        self._evaluate()
        self.z[:] = self._solved
        return self._moved.copy()


def explicit_step(found: FreeMotion, longest: float, tableau: Tableau, tolerance: float) -> float:
    """The longest of `longest`, `longest` / 2, ... with which an explicit method follows the motion: it is stable, and accurate."""
    step = _stable(found, longest, tableau.stable)
    x, z = ca.SX.sym("x", len(found.states)), ca.SX.sym("z", len(found.algebraic))
    t, h = ca.SX.sym("t"), ca.SX.sym("h")
    after = runge_kutta(lambda state, time: found.rate(state, z, time)[0], x, t, h, tableau)
    moved = ca.Function("moved", [x, z, t, h], [after])
    return accurate_step(found, moved, step, tableau.order, tolerance)


def accurate_step(found: FreeMotion, moved: Step, longest: float, order: int, tolerance: float) -> float:
    """The longest of `longest`, `longest` / 2, ... with which a step of a method of this order is within `tolerance` of two half ones.

    In units of the motion's `scale`, at every point of it. Where shorter steps over the same time gain less than the order promises
    something jumps there, or the equations end nearby: no step would do.
    """
    every = [ca.DM(value) for value in (found.states, found.algebraic, found.times[None, :])]

    def gap(points: np.ndarray, over: float, count: int, reference: int) -> np.ndarray:
        """By how much `count` steps over the time `over` and `reference` ones end apart."""
        ends = []
        for steps in (count, reference):
            x, z, t = (value[:, points] for value in every)
            for k in range(steps):
                x = moved(x, z, t + k * over / steps, over / steps)
            ends.append(x)
        return np.asarray(np.abs((ends[0] - ends[1]).full() / found.scale[:, None]).max(axis=0))

    step, wanted = longest, longest
    left, before = np.arange(len(found.times)), np.full(len(found.times), np.nan)
    for _ in range(MOST_HALVINGS + 1):
        error = gap(left, step, 1, 2)
        good = error <= tolerance  # false for NaN
        passed = good & np.isfinite(before)
        shorter = np.array([gap(left[passed], 2 * step, *counts) for counts in SHORTER])
        convincing = np.count_nonzero(shorter.max(axis=0) * 2.0 ** (0.75 * order) <= before[passed])
        if convincing > MAJORITY * np.count_nonzero(passed):
            wanted = step
        left, before = left[~good], error[~good]
        if not left.size:
            break
        step /= 2
    return wanted


_FIELDS = ("start", "nominal", "min", "max")


@dataclass(frozen=True)
class _Functions:
    """`rate` and `jacobian` of a FreeMotion; `followed` (x, z, t) -> (z, lost), z on its branch."""

    rate: ca.Function
    jacobian: ca.Function
    followed: ca.Function

    def goes_on(
        self, x: np.ndarray, z: np.ndarray, t: float, before: list[tuple[float, np.ndarray, np.ndarray]]
    ) -> bool:
        """Whether the algebraic equations have a solution at x, z, on the branch of the point `before`."""
        return not z.size or (
            bool(np.all(np.isfinite(z))) and not self.followed(x, before[-1][2] if before else z, t)[1]
        )


def _functions(model: Model) -> _Functions:
    eq = model.equations
    groups = (model.inputs, model.unknown_disturbances, model.parameters, model.unknown_parameters)
    start = ca.SX(ca.DM([v.start for group in groups for v in group]))
    given = ca.vertcat(eq.u, eq.w, eq.p, eq.theta)
    ode, algebraic = ca.substitute([eq.ode, eq.algebraic], [given], [start])
    held = replace(eq, ode=ode, algebraic=algebraic)
    z = ca.SX.sym("z", len(model.algebraic))
    others = [eq.u, eq.p, eq.theta, eq.t]
    moved = motion(held)(eq.x, *others, z)
    found, lost = followed(held, [v.nominal for v in model.algebraic])(eq.x, z, *others)
    symbols = [eq.x, z, eq.t]
    return _Functions(
        ca.Function("rate", symbols, [ca.densify(value) for value in moved]),
        ca.Function("jacobian", symbols, [ca.densify(ca.jacobian(moved[0], eq.x))]),
        ca.Function("followed", symbols, [found, lost]),
    )


def _stable(found: FreeMotion, longest: float, stable: float) -> float:
    """The longest of `longest`, `longest` / 2, ... with which the motion is nowhere for DWELL of them where the method is unstable."""
    n, count = found.states.shape
    A = (
        found.jacobian(found.states, found.algebraic, found.times[None, :])
        .full()
        .reshape(n, count, n)
        .transpose(1, 0, 2)
    )
    finite = np.all(np.isfinite(A), axis=(1, 2))
    rates = np.zeros(count)
    rates[finite] = np.abs(np.linalg.eigvals(A[finite])).max(axis=1, initial=0.0)
    between = np.minimum(rates[1:], rates[:-1])
    lasting = np.diff(found.times)
    step = longest
    for _ in range(MOST_HALVINGS):
        if lasting[between * step > stable].sum() <= DWELL * step:
            break
        step /= 2
    return step
