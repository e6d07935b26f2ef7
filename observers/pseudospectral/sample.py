"""Step 1 of the main algorithm of Gong, Ross & Kang 2007, section 3.1: collect the new measurement."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from observers import ports
from observers.numerics.finite import finite
from observers.pseudospectral import innovation_test
from observers.pseudospectral.innovation_test import Tested
from observers.pseudospectral.method import Method
from observers.pseudospectral.window.problem import LeastSquares, known_terms
from observers.pseudospectral.window.sliding import insert_input, insert_sample


@dataclass(frozen=True)
class Instant:
    """A sample instant t_k: what the last one left (`s`, a `memory.layout`), the parameters `q`, what is measured now, known now, and when.

    `u` the component's inputs, of which `measured` (ny) come first, and whether each has arrived, `offered` (ny); `known` (nu) the model's
    inputs, lifted; `t` [s].
    """

    s: SimpleNamespace
    q: SimpleNamespace
    u: Any
    offered: Any
    known: Any
    t: Any

    @property
    def measured(self) -> Any:
        return self.u[: self.offered.numel()]

    @property
    def inputs(self) -> Any:
        """The model's known inputs, as they are given."""
        return inputs_of(self.u, self.offered.numel())


@dataclass(frozen=True)
class Window:
    """The window [t_k - L Ts, t_k] with the new sample at its `place`; a window that is not full yet is not `moving`.

    `readable`, `valid` (ny): what of the new sample is a number, and what counts; `y` (ny) that, else 0; `innovation` (ny) against the
    prediction. `Y`, `W` (ny (L + 1)) the window's samples and their weights in the fit, `weight` those that they keep; `U` its inputs as
    `Segment` wants them, `seen` those at the samples where the outputs see them, `at_points` those at the measured points; `data` the
    problem's known terms, `start` its time [s]; `active` (segments), which of them have a sample; `noise_std` (segments n_noise) what
    their process noise is in units of; `tested`, whether the new sample fits the prediction.
    """

    readable: Any
    valid: Any
    y: Any
    innovation: Any
    moving: Any
    place: Any
    Y: Any
    W: Any
    weight: Any
    U: Any
    seen: Any
    at_points: Any
    data: Any
    start: Any
    active: Any
    noise_std: Any
    tested: Tested

    def driven(self, problem: LeastSquares, noise: Any) -> Any:
        """What drives a trajectory with this process noise."""
        return problem.driven(self.U, self.noise_std * noise) if problem.n_noise else self.U


def inputs_of(u: Any, ny: int) -> Any:
    """The known inputs among u = [measurements (ny), known inputs, whether each measurement is valid (ny)]."""
    n = u.numel() - 2 * ny
    return u[ny : ny + n] if n else ca.MX(0, 1)


def collect(method: Method, now: Instant) -> Window:
    """Step 1: the new sample in its place in the window. A measurement that is rejected weighs nothing and never enters."""
    s, problem, L = now.s, method.problem, method.samples
    readable = finite(now.measured)
    valid = ca.logic_and(readable, now.offered)
    place = ca.fmin(s.k, L)
    expected = method.measure(s.x, now.known, now.q.model, s.theta, now.t, s.z)[0]
    gap = ports.wrapped(method.model, now.measured - expected)  # not finite where either is not
    tested = innovation_test.tested(method, now, now.known, gap, ca.logic_and(valid, finite(expected)))
    # An angle goes to the turn that is nearest to the prediction.
    near = [expected[i] + gap[i] if v.wrap else now.measured[i] for i, v in enumerate(method.model.outputs)]
    y = ca.if_else(valid, ca.vertcat(*near), 0)
    new = valid * tested.weight
    Y, W = (insert_sample(problem.ny, L + 1)(column, new, s.k) for column, new in ((s.y, y), (s.weight, new)))
    W = ca.if_else(tested.inconsistent, W > 0, W)
    start = now.t - place * problem.segment.sample_time
    U, seen, at_points = _inputs(method, now)
    return Window(
        readable=readable,
        valid=valid,
        y=y,
        innovation=ca.if_else(ca.logic_and(now.offered, finite(gap)), gap, 0),
        moving=s.k > L,
        place=place,
        Y=Y,
        W=_recent(method, now, place, W),
        weight=W,
        U=U,
        seen=seen,
        at_points=at_points,
        data=known_terms(problem)(start, U, at_points, now.q.model),
        start=start,
        active=_active(method, place),
        noise_std=_noise_std(method, now, place),
        tested=tested,
    )


def _recent(method: Method, now: Instant, place: Any, W: Any) -> Any:
    """The weights W of the samples, but 0 for those older than `tuning.window_length`."""
    length = now.q.window_length
    if not length.numel():
        return W
    age = place - ca.DM(np.repeat(np.arange(method.samples + 1), method.problem.ny))
    return W * (age <= length)


def _active(method: Method, place: Any) -> Any:
    problem = method.problem
    if problem.count == 1:
        return ca.MX(1)
    return ca.vertcat(1, place > ca.DM(range(1, problem.count)) * problem.segment.samples)


def _noise_std(method: Method, now: Instant, place: Any) -> Any:
    """Standard deviations of the segments' noise: q / sqrt(length) of a rate that is held, q sqrt(length) of a jump; the length of the
    segment that holds the newest sample is up to that."""
    problem = method.problem
    if not problem.n_noise:
        return ca.MX(0, 1)
    m, nx = problem.segment.samples, problem.nx
    q = now.q.process_noise
    rates = ca.vertcat(*[q[i] for i in problem.noisy_states])
    jumps = ca.vertcat(*[q[nx + i] for i in problem.noisy_parameters])
    each = []
    for j in range(problem.count):
        root = ca.sqrt(ca.fmax(ca.fmin(place - j * m, m), 1) * problem.segment.sample_time)
        each += [
            rates / root if problem.noisy_states else ca.MX(0, 1),
            jumps * root if problem.noisy_parameters else ca.MX(0, 1),
        ]
    return ca.vertcat(*each)


def _inputs(method: Method, now: Instant) -> tuple[Any, Any, Any]:
    """`U`, `seen` and `at_points` of the window, which the inputs since the last sample now are known for."""
    s, L, nu, segment = now.s, method.samples, method.problem.nu, method.problem.segment
    held = segment.input_kind == "held"
    last = s.input_integral / segment.sample_time if held else now.known
    U = insert_input(nu, L, held)(s.u, last, now.known, s.k)
    seen = insert_input(nu, L, False)(s.seen, now.known, now.known, s.k) if method.sees_inputs else ca.MX(0, 1)
    if method.spline:
        through = np.kron(segment.inputs_at(method.problem.points), np.eye(nu))
        return U, seen, ca.MX(ca.DM(through)) @ U if nu else ca.MX(0, 1)
    return U, seen, seen if method.sees_inputs else ca.MX(ca.DM.zeros(nu * (L + 1)))
