"""The unscented Kalman filter between samples and at a sample, in square-root form: see `observer`.

Up to UNROLLED estimates every function is one expression of scalars. Beyond, it is made of loops over matrices, `loops`: C whose length
does not grow with the third power of n.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers import innovation_covariance, ports
from observers.bounds import bounded, conditioned, projected
from observers.model import Model, Variable
from observers.numerics import linear
from observers.numerics.finite import HUGE, kept
from observers.numerics.layout import Layout
from observers.numerics.operations import PARTIAL, holds
from observers.numerics.runge_kutta import Tableau, runge_kutta
from observers.status import CODE
from observers.status import shown as verdict_shown
from observers.ukf import loops
from observers.vigilance import SETTINGS, Watch, status_of, verdict

NOTHING = 1e-13  # of an output's deviation: what rounding leaves of one that the others determine
ROUNDING = 1e-14  # of an output: the same of one far from 0
NEARER = (1 / 8, 1 / 64)  # of the way from the mean to a sigma point
UNROLLED = 8  # estimates up to which the algebra is one expression of scalars


@dataclass(frozen=True)
class Parts:
    """The filter's structure, and its symbols: state z, inputs u, parameters p, time t, step h; `s`, `q`, `read` are z, p, u by name.

    `looped`: the algebra is made of loops over matrices (MX), not of scalars (SX).
    """

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
    looped: bool

    @property
    def even(self) -> bool:
        """Whether the points that are drawn lie as far from their mean to either side: none is cut to a bound."""
        return self.looped and not bounded(self.variables)

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
        return self.drawn(mean, self.first(watch))

    def first(self, watch: Any) -> Any:
        """The root of the guess's covariance."""
        return ca.diag(ca.sqrt(self.watch.again(watch)) * self.q.spread)

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
        variances = self.variances(ca.reshape(s.points, self.n, self.n_points)) + self.q.noise**2 * s.elapsed
        return self.watch.deviations(s.watch, variances)

    def variances(self, points: Any) -> Any:
        """Those (n) of the points (n x n_points)."""
        return ca.mtimes(_off(points, self.weights) ** 2, self.weights)

    def each(self, body: Callable[..., Any], points: Any, *given: Any) -> Any:
        """body(x, *given) at each of the points (n x N), a column each."""
        if self.looped:
            return loops.each(body, points, *given)
        return ca.horzcat(*[body(points[:, i], *given) for i in range(points.shape[1])])

    def at(self, function: ca.Function) -> Callable[..., Any]:
        """`function` of the model's arguments as one of (x, known inputs, parameters, t), x (n) a point."""
        nx = len(self.model.states)

        def body(x: Any, known: Any, parameters: Any, time: Any) -> Any:
            part = Layout(x=nx, theta=self.n - nx).unpack(x)
            return function(part.x, part.theta, known, parameters, time)

        return body


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
    looped = n > UNROLLED
    sym = ca.MX.sym if looped else ca.SX.sym
    z, u, p = sym("z", state.total), sym("u", ports.n_inputs(model)), sym("p", settings.total)
    t, h = sym("t"), sym("h")
    return Parts(model, watch, state, z, u, p, t, h, state.unpack(z), settings.unpack(p), ports.read(model, u), looped)


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


