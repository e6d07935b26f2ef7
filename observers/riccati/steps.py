"""The Riccati observer between samples and at a sample: (2.1) and (2.2) of James & Baras 1987, split as `observer` says."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers import innovation_covariance, ports
from observers.bounds import conditioned, inside, projected
from observers.linearisation import Linearisation
from observers.model import Model
from observers.numerics.finite import HUGE
from observers.numerics.layout import Layout
from observers.numerics.lyapunov import covariance_step
from observers.numerics.operations import straightened
from observers.numerics.riccati import symmetric
from observers.numerics.runge_kutta import Tableau, runge_kutta
from observers.riccati.certificates import NONE, Certificate, certify
from observers.riccati.correction import correction
from observers.riccati.design import Design
from observers.riccati.rosenbrock import rosenbrock
from observers.status import CODE
from observers.vigilance import SETTINGS, Watch, status_of, verdict


@dataclass(frozen=True)
class Parts:
    """The observer's structure, and its symbols: state z, inputs u, parameters p, time t, step h; `s`, `q`, `read` are z, p, u by name.

    `N`, `Q0` (n x n) and `Rd` (ny x ny) are the design's matrices as expressions of p, Rd the covariance of a sample.
    """

    model: Model
    line: Linearisation
    design: Design
    certificate: Certificate
    watch: Watch
    stiff: bool
    state: Layout
    z: Any
    u: Any
    p: Any
    t: Any
    h: Any
    s: SimpleNamespace
    q: SimpleNamespace
    read: ports.Inputs
    N: Any
    Rd: Any
    Q0: Any

    def deviations(self, s: SimpleNamespace) -> Any:
        """The standard deviations (n) of the estimate in the state `s`."""
        n = len(self.line.variables)
        return self.watch.deviations(s.watch, ca.diag(ca.reshape(s.Q, n, n)))


def parts(model: Model, line: Linearisation, design: Design, certificate: Certificate, stiff: bool) -> Parts:
    n, ny = len(line.variables), len(model.outputs)
    watch = Watch(model, n, known=design.noise_known, weighted=design.weighted)
    state = Layout(
        m=n, Q=n * n, m_filtered=n, before=n, undoable=1, guess_error=1, innovation=ny, covariance=innovation_covariance.size(ny),
        watch=watch.state.total, status=1, certified=1, rate=1, rejected=1, failures=1, restarts=1,
    )  # fmt: skip
    settings = Layout(guess=n, model=len(model.parameters), **design.sizes, initial_error=1, **SETTINGS, sample_time=1)
    z, u, p, t, h = (
        ca.MX.sym(*shape)
        for shape in (("z", state.total), ("u", ports.n_inputs(model)), ("p", settings.total), ("t",), ("h",))
    )
    s, q, read = state.unpack(z), settings.unpack(p), ports.read(model, u)
    N, Rd, Q0 = design.N.of(q.N), design.Rd(q.R, q.sample_time), design.Q0.of(q.Q0)
    return Parts(model, line, design, certificate, watch, stiff, state, z, u, p, t, h, s, q, read, N, Rd, Q0)


def start(v: Parts) -> ca.Function:
    """start(p, t0) -> z: m0, Q0."""
    first = {
        "m": v.q.guess,
        "Q": ca.vec(ca.densify(v.Q0)),
        "m_filtered": v.q.guess,
        "before": v.q.guess,  # the prediction at the last sample, before it acted
        "undoable": ca.DM(0),  # whether to go back to it is worth a try
        "guess_error": v.certificate.distance(v.q.guess, v.q.initial_error),
        "innovation": ca.DM.zeros(len(v.model.outputs)),
        "covariance": ca.DM.zeros(v.state.sizes["covariance"]),
        "watch": v.watch.start,
        "status": ca.DM(CODE.propagated_guess),
        "rejected": ca.DM(0),
        "failures": ca.DM(0),
        "restarts": ca.DM(0),
    }
    first["certified"], first["rate"] = certify(v.certificate, first["guess_error"], 1)
    return ca.Function("start", [v.p, v.t], [v.state.pack(first)])


def flow(v: Parts, tableau: Tableau) -> ca.Function:
    """flow(z, u, p, t, h) -> z: (2.1), (2.2) without measurements over h.

    A is taken at the middle of the step, so that Q too is of second order in it. Where m escapes, the last sample is undone; a prediction
    that escapes by itself starts again from the guess.
    """
    s, q, line, known = v.s, v.q, v.line, v.read.known
    n = len(line.variables)
    Q, W = ca.reshape(s.Q, n, n), v.N @ v.N.T
    if v.stiff:
        at = (s.m, known, q.model, v.t)
        A = line.jacobian(inside(line.variables, s.m), *at[1:])
        dm, Phi, Wd = rosenbrock(A, line.rate(*at), line.rate_t(*at), W, v.h)
        m, Q = s.m + dm, symmetric(Wd + Phi @ Q @ Phi.T)
    else:
        m = _moved(v, tableau)(s.m, known, q.model, v.t, v.h)
        middle = inside(line.variables, (s.m + m) / 2)
        A = line.sparse_jacobian(middle, known, q.model, v.t + v.h / 2)
        Q = covariance_step(A.sparsity())(Q, A, W, v.h)
    Q = ca.vec(Q)
    whole = ca.sumsqr(m) < HUGE
    finite = ca.logic_and(whole, ca.sumsqr(Q) < HUGE)
    back = ca.if_else(s.undoable, s.before, q.guess)
    after = v.state.replace(
        v.z,
        m=ca.if_else(whole, projected(line.variables, m), back),
        Q=ca.if_else(finite, Q, v.watch.again(s.watch) * ca.vec(ca.densify(v.Q0))),
        m_filtered=ca.if_else(whole, s.m_filtered, back),
        undoable=ca.logic_and(s.undoable, whole),
        status=ca.if_else(finite, s.status, CODE.solver_failed),
        failures=s.failures + ca.logic_not(finite),
    )
    return ca.Function("flow", [v.z, v.u, v.p, v.t, v.h], [after])


def _moved(v: Parts, tableau: Tableau) -> ca.Function:
    """moved(m, known inputs, parameters, t, h) -> m after h."""
    symbols = [ca.MX.sym("x", *value.shape) for value in (v.s.m, v.read.known, v.q.model, v.t, v.h)]
    m, known, parameters, t, h = symbols

    def rate(x: Any, time: Any) -> Any:
        return v.line.rate(projected(v.line.variables, x), known, parameters, time)

    return straightened(ca.Function("moved", symbols, [runge_kutta(rate, m, t, h, tableau)]))


def jump(v: Parts) -> ca.Function:
    """jump(z, u, p, t) -> z: the correction of m and Q by the sample at t_k."""
    s, q, read, line = v.s, v.q, v.read, v.line
    n, ny = len(line.variables), len(v.model.outputs)
    at = (s.m, read.known, q.model, v.t)
    residual = ports.wrapped(v.model, read.y - line.measure(*at))
    valid, rejected = ports.judged(residual, read.offered)
    innovation = ca.if_else(valid, residual, 0)  # a residual that is not finite is not valid
    Q, C = ca.reshape(s.Q, n, n), line.sparse_gradient(inside(line.variables, s.m), *at[1:])
    CQ = (Q @ C.T).T
    variances = ca.sum2(CQ * C) + ca.diag(v.Rd)
    outlying = v.watch.gated(s.watch, innovation, variances, valid, q.gate)
    acting = ca.logic_and(valid, ca.logic_not(outlying))
    m, Q_after, squared = correction(n, ny)(s.m, Q, CQ.T, C, innovation, v.Rd, acting)
    within = conditioned(line.variables, m, Q_after)
    said = verdict(v.watch, s.watch, squared, innovation, variances, valid, outlying, q)
    Q_after = ca.vec(Q_after)
    finite = ca.sumsqr(ca.vertcat(m, Q_after)) < HUGE
    certified, rate = _certified(v, ca.if_else(finite, m, s.m), ca.sum1(acting) < ny)
    anew = ca.logic_or(said.inflate, said.restart)
    first = v.watch.again(said.memory) * ca.vec(ca.densify(v.Q0))
    m = ca.if_else(said.restart, q.guess, ca.if_else(finite, within, s.m))
    after = v.state.replace(
        v.z,
        m=m,
        Q=ca.if_else(ca.logic_and(finite, ca.logic_not(anew)), Q_after, first),
        m_filtered=m,
        before=ca.if_else(said.restart, q.guess, s.m),
        undoable=1,
        innovation=innovation,
        covariance=innovation_covariance.spread(variances, lambda i, j: ca.dot(CQ[i, :], C[j, :]) + v.Rd[i, j]),
        watch=said.memory,
        certified=certified,
        rate=rate,
        rejected=s.rejected + rejected,
        failures=s.failures + ca.logic_not(finite),
        restarts=s.restarts + anew,
    )
    status = status_of(said, valid, finite, v.deviations(v.state.unpack(after)), q, line.variables)
    return ca.Function("jump", [v.z, v.u, v.p, v.t], [v.state.replace(after, status=status)])


def _certified(v: Parts, m: Any, incomplete: Any) -> tuple[Any, Any]:
    """The certificate holds for the design it was computed for, and while the estimate is where its bounds are valid."""
    q = v.q
    values = ca.vertcat(q.model, q.N, q.R, q.Q0)
    wanted = [p.start for p in (*v.model.parameters, *v.design.ports)]
    holds = ca.logic_and(ca.sumsqr(values - ca.DM(wanted)) == 0, v.certificate.inside(m, v.read.known))
    if v.design.sample_time is not None:
        holds = ca.logic_and(holds, q.sample_time == v.design.sample_time)
    holds = ca.logic_and(ca.logic_and(holds, ca.logic_not(incomplete)), v.s.certified > NONE)
    return certify(v.certificate, v.s.guess_error, holds)
