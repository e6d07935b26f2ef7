"""The unscented Kalman filter between samples and at a sample, in square-root form: see `observer`."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers import innovation_covariance, ports
from observers.bounds import conditioned, projected
from observers.model import Model, Variable
from observers.numerics import linear
from observers.numerics.finite import HUGE, kept
from observers.numerics.layout import Layout
from observers.numerics.operations import PARTIAL, holds
from observers.numerics.runge_kutta import runge_kutta
from observers.status import CODE
from observers.status import shown as verdict_shown
from observers.vigilance import SETTINGS, Watch, status_of, verdict

NOTHING = 1e-13  # of an output's deviation: what rounding leaves of one that the others determine
ROUNDING = 1e-14  # of an output: the same of one far from 0
NEARER = (1 / 8, 1 / 64)  # of the way from the mean to a sigma point


@dataclass(frozen=True)
class Parts:
    """The filter's structure, and its symbols: state z, inputs u, parameters p, time t, step h; `s`, `q`, `read` are z, p, u by name."""

    model: Model
    watch: Watch
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
    def variables(self) -> tuple[Variable, ...]:
        """What is estimated: states and unknown parameters."""
        return (*self.model.states, *self.model.unknown_parameters)

    @property
    def n(self) -> int:
        return len(self.variables)

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

    def around(self, mean: Any, watch: Any) -> Any:
        """The points of a mean that is as uncertain as the guess; `watch`, what the watch keeps."""
        return self.drawn(mean, ca.diag(ca.sqrt(self.watch.again(watch)) * self.q.spread))

    def drawn(self, mean: Any, root: Any) -> Any:
        """The sigma points (n x n_points) of mean (n) and root (n x n), P = root root', within the bounds."""
        wide = ca.sqrt(self.n + self.q.kappa) * root
        center = ca.repmat(mean, 1, self.n)
        return projected(self.variables, ca.horzcat(mean, center + wide, center - wide))

    @property
    def mean(self) -> Any:
        """The estimate now (n): the mean of the points, and while they stand where they were drawn, what they were drawn around.

        Points that were cut to the bounds have another mean.
        """
        return ca.if_else(self.s.elapsed == 0, self.s.filtered, ca.mtimes(self.points, self.weights))

    def deviations(self, s: SimpleNamespace) -> Any:
        """The standard deviations (n) of the estimate in the state `s`, with the process noise since the last sample.

        The points take that in at the next sample only.
        """
        off = _off(ca.reshape(s.points, self.n, self.n_points), self.weights)
        variances = ca.mtimes(off**2, self.weights) + self.q.noise**2 * s.elapsed
        return self.watch.deviations(s.watch, variances)

    def at(self, function: ca.Function, x: Any, time: Any) -> Any:
        """`function` of the model's arguments at the point x."""
        nx = len(self.model.states)
        part = Layout(x=nx, theta=self.n - nx).unpack(x)
        return function(part.x, part.theta, self.read.known, self.q.model, time)


def parts(model: Model, noise_known: bool) -> Parts:
    n, ny = len(model.states) + len(model.unknown_parameters), len(model.outputs)
    watch = Watch(model, n, known=noise_known)
    state = Layout(
        points=n * (2 * n + 1), elapsed=1, filtered=n, before=n, undoable=1, innovation=ny,
        covariance=innovation_covariance.size(ny), watch=watch.state.total, status=1, rejected=1, failures=1, restarts=1,
    )  # fmt: skip
    settings = Layout(
        guess=n, model=len(model.parameters), noise=n, sensor=ny, spread=n, kappa=1, **SETTINGS, sample_time=1,
    )  # fmt: skip
    z, u, p = ca.SX.sym("z", state.total), ca.SX.sym("u", ports.n_inputs(model)), ca.SX.sym("p", settings.total)
    t, h = ca.SX.sym("t"), ca.SX.sym("h")
    return Parts(model, watch, state, z, u, p, t, h, state.unpack(z), settings.unpack(p), ports.read(model, u))


def start(v: Parts) -> ca.Function:
    """start(p, t0) -> z: the points of the guess."""
    first = {
        "points": ca.vec(v.around(v.q.guess, v.watch.start)),
        "elapsed": ca.DM(0),  # since the last sample
        "filtered": v.q.guess,
        "before": v.q.guess,  # the prediction at the last sample, before it acted
        "undoable": ca.DM(0),  # whether to go back to it is worth a try
        "innovation": ca.DM.zeros(len(v.model.outputs)),
        "covariance": ca.DM.zeros(v.state.sizes["covariance"]),
        "watch": v.watch.start,
        "status": ca.DM(CODE.propagated_guess),
        "rejected": ca.DM(0),
        "failures": ca.DM(0),
        "restarts": ca.DM(0),
    }
    return ca.Function("start", [v.p, v.t], [v.state.pack(first)])


