"""The unscented Kalman filter between samples and at a sample, in square-root form: see `observer`."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers import ports
from observers.model import Model
from observers.numerics import linear
from observers.numerics.finite import HUGE, kept
from observers.numerics.layout import Layout
from observers.numerics.runge_kutta import runge_kutta
from observers.status import CODE, worst
from observers.status import shown as verdict

NOTHING = 1e-13  # of an output's deviation: what rounding leaves of one that the others determine


@dataclass(frozen=True)
class Parts:
    """The filter's structure, and its symbols: state z, inputs u, parameters p, time t, step h; `s`, `q`, `read` are z, p, u by name."""

    model: Model
    state: Layout
    z: Any
    u: Any
    p: Any
    t: Any
    h: Any
    s: SimpleNamespace
    q: SimpleNamespace
    read: ports.Inputs

    @property
    def n(self) -> int:
        """Estimated states and unknown parameters."""
        return len(self.model.states) + len(self.model.unknown_parameters)

    @property
    def n_points(self) -> int:
        return 2 * self.n + 1

    @property
    def points(self) -> Any:
        """The sigma points now, (n x n_points)."""
        return ca.reshape(self.s.points, self.n, self.n_points)

    @property
    def weights(self) -> Any:
        n, kappa = self.n, self.q.kappa
        return ca.vertcat(kappa / (n + kappa), ca.repmat(1 / (2 * (n + kappa)), 2 * n, 1))

    def around(self, mean: Any) -> Any:
        """The points of a mean that is as uncertain as the guess."""
        return _points(mean, ca.diag(self.q.spread), self.q.kappa)

    def at(self, function: ca.Function, x: Any, time: Any) -> Any:
        """`function` of the model's arguments at the point x."""
        nx = len(self.model.states)
        part = Layout(x=nx, theta=self.n - nx).unpack(x)
        return function(part.x, part.theta, self.read.known, self.q.model, time)


def parts(model: Model) -> Parts:
    n, ny = len(model.states) + len(model.unknown_parameters), len(model.outputs)
    state = Layout(
        points=n * (2 * n + 1), filtered=n, before=n, undoable=1, innovation=ny, status=1, rejected=1, failures=1
    )
    settings = Layout(guess=n, model=len(model.parameters), noise=n, sensor=ny, spread=n, kappa=1, sample_time=1)
    z, u, p = ca.SX.sym("z", state.total), ca.SX.sym("u", ports.n_inputs(model)), ca.SX.sym("p", settings.total)
    t, h = ca.SX.sym("t"), ca.SX.sym("h")
    return Parts(model, state, z, u, p, t, h, state.unpack(z), settings.unpack(p), ports.read(model, u))


def start(v: Parts) -> ca.Function:
    """start(p, t0) -> z: the points of the guess."""
    first = {
        "points": ca.vec(v.around(v.q.guess)),
        "filtered": v.q.guess,
        "before": v.q.guess,  # the prediction at the last sample, before it acted
        "undoable": ca.DM(0),  # whether to go back to it is worth a try
        "innovation": ca.DM.zeros(len(v.model.outputs)),
        "status": ca.DM(CODE.propagated_guess),
        "rejected": ca.DM(0),
        "failures": ca.DM(0),
    }
    return ca.Function("start", [v.p, v.t], [v.state.pack(first)])


def flow(v: Parts) -> ca.Function:
    """flow(z, u, p, t, h) -> z: the points follow the model.

    Where one escapes, the last sample is undone: they start again around the prediction without it; where that escapes too, around
    the guess.
    """
    s, eq, now = v.s, v.model.equations, v.points
    still = ca.SX.zeros(eq.theta.numel())
    rhs = ca.Function("rhs", [eq.x, eq.theta, eq.u, eq.p, eq.t], [ca.vertcat(eq.ode, still)])
    moved = ca.horzcat(
        *[runge_kutta(lambda x, time: v.at(rhs, x, time), now[:, i], v.t, v.h) for i in range(v.n_points)]
    )
    sound = ca.sumsqr(moved) < HUGE
    back = ca.if_else(s.undoable, s.before, v.q.guess)
    after = v.state.replace(
        v.z,
        points=ca.vec(ca.if_else(sound, moved, v.around(back))),
        filtered=ca.if_else(sound, s.filtered, back),
        undoable=ca.logic_and(s.undoable, sound),
        status=ca.if_else(sound, s.status, CODE.solver_failed),
        failures=s.failures + ca.logic_not(sound),
    )
    return ca.Function("flow", [v.z, v.u, v.p, v.t, v.h], [after], {"cse": True})