def flow(v: Parts, tableau: Tableau) -> ca.Function:
    """flow(z, u, p, t, h) -> z: the points follow the model.

    Where one escapes, the last sample is undone: they start again around the prediction without it; where that escapes too, around
    the guess.
    """
    s, eq, now = v.s, v.model.equations, v.points
    still = ca.SX.zeros(eq.theta.numel())
    within = [projected(v.model.states, eq.x), projected(v.model.unknown_parameters, eq.theta)]
    rhs = ca.Function("rhs", [eq.x, eq.theta, eq.u, eq.p, eq.t], [ca.vertcat(eq.ode, still)])
    rhs = ca.Function("within", [eq.x, eq.theta, eq.u, eq.p, eq.t], [rhs(*within, eq.u, eq.p, eq.t)])
    rate = v.at(rhs)

    def step(x: Any, known: Any, parameters: Any, t: Any, h: Any) -> Any:
        return runge_kutta(lambda x, time: rate(x, known, parameters, time), x, t, h, tableau)

    moved = v.each(step, now, v.read.known, v.q.model, v.t, v.h)
    sound = ca.sumsqr(moved) < HUGE
    back = ca.if_else(s.undoable, s.before, v.q.guess)
    within, again = projected(v.variables, moved), v.around(back, s.watch)
    after = v.state.replace(
        v.z,
        points=ca.vec(loops.either(sound, within, again, v.z, v.p) if v.looped else ca.if_else(sound, within, again)),
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
    mean, root = v.mean, _root(_off(v.points, weights), weights, noise=q.noise * ca.sqrt(q.sample_time))
    drawn = v.drawn(mean, root)
    seen = _seen(v, measure, mean, drawn)
    if any(output.wrap for output in v.model.outputs):  # on the circle, around the prediction
        seen = v.each(lambda point, near: near + ports.wrapped(v.model, point - near), seen, seen[:, 0])
    expected = ca.mtimes(seen, weights)
    residual = ports.wrapped(v.model, read.y - expected)
    valid, rejected = ports.judged(residual, read.offered)
    innovation = ca.if_else(valid, residual, 0)
    off = seen - ca.repmat(expected, 1, n_points)
    variances = ca.mtimes(off**2, weights) + q.sensor**2
    outlying = v.watch.gated(s.watch, innovation, variances, valid, q.gate)
    acting = ca.logic_and(valid, ca.logic_not(outlying))
    dy, heard = ca.diag(acting) @ off, ca.if_else(acting, innovation, 0)
    noise = ca.if_else(acting, q.sensor, 1)
    dx = drawn - ca.repmat(mean, 1, n_points)
    Pxy = loops.covariance(root, dy, weights) if v.even else ca.mtimes([dx, ca.diag(weights), dy.T])
    K, Sy, squared = _gain(Pxy, _root(dy, weights, noise=noise), heard, ROUNDING * ca.fabs(expected))
    if v.even:
        root_after = loops.corrected(root, Sy, dy, weights, noise)
    else:
        root_after = _root(dx - ca.mtimes(K, dy), weights, more=ca.mtimes([K, ca.diag(acting), ca.diag(noise)]))
    said = verdict(v.watch, s.watch, squared, innovation, variances, valid, outlying, q)
    corrected = conditioned(v.variables, mean + ca.mtimes(K, heard), ca.mtimes(root_after, root_after.T))
    # A correction that fails leaves the prediction; after a second one in a row the points start again around the guess.
    redrawn = ca.horzcat(corrected, root_after) if v.looped else v.drawn(corrected, root_after)
    finite = ca.sumsqr(ca.vertcat(ca.vec(redrawn), heard)) < HUGE
    failing = ca.horzcat(mean, root) if v.looped else drawn
    lost = ca.logic_or(s.status == CODE.solver_failed, ca.logic_not(ca.sumsqr(failing) < HUGE))
    lost = ca.logic_or(ca.logic_and(lost, ca.logic_not(finite)), said.restart)
    anew = ca.logic_or(lost, said.inflate)
    estimate = ca.if_else(lost, q.guess, ca.if_else(finite, corrected, mean))
    if v.looped:  # drawn once, from the root that is chosen
        left = loops.chosen(
            ca.if_else(anew, 2, ca.logic_not(finite)), root_after, root, ca.densify(v.first(said.memory))
        )
        points = v.drawn(estimate, left)
    else:
        points = ca.if_else(anew, v.around(estimate, said.memory), ca.if_else(finite, redrawn, drawn))
    variances_after = ca.sum2(left**2) if v.even else v.variances(points)
    deviations = v.watch.deviations(said.memory, variances_after)
    status = status_of(said, valid, finite, deviations, q, v.variables)
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
            "status": status,
            "rejected": s.rejected + rejected,
            "failures": s.failures + ca.logic_not(finite),
            "restarts": s.restarts + ca.logic_or(said.inflate, said.restart),
        }
    )
    return ca.Function("jump", [v.z, v.u, v.p, v.t], [after], {"cse": True})


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
    given, output = (v.read.known, v.q.model, v.t), v.at(measure)
    seen = v.each(output, drawn, *given)
    if not holds(v.model.equations.output, PARTIAL):
        return seen
    found = seen
    for nearer in NEARER:

        def continued(x: Any, middle: Any, center: Any, *given: Any, nearer: float = nearer) -> Any:
            return center + (output(middle + nearer * (x - middle), *given) - center) / nearer

        closer = ca.horzcat(seen[:, 0], v.each(continued, drawn[:, 1:], mean, seen[:, 0], *given))
        found = ca.if_else(ca.sumsqr(found) < HUGE, found, closer)
    return found


def _gain(Pxy: Any, Sy: Any, innovation: Any, rounding: Any) -> tuple[Any, Any, Any]:
    """The gain K (n x ny) of Pxy (n x ny) and the root Sy (ny x ny) of S, that root, and nu' S^-1 nu of the innovation nu (ny).

    An output that the others leave no uncertainty in but `rounding` (ny), such as the second of two perfect sensors, has nothing to add:
    its part of K is 0, and Sy has HUGE on its diagonal.
    """
    for i in range(Sy.shape[0]):
        Sy[i, i] = ca.if_else(
            ca.fabs(Sy[i, i]) <= ca.fmax(NOTHING * ca.norm_2(Sy[i, : i + 1]), rounding[i]), HUGE, Sy[i, i]
        )
    half = linear.right_solve(Sy.T, Pxy)  # Pxy = K Sy Sy': upper triangle Sy' first, then Sy by the transposed problem
    K = linear.left_transposed(Sy, half)
    return K, Sy, ca.sumsqr(linear.right_solve(Sy.T, innovation.T))


def _root(off: Any, weights: Any, *, noise: Any = None, more: Any = None) -> Any:
    """The square root (lower triangle) of the covariance of points, `off` their mean, plus diag(noise)^2 or more more'."""
    columns = ca.mtimes(off, ca.diag(ca.sqrt(weights)))
    if more is not None:
        columns = ca.horzcat(columns, more)
    if isinstance(columns, ca.MX):
        return loops.square_root(columns, ca.MX.zeros(columns.shape[0]) if noise is None else noise)
    return linear.square_root(columns if noise is None else ca.horzcat(columns, ca.diag(noise)))


def _off(points: Any, weights: Any) -> Any:
    """The points (n x n_points) less their mean."""
    return points - ca.repmat(ca.mtimes(points, weights), 1, points.shape[1])
