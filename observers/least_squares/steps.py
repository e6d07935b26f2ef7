"""The least-squares observer between samples and at a sample: Chen & Yen 1999, (8) and (11) to (15), in information form."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers import innovation_covariance, ports
from observers.least_squares.information import error_covariance, information_update
from observers.least_squares.weights import Weights
from observers.linearisation import Linearisation
from observers.model import Model
from observers.numerics import linear
from observers.numerics.finite import HUGE
from observers.numerics.layout import Layout
from observers.numerics.riccati import UNROLLED
from observers.numerics.runge_kutta import runge_kutta
from observers.status import CODE
from observers.vigilance import SETTINGS, Watch, status_of, verdict


@dataclass(frozen=True)
class Parts:
    """The observer's structure, and its symbols: state z, inputs u, parameters p, time t, step h; `s`, `q`, `read` are z, p, u by name."""

    model: Model
    line: Linearisation
    weights: Weights
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
    def n(self) -> int:
        return len(self.line.variables)

    @property
    def one(self) -> Any:
        """The identity (n^2): the transition matrix at an interval's start."""
        return ca.vec(ca.DM.eye(self.n).full())

    @property
    def reset(self) -> Any:
        """The information at an interval's start (n^2)."""
        return self.weights.information(self.q.prior, self.n)

    @property
    def guess_covariance(self) -> Any:
        """The covariance of the guess (n^2)."""
        return self.weights.covariance(self.q.prior, self.n)

    def deviations(self, s: SimpleNamespace) -> Any:
        """The standard deviations (n) of the estimate in the state `s`."""
        Phi, S = (ca.reshape(part, self.n, self.n) for part in (s.Phi, s.S))
        return self.watch.deviations(s.watch, ca.diag(Phi @ S @ Phi.T))


def parts(model: Model, line: Linearisation, weights: Weights) -> Parts:
    n, ny = len(line.variables), len(model.outputs)
    watch = Watch(model, n, known=weights.noise_known, weighted=not weights.by_noise)
    state = Layout(
        x=n, Phi=n * n, Y=n * n, S=n * n, x_filtered=n, before=n, undoable=1, samples=1, innovation=ny,
        covariance=innovation_covariance.size(ny), watch=watch.state.total, status=1, contraction=1, certified=1, intervals=1, rejected=1,
        failures=1, restarts=1,
    )  # fmt: skip
    tuned = {"samples": len(weights.samples), "prior": len(weights.prior)}
    settings = Layout(guess=n, model=len(model.parameters), T=1, **tuned, **SETTINGS, sample_time=1)
    z, u, p, t, h = (
        ca.MX.sym(*shape)
        for shape in (("z", state.total), ("u", ports.n_inputs(model)), ("p", settings.total), ("t",), ("h",))
    )
    return Parts(
        model, line, weights, watch, state, z, u, p, t, h, state.unpack(z), settings.unpack(p), ports.read(model, u)
    )


def start(v: Parts) -> ca.Function:
    """start(p, t0) -> z: the guess, at the start of an interval."""
    first = (
        {part: ca.DM.zeros(size) for part, size in v.state.sizes.items()}
        | {
            "x": v.q.guess,
            "Phi": v.one,
            "Y": v.reset,
            "S": v.guess_covariance,
            "x_filtered": v.q.guess,
            "before": v.q.guess,  # the prediction at the last sample, before it acted; `undoable`, whether to go back to it is worth a try
            "watch": v.watch.start,
            "status": ca.DM(CODE.propagated_guess),
        }
    )
    return ca.Function("start", [v.p, v.t], [v.state.pack(first)])