def jump(v: Parts) -> ca.Function:
    """jump(z, u, p, t) -> z: the points become mean and square root, process noise is added, new points see the measurement."""
    s, q, read, weights, n_points = v.s, v.q, v.read, v.weights, v.n_points
    eq, ny = v.model.equations, len(v.model.outputs)
    measure = ca.Function("measure", [eq.x, eq.theta, eq.u, eq.p, eq.t], [eq.output])
    mean, root = _moments(v.points, weights, ca.diag(q.noise * ca.sqrt(q.sample_time)))
    drawn = _points(mean, root, q.kappa)
    seen = ca.horzcat(*[v.at(measure, drawn[:, i], v.t) for i in range(n_points)])
    expected = ca.mtimes(seen, weights)
    valid, rejected = ports.judged(read.y, read.offered)
    innovation = ca.if_else(valid, read.y - expected, 0)
    dx = drawn - ca.repmat(mean, 1, n_points)
    dy = ca.diag(ca.SX(valid)) @ (seen - ca.repmat(expected, 1, n_points))
    K, root_after = _gain(dx, dy, weights, ca.diag(ca.if_else(valid, q.sensor, 1)), valid)
    corrected = mean + ca.mtimes(K, innovation)
    redrawn = _points(corrected, root_after, q.kappa)
    # A correction that fails leaves the prediction; after a second one in a row the points start again around the guess.
    finite = ca.sumsqr(ca.vertcat(ca.vec(redrawn), innovation)) < HUGE
    again = ca.logic_or(s.status == CODE.solver_failed, ca.logic_not(ca.sumsqr(drawn) < HUGE))
    left = ca.if_else(again, v.around(q.guess), drawn)
    status = worst((ca.sum1(valid) < ny, CODE.sample_rejected), (ca.logic_not(finite), CODE.solver_failed))
    after = v.state.pack(
        {
            "points": ca.vec(ca.if_else(finite, redrawn, left)),
            "filtered": ca.if_else(finite, corrected, left[:, 0]),
            "before": ca.if_else(again, q.guess, mean),
            "undoable": ca.DM(1),
            "innovation": kept(innovation, 0),
            "status": status,
            "rejected": s.rejected + rejected,
            "failures": s.failures + ca.logic_not(finite),
        }
    )
    return ca.Function("jump", [v.z, v.u, v.p, v.t], [after], {"cse": True})


def output(v: Parts) -> ca.Function:
    """output(z, u, p, t) -> y: mean and standard deviations now, and what the last sample left."""
    s, now, weights = v.s, v.points, v.weights
    current = ca.mtimes(now, weights)
    deviation = ca.sqrt(ca.mtimes((now - ca.repmat(current, 1, v.n_points)) ** 2, weights))
    shown = [current, s.filtered, verdict(s.status), s.innovation, deviation, s.rejected, s.failures]
    return ca.Function("output", [v.z, v.u, v.p, v.t], [ca.vertcat(*shown)])


def _gain(dx: Any, dy: Any, weights: Any, noise_root: Any, valid: Any) -> tuple[Any, Any]:
    """The gain K (n x ny), and the square root (n x n) of the covariance after the sample.

    An output that the others leave no uncertainty in, such as the second of two perfect sensors, has nothing to add: its part of K is 0.
    """
    rooted = ca.diag(ca.sqrt(weights))
    Sy = linear.square_root(ca.horzcat(ca.mtimes(dy, rooted), noise_root))
    for i in range(Sy.shape[0]):
        Sy[i, i] = ca.if_else(ca.fabs(Sy[i, i]) <= NOTHING * ca.norm_2(Sy[i, : i + 1]), HUGE, Sy[i, i])
    Pxy = ca.mtimes([dx, ca.diag(weights), dy.T])
    half = linear.right_solve(Sy.T, Pxy)  # Pxy = K Sy Sy': upper triangle Sy' first, then Sy by the transposed problem
    K = linear.left_transposed(Sy, half)
    columns = (ca.mtimes(dx - ca.mtimes(K, dy), rooted), ca.mtimes([K, ca.diag(ca.SX(valid)), noise_root]))
    return K, linear.square_root(ca.horzcat(*columns))


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