def flow(v: Parts) -> ca.Function:
    """flow(z, u, p, t, h) -> z: the points follow the model.

    Where one escapes, the last sample is undone: they start again around the prediction without it; where that escapes too, around
    the guess.
    """
    s, eq, now = v.s, v.model.equations, v.points
    still = ca.SX.zeros(eq.theta.numel())
    within = [projected(v.model.states, eq.x), projected(v.model.unknown_parameters, eq.theta)]
    rhs = ca.Function("rhs", [eq.x, eq.theta, eq.u, eq.p, eq.t], [ca.vertcat(eq.ode, still)])
    rhs = ca.Function("within", [eq.x, eq.theta, eq.u, eq.p, eq.t], [rhs(*within, eq.u, eq.p, eq.t)])
    moved = ca.horzcat(
        *[runge_kutta(lambda x, time: v.at(rhs, x, time), now[:, i], v.t, v.h) for i in range(v.n_points)]
    )
    sound = ca.sumsqr(moved) < HUGE
    back = ca.if_else(s.undoable, s.before, v.q.guess)
    after = v.state.replace(
        v.z,
        points=ca.vec(ca.if_else(sound, projected(v.variables, moved), v.around(back, s.watch))),
        elapsed=s.elapsed + v.h,
        filtered=ca.if_else(sound, s.filtered, back),
        undoable=ca.logic_and(s.undoable, sound),
        status=ca.if_else(sound, s.status, CODE.solver_failed),
        failures=s.failures + ca.logic_not(sound),
    )
    return ca.Function("flow", [v.z, v.u, v.p, v.t, v.h], [after], {"cse": True})


def jump(v: Parts) -> ca.Function:
    """jump(z, u, p, t) -> z: the points become mean and square root, process noise is added, new points see the measurement."""
    s, q, read, weights, n_points = v.s, v.q, v.read, v.weights, v.n_points
    eq = v.model.equations
    measure = ca.Function("measure", [eq.x, eq.theta, eq.u, eq.p, eq.t], [eq.output])
    mean, root = v.mean, _root(v.points, weights, ca.diag(q.noise * ca.sqrt(q.sample_time)))
    drawn = v.drawn(mean, root)
    seen = _seen(v, measure, mean, drawn)
    if any(output.wrap for output in v.model.outputs):  # on the circle, around the prediction
        near = seen[:, 0]
        seen = ca.horzcat(*[near + ports.wrapped(v.model, seen[:, i] - near) for i in range(n_points)])
    expected = ca.mtimes(seen, weights)
    residual = ports.wrapped(v.model, read.y - expected)
    valid, rejected = ports.judged(residual, read.offered)
    innovation = ca.if_else(valid, residual, 0)
    dx = drawn - ca.repmat(mean, 1, n_points)
    off = seen - ca.repmat(expected, 1, n_points)
    variances = ca.mtimes(off**2, weights) + q.sensor**2
    outlying = v.watch.gated(s.watch, innovation, variances, valid, q.gate)
    acting = ca.logic_and(valid, ca.logic_not(outlying))
    dy, heard = ca.diag(ca.SX(acting)) @ off, ca.if_else(acting, innovation, 0)
    noise_root = ca.diag(ca.if_else(acting, q.sensor, 1))
    K, root_after, squared = _gain(dx, dy, weights, noise_root, acting, heard, ROUNDING * ca.fabs(expected))
    said = verdict(v.watch, s.watch, squared, innovation, variances, valid, outlying, q)
    corrected = conditioned(v.variables, mean + ca.mtimes(K, heard), ca.mtimes(root_after, root_after.T))
    redrawn = v.drawn(corrected, root_after)
    # A correction that fails leaves the prediction; after a second one in a row the points start again around the guess.
    finite = ca.sumsqr(ca.vertcat(ca.vec(redrawn), heard)) < HUGE
    lost = ca.logic_or(s.status == CODE.solver_failed, ca.logic_not(ca.sumsqr(drawn) < HUGE))
    lost = ca.logic_or(ca.logic_and(lost, ca.logic_not(finite)), said.restart)
    anew = ca.logic_or(lost, said.inflate)
    estimate = ca.if_else(lost, q.guess, ca.if_else(finite, corrected, mean))
    points = ca.if_else(anew, v.around(estimate, said.memory), ca.if_else(finite, redrawn, drawn))
    after = v.state.pack(
        {
            "points": ca.vec(points),
            "elapsed": ca.DM(0),
            "filtered": estimate,
            "before": ca.if_else(lost, q.guess, mean),
            "undoable": ca.DM(1),
            "innovation": kept(innovation, 0),
            "covariance": innovation_covariance.spread(
                variances, lambda i, j: ca.dot(off[i, :] * off[j, :], weights.T)
            ),
            "watch": said.memory,
            "status": s.status,
            "rejected": s.rejected + rejected,
            "failures": s.failures + ca.logic_not(finite),
            "restarts": s.restarts + ca.logic_or(said.inflate, said.restart),
        }
    )
    status = status_of(said, valid, finite, v.deviations(v.state.unpack(after)), q, v.variables)
    return ca.Function("jump", [v.z, v.u, v.p, v.t], [v.state.replace(after, status=status)], {"cse": True})