def flow(v: Parts) -> ca.Function:
    """flow(z, u, p, t, h) -> z: (8) without correction, and (11), over h.

    Where x escapes, the last sample is undone; a prediction that escapes by itself starts again from the guess.
    """
    s, n, line = v.s, v.n, v.line
    rate = ca.Function(
        "moving",
        [moving := ca.SX.sym("moving", n + n * n), line.u, line.p, line.t],
        [
            ca.vertcat(
                line.rate(moving[:n], line.u, line.p, line.t),
                ca.vec(line.jacobian(moving[:n], line.u, line.p, line.t) @ ca.reshape(moving[n:], n, n)),
            )
        ],
    )
    moved = runge_kutta(lambda x, time: rate(x, v.read.known, v.q.model, time), ca.vertcat(s.x, s.Phi), v.t, v.h)
    whole, finite = ca.sumsqr(moved[:n]) < HUGE, ca.sumsqr(moved) < HUGE
    back = ca.if_else(s.undoable, s.before, v.q.guess)
    after = v.state.replace(
        v.z,
        x=ca.if_else(whole, moved[:n], back),
        x_filtered=ca.if_else(whole, s.x_filtered, back),
        undoable=ca.logic_and(s.undoable, whole),
        Phi=ca.if_else(finite, moved[n:], v.one),
        Y=ca.if_else(finite, s.Y, v.reset / v.watch.again(s.watch)),
        S=ca.if_else(finite, s.S, v.guess_covariance * v.watch.again(s.watch)),
        samples=ca.if_else(finite, s.samples, 0),
        status=ca.if_else(finite, s.status, CODE.solver_failed),
        failures=s.failures + ca.logic_not(finite),
    )
    return ca.Function("flow", [v.z, v.u, v.p, v.t, v.h], [after])


def jump(v: Parts) -> ca.Function:
    """jump(z, u, p, t) -> z: the sample, as the last one of an interval that ends here, then, after the reset, as the first of the next."""
    s, q, read, line = v.s, v.q, v.read, v.line
    n, ny = v.n, read.y.numel()
    ended = s.samples >= ca.fmax(ca.floor(q.T / q.sample_time + 0.5), 1)
    expected = line.measure(s.x, read.known, q.model, v.t)
    residual = ports.wrapped(v.model, read.y - expected)
    valid, rejected = ports.judged(residual, read.offered)
    innovation = ca.if_else(valid, residual, 0)
    g, sigma = v.weights.of_sample(q.samples, q.sample_time)
    noise = sigma**2 if sigma.numel() else ca.repmat(1 / g, ny, 1)
    seen = line.gradient(s.x, read.known, q.model, v.t) @ ca.reshape(s.Phi, n, n)
    predicted = seen @ ca.reshape(s.S, n, n) @ seen.T
    variances = ca.diag(predicted) + noise
    outlying = v.watch.gated(s.watch, innovation, variances, valid, q.gate)
    acting = ca.logic_and(valid, ca.logic_not(outlying))
    keep = ca.diag(acting)
    S_nu = keep @ predicted @ keep + ca.diag(ca.if_else(acting, noise, 1))
    heard = ca.if_else(acting, innovation, 0)
    squared = ca.dot(heard, linear.solver(ny, 1)(S_nu, heard))
    said = verdict(v.watch, s.watch, squared, innovation, variances, valid, outlying, q)
    sample = _sample(line, ny, sigma.numel())
    wrapped = any(output.wrap for output in v.model.outputs)
    y = expected + innovation if wrapped else read.y  # an angle, as many turns from 0 as the estimate
    given = (read.known, q.model, v.t, ca.if_else(acting, y, 0), acting, g, sigma)
    at_end = ca.logic_or(ended, s.samples == 0)
    x, Y, M, K = sample(s.x, s.Phi, s.Y, *given, ca.if_else(at_end, 0.5, 1))
    factors = ca.vertcat(s.contraction, s.certified)
    x, Phi, Y, M, K, factors = _reset(v, sample)(ended, x, s.Phi, Y, M, K, *given, q.prior, factors)
    S = ca.vec(error_covariance(n, ny)(ca.reshape(s.S, n, n), ca.reshape(M, n, n), ca.reshape(K, n, ny), 1 / g))
    finite = ca.sumsqr(ca.vertcat(x, Y, S, factors)) < HUGE
    anew = ca.logic_or(said.inflate, said.restart)
    good, again = ca.logic_and(finite, ca.logic_not(anew)), v.watch.again(said.memory)
    x = ca.if_else(said.restart, q.guess, ca.if_else(finite, x, s.x))
    after = v.state.replace(
        v.z,
        x=x,
        Phi=ca.if_else(good, Phi, v.one),
        Y=ca.if_else(good, Y, v.reset / again),
        S=ca.if_else(good, S, v.guess_covariance * again),
        x_filtered=x,
        before=ca.if_else(said.restart, q.guess, s.x),
        undoable=1,
        samples=ca.if_else(good, ca.if_else(ended, 0, s.samples) + 1, 0),
        innovation=innovation,
        covariance=innovation_covariance.spread(variances, lambda i, j: predicted[i, j]),
        watch=said.memory,
        contraction=ca.if_else(finite, factors[0], s.contraction),
        certified=ca.if_else(finite, factors[1], s.certified),
        intervals=s.intervals + ended,
        rejected=s.rejected + rejected,
        failures=s.failures + ca.logic_not(finite),
        restarts=s.restarts + anew,
    )
    status = status_of(said, valid, finite, v.deviations(v.state.unpack(after)), q, line.variables)
    return ca.Function("jump", [v.z, v.u, v.p, v.t], [v.state.replace(after, status=status)])


