"""The unscented Kalman filter between samples and at a sample, in square-root form: see `observer`."""

from __future__ import annotations

from typing import Any

import casadi as ca

from observers import innovation_covariance, ports
from observers.bounds import conditioned, projected
from observers.numerics import linear
from observers.numerics.finite import HUGE, kept
from observers.numerics.operations import PARTIAL, holds
from observers.numerics.runge_kutta import Tableau, runge_kutta
from observers.status import CODE
from observers.status import shown as verdict_shown
from observers.ukf import loops
from observers.ukf.parts import Parts, off_mean
from observers.vigilance import status_of, verdict

NOTHING = 1e-13  # of an output's deviation: what rounding leaves of one that the others determine
ROUNDING = 1e-14  # of an output: the same of one far from 0
NEARER = (1 / 8, 1 / 64)  # of the way from the mean to a sigma point


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
    cut = [projected(v.model.states, eq.x), projected(v.model.unknown_parameters, eq.theta)]
    rhs = ca.Function("rhs", [eq.x, eq.theta, eq.u, eq.p, eq.t], [ca.vertcat(eq.ode, still)])
    rhs = ca.Function("within", [eq.x, eq.theta, eq.u, eq.p, eq.t], [rhs(*cut, eq.u, eq.p, eq.t)])
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
    mean, root = v.mean, _root(off_mean(v.points, weights), weights, noise=q.noise * ca.sqrt(q.sample_time))
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
    together = ca.mtimes([off, ca.diag(weights), off.T]) if v.looped else None

    def between(i: int, j: int) -> Any:
        return ca.dot(off[i, :] * off[j, :], weights.T) if together is None else together[i, j]

    after = v.state.pack(
        {
            "points": ca.vec(points),
            "elapsed": ca.DM(0),
            "filtered": estimate,
            "before": ca.if_else(lost, q.guess, mean),
            "undoable": ca.DM(1),
            "innovation": kept(innovation, 0),
            "covariance": innovation_covariance.spread(variances, between),
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
    if isinstance(Sy, ca.MX):
        return loops.solved(Sy, Pxy), Sy, ca.sumsqr(loops.halved(Sy, innovation))
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