def output(v: Parts) -> ca.Function:
    """output(z, u, p, t) -> y: mean and standard deviations now, and what the last sample left."""
    s = v.s
    shown = [
        v.mean,
        s.filtered,
        verdict_shown(s.status),
        s.innovation,
        v.deviations(s),
        s.covariance,
        s.rejected,
        s.failures,
        s.restarts,
    ]
    return ca.Function("output", [v.z, v.u, v.p, v.t], [ca.vertcat(*shown)])


def _seen(v: Parts, measure: ca.Function, mean: Any, drawn: Any) -> Any:
    """What is measured at the sigma points (ny x n_points).

    Where some of them lie outside the domain of the output, as log(x) of a wide first covariance does, the slopes are taken nearer to the
    mean and continued from there.
    """
    seen = ca.horzcat(*[v.at(measure, drawn[:, i], v.t) for i in range(v.n_points)])
    if not holds(v.model.equations.output, PARTIAL):
        return seen
    center = seen[:, 0]
    found = seen
    for nearer in NEARER:
        close = [v.at(measure, mean + nearer * (drawn[:, i] - mean), v.t) for i in range(1, v.n_points)]
        continued = ca.horzcat(center, *[center + (point - center) / nearer for point in close])
        found = ca.if_else(ca.sumsqr(found) < HUGE, found, continued)
    return found


def _gain(
    dx: Any, dy: Any, weights: Any, noise_root: Any, valid: Any, innovation: Any, rounding: Any
) -> tuple[Any, Any, Any]:
    """The gain K (n x ny), the square root (n x n) of the covariance after the sample, and nu' S^-1 nu of the innovation nu (ny).

    An output that the others leave no uncertainty in but `rounding` (ny), such as the second of two perfect sensors, has nothing to add:
    its part of K is 0.
    """
    rooted = ca.diag(ca.sqrt(weights))
    Sy = linear.square_root(ca.horzcat(ca.mtimes(dy, rooted), noise_root))
    for i in range(Sy.shape[0]):
        Sy[i, i] = ca.if_else(
            ca.fabs(Sy[i, i]) <= ca.fmax(NOTHING * ca.norm_2(Sy[i, : i + 1]), rounding[i]), HUGE, Sy[i, i]
        )
    Pxy = ca.mtimes([dx, ca.diag(weights), dy.T])
    half = linear.right_solve(Sy.T, Pxy)  # Pxy = K Sy Sy': upper triangle Sy' first, then Sy by the transposed problem
    K = linear.left_transposed(Sy, half)
    columns = (ca.mtimes(dx - ca.mtimes(K, dy), rooted), ca.mtimes([K, ca.diag(ca.SX(valid)), noise_root]))
    squared = ca.sumsqr(linear.right_solve(Sy.T, innovation.T))
    return K, linear.square_root(ca.horzcat(*columns)), squared


def _root(points: Any, weights: Any, noise_root: Any) -> Any:
    """The square root (n x n) of the covariance of the points plus noise_root noise_root'."""
    spread = ca.mtimes(_off(points, weights), ca.diag(ca.sqrt(weights)))
    return linear.square_root(ca.horzcat(spread, noise_root))


def _off(points: Any, weights: Any) -> Any:
    """The points (n x n_points) less their mean."""
    return points - ca.repmat(ca.mtimes(points, weights), 1, points.shape[1])