def _sample(line: Linearisation, ny: int, n_sigma: int) -> ca.Function:
    """sample(x, Phi, Y, u, p, t, y, valid, g, sigma, weight) -> (x, Y, M, K) after a sample of that weight; where `valid` is 0 it has none.

    The error at the interval's start was e, is M e - K v then, v (ny) the sample's noise in units of sigma.
    """
    n = len(line.variables)
    x, Phi, Y, u, p, t, y, valid, g, sigma, weight = (
        ca.MX.sym(*shape)
        for shape in (
            ("x", n), ("Phi", n * n), ("Y", n * n), ("u", line.u.numel()), ("p", line.p.numel()), ("t",), ("y", ny),
            ("valid", ny), ("g",), ("sigma", n_sigma), ("weight",),
        )
    )  # fmt: skip
    C = ca.diag(valid) @ line.gradient(x, u, p, t)
    r = ca.if_else(valid, y - line.measure(x, u, p, t), 0)
    if n_sigma:
        C, r = ca.diag(1 / sigma) @ C, r / sigma
    update = information_update(n, ny)
    now = ca.reshape(Phi, n, n)
    x_after, Y_after, K = update(x, now, ca.reshape(Y, n, n), C, r, weight * g)
    M = ca.MX.eye(n) - K @ C @ now
    results = [x_after, ca.vec(Y_after), ca.vec(M), ca.vec(K)]
    function = ca.Function("sample", [x, Phi, Y, u, p, t, y, valid, g, sigma, weight], results)
    return function.expand() if n <= UNROLLED else function


def _reset(v: Parts, sample: ca.Function) -> ca.Function:
    """reset(ended, x, Phi, Y, M, K, u, p, t, y, valid, g, sigma, prior, factors) -> (x, Phi, Y, M, K, factors); the same unless `ended`.

    `factors` are the actual and the certified contraction of the interval that ended. The sample at a reset acts twice, in either interval:
    M and K are of both together.
    """
    n = v.n
    prior, old = ca.MX.sym("prior", v.q.prior.numel()), ca.MX.sym("old", 2)
    x, Phi, Y, *given = (ca.MX.sym(sample.name_in(i), sample.numel_in(i)) for i in range(sample.n_in() - 1))
    M, K = (ca.MX.sym(name, sample.numel_out(i)) for name, i in (("M", 2), ("K", 3)))
    one = ca.DM.eye(n).full().ravel()
    factors = v.weights.contraction(ca.reshape(Phi, n, n), ca.reshape(Y, n, n), prior)
    x_new, Y_new, M_new, K_new = sample(x, one, v.weights.information(prior, n), *given, 0.5)
    M_new = ca.reshape(M_new, n, n) @ ca.reshape(Phi, n, n)
    ny = K.numel() // n
    both = [M_new @ ca.reshape(M, n, n), M_new @ ca.reshape(K, n, ny) + ca.reshape(K_new, n, ny)]
    arguments = [x, Phi, Y, M, K, *given, prior, old]
    begin = ca.Function("begin", arguments, [x_new, ca.MX(one), Y_new, *map(ca.vec, both), factors])
    go_on = ca.Function("go_on", arguments, [x, Phi, Y, M, K, old])
    return ca.Function.if_else("reset", begin, go_on)
