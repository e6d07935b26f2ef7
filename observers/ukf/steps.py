"""The motion of the unscented Kalman filter: its start, its points between samples, a sample, and what it shows.

All take `v`, the symbols of one component, see `symbols`.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers import ports
from observers.component import Enumeration
from observers.model import Model
from observers.numerics import linear
from observers.numerics.finite import HUGE
from observers.numerics.layout import Layout
from observers.numerics.runge_kutta import runge_kutta

STATUS = Enumeration(
    "UkfStatus",
    (
        ("propagated_guess", "no sample yet: the estimate is the propagated guess"),
        ("corrected", "the last sample corrected the estimate"),
        (
            "sample_rejected",
            "a measurement was missing or not finite: the estimate is the prediction, or rests on the other outputs",
        ),
        ("solver_failed", "a step was not finite: the estimate is the guess again, its covariance the initial one"),
    ),
)
CODE = SimpleNamespace(**{item: i for i, (item, _) in enumerate(STATUS.items, start=1)})


def symbols(model: Model) -> SimpleNamespace:
    """z, u, p, t, h; `state` (the layout of z), `s` and `q` (the parts of z and p); `read` (the parts of u).

    `rate`(x, t) (n) and `measure`(x, t) (ny): the model at a point x = (states, unknown parameters). `weights` (2 n + 1); `fresh`: points
    of the guess.
    """
    eq, ny, nx = model.equations, len(model.outputs), len(model.states)
    n = nx + len(model.unknown_parameters)
    state = Layout(points=n * (2 * n + 1), filtered=n, innovation=ny, status=1, rejected=1, failures=1)
    settings = Layout(guess=n, model=len(model.parameters), noise=n, sensor=ny, spread=n, kappa=1, sample_time=1)
    z, u, p = ca.SX.sym("z", state.total), ca.SX.sym("u", ports.n_inputs(model)), ca.SX.sym("p", settings.total)
    t, h = ca.SX.sym("t"), ca.SX.sym("h")
    q, read, parts = settings.unpack(p), ports.read(model, u), Layout(x=nx, theta=n - nx)

    def at(expression: ca.SX) -> Any:
        function = ca.Function("at", [eq.x, eq.theta, eq.u, eq.p, eq.t], [expression])

        def value(point: Any, time: Any) -> Any:
            part = parts.unpack(point)
            return function(part.x, part.theta, read.known, q.model, time)

        return value

    return SimpleNamespace(
        z=z,
        u=u,
        p=p,
        t=t,
        h=h,
        state=state,
        s=state.unpack(z),
        q=q,
        read=read,
        rate=at(ca.vertcat(eq.ode, ca.SX.zeros(n - nx))),
        measure=at(eq.output),
        weights=ca.vertcat(q.kappa / (n + q.kappa), ca.repmat(1 / (2 * (n + q.kappa)), 2 * n, 1)),
        fresh=_points(q.guess, ca.diag(q.spread), q.kappa),
    )


def start(v: SimpleNamespace) -> Any:
    """The points of the guess."""
    return v.state.pack(
        {
            "points": ca.vec(v.fresh),
            "filtered": v.q.guess,
            "innovation": ca.DM.zeros(v.s.innovation.numel()),
            "status": ca.DM(CODE.propagated_guess),
            "rejected": ca.DM(0),
            "failures": ca.DM(0),
        }
    )


def flow(v: SimpleNamespace) -> Any:
    """Between samples the points follow the model; where one escapes, all start again from the guess."""
    now = _now(v)
    moved = ca.horzcat(*[runge_kutta(v.rate, point, v.t, v.h) for point in ca.horzsplit(now)])
    sound = ca.sumsqr(moved) < HUGE
    return v.state.replace(
        v.z,
        points=ca.vec(ca.if_else(sound, moved, v.fresh)),
        status=ca.if_else(sound, v.s.status, CODE.solver_failed),
        failures=v.s.failures + ca.logic_not(sound),
    )


def jump(v: SimpleNamespace) -> Any:
    """At a sample: the points become mean and square root, process noise is added, and new points see the measurement."""
    s, q = v.s, v.q
    mean, root = _moments(_now(v), v.weights, ca.diag(q.noise * ca.sqrt(q.sample_time)))
    drawn = _points(mean, root, q.kappa)
    seen = ca.horzcat(*[v.measure(point, v.t) for point in ca.horzsplit(drawn)])
    expected = ca.mtimes(seen, v.weights)
    valid, rejected = ports.judged(v.read.y, v.read.offered)
    innovation = ca.if_else(valid, v.read.y - expected, 0)
    corrected, root_after = _correction(v, mean, drawn, seen, expected, valid, innovation)
    redrawn = _points(corrected, root_after, q.kappa)
    finite = ca.sumsqr(redrawn) < HUGE
    incomplete = ca.sum1(valid) < valid.numel()
    return v.state.pack(
        {
            "points": ca.vec(ca.if_else(finite, redrawn, v.fresh)),
            "filtered": ca.if_else(finite, corrected, q.guess),
            "innovation": innovation,
            "status": ca.if_else(
                ca.logic_not(finite),
                CODE.solver_failed,
                ca.if_else(incomplete, CODE.sample_rejected, CODE.corrected),
            ),
            "rejected": s.rejected + rejected,
            "failures": s.failures + ca.logic_not(finite),
        }
    )


def shown(v: SimpleNamespace) -> Any:
    """The outputs: mean now and at the last sample, status, innovation, standard deviations now, counters."""
    s, now = v.s, _now(v)
    current = ca.mtimes(now, v.weights)
    deviation = ca.sqrt(ca.mtimes((now - ca.repmat(current, 1, now.shape[1])) ** 2, v.weights))
    return ca.vertcat(current, s.filtered, s.status, s.innovation, deviation, s.rejected, s.failures)


def _correction(
    v: SimpleNamespace, mean: Any, drawn: Any, seen: Any, expected: Any, valid: Any, innovation: Any
) -> tuple[Any, Any]:
    """(mean (n), root (n x n)) after K = Pxy (Pyy + R)^-1, from the points `drawn` and what they see; outputs not `valid` have no part."""
    points, rooted = drawn.shape[1], ca.diag(ca.sqrt(v.weights))
    dx, dy = drawn - ca.repmat(mean, 1, points), ca.diag(ca.SX(valid)) @ (seen - ca.repmat(expected, 1, points))
    noise_root = ca.diag(ca.if_else(valid, v.q.sensor, 1))
    Sy = linear.square_root(ca.horzcat(ca.mtimes(dy, rooted), noise_root))
    Pxy = ca.mtimes([dx, ca.diag(v.weights), dy.T])
    half = linear.right_solve(Sy.T, Pxy)  # Pxy = K Sy Sy': upper triangle Sy' first, then Sy by the transposed problem
    K = linear.left_transposed(Sy, half)
    root = linear.square_root(
        ca.horzcat(ca.mtimes(dx - ca.mtimes(K, dy), rooted), ca.mtimes([K, ca.diag(ca.SX(valid)), noise_root]))
    )
    return mean + ca.mtimes(K, innovation), root


def _now(v: SimpleNamespace) -> Any:
    """The points (n x (2 n + 1))."""
    return ca.reshape(v.s.points, v.s.filtered.numel(), v.weights.numel())


def _points(mean: Any, root: Any, kappa: Any) -> Any:
    """The sigma points (n x (2 n + 1)) of mean (n) and root (n x n), P = root root'."""
    n = root.shape[0]
    wide = ca.sqrt(n + kappa) * root
    center = ca.repmat(mean, 1, n)
    return ca.horzcat(mean, center + wide, center - wide)


def _moments(points: Any, weights: Any, noise_root: Any) -> tuple[Any, Any]:
    """Mean (n) of the points and the square root (n x n) of their covariance plus noise_root noise_root'."""
    mean = ca.mtimes(points, weights)
    spread = ca.mtimes(points - ca.repmat(mean, 1, points.shape[1]), ca.diag(ca.sqrt(weights)))
    return mean, linear.square_root(ca.horzcat(spread, noise_root))
