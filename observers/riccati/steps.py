"""The motion of the Riccati observer: its start, the prediction between samples, the correction at a sample.

All take `v`, the symbols of one component, see `symbols`.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers import ports
from observers.linearisation import Linearisation
from observers.model import Model
from observers.numerics.finite import HUGE
from observers.numerics.layout import Layout
from observers.numerics.riccati import propagator, symmetric
from observers.numerics.runge_kutta import runge_kutta
from observers.riccati.certificates import NONE, Certificate, certify
from observers.riccati.correction import correction
from observers.riccati.ports import CODE
from observers.riccati.rosenbrock import rosenbrock
from observers.riccati.tuning import Design


def symbols(model: Model, line: Linearisation, design: Design) -> SimpleNamespace:
    """z, u, p, t, h; `state` (the layout of z), `s` and `q` (the parts of z and p); `read` (the parts of u); the matrices N, R, Q0."""
    n, ny = len(line.variables), len(model.outputs)
    state = Layout(
        m=n, Q=n * n, m_filtered=n, guess_error=1, innovation=ny, status=1, certified=1, rate=1, rejected=1, failures=1
    )
    settings = Layout(
        guess=n,
        model=len(model.parameters),
        N=len(design.N.ports),
        R=len(design.R.ports),
        Q0=len(design.Q0.ports),
        initial_error=1,
        sample_time=1,
    )
    z, u, p, t, h = (
        ca.MX.sym(*shape)
        for shape in (("z", state.total), ("u", ports.n_inputs(model)), ("p", settings.total), ("t",), ("h",))
    )
    q = settings.unpack(p)
    matrices = {key: getattr(design, key).expression(getattr(q, key), q.sample_time) for key in ("N", "R", "Q0")}
    return SimpleNamespace(
        z=z, u=u, p=p, t=t, h=h, state=state, s=state.unpack(z), q=q, read=ports.read(model, u), **matrices
    )


def start(v: SimpleNamespace, known: Certificate) -> Any:
    """m0 and Q0, and what is certified of them."""
    q = v.q
    distance = known.distance(q.guess, q.initial_error)
    certified, rate = certify(known, distance, 1)
    return v.state.pack(
        {
            "m": q.guess,
            "Q": _first_Q(v),
            "m_filtered": q.guess,
            "guess_error": distance,
            "innovation": ca.DM.zeros(v.s.innovation.numel()),
            "status": ca.DM(CODE.propagated_guess),
            "certified": certified,
            "rate": rate,
            "rejected": ca.DM(0),
            "failures": ca.DM(0),
        }
    )


def flow(v: SimpleNamespace, line: Linearisation, stiff: bool) -> Any:
    """(2.1), (2.2) without measurements over h; A at the middle of the step, so that Q too is of second order in it."""
    s, q, known = v.s, v.q, v.read.known
    n = len(line.variables)
    Q, W = ca.reshape(s.Q, n, n), v.N @ v.N.T
    if stiff:
        at = (s.m, known, q.model, v.t)
        dm, Phi, Wd = rosenbrock(line.jacobian(*at), line.rate(*at), line.rate_t(*at), W, v.h)
        m = s.m + dm
    else:
        m = runge_kutta(lambda x, time: line.rate(x, known, q.model, time), s.m, v.t, v.h)
        Phi, Wd = propagator(n)(line.jacobian((s.m + m) / 2, known, q.model, v.t + v.h / 2), W, v.h)
    Q = ca.vec(symmetric(Wd + Phi @ Q @ Phi.T))
    finite = ca.sumsqr(ca.vertcat(m, Q)) < HUGE
    return v.state.replace(
        v.z,
        m=ca.if_else(finite, m, s.m),
        Q=ca.if_else(finite, Q, _first_Q(v)),
        status=ca.if_else(finite, s.status, CODE.solver_failed),
        failures=s.failures + ca.logic_not(finite),
    )


def jump(v: SimpleNamespace, line: Linearisation, design: Design, known: Certificate, model: Model) -> Any:
    """The correction of m and Q by the sample at t_k."""
    s, q = v.s, v.q
    n, ny = len(line.variables), len(model.outputs)
    at = (s.m, v.read.known, q.model, v.t)
    residual = v.read.y - line.measure(*at)
    valid, rejected = ports.judged(residual, v.read.offered)
    innovation = ca.if_else(valid, residual, 0)
    Q = ca.reshape(s.Q, n, n)
    m, Q_after = correction(n, ny)(s.m, Q, line.gradient(*at), innovation, v.R @ v.R.T / q.sample_time, valid)
    Q_after = ca.vec(Q_after)
    finite = ca.sumsqr(ca.vertcat(m, Q_after)) < HUGE
    m = ca.if_else(finite, m, s.m)
    incomplete = ca.sum1(valid) < ny
    holds = ca.logic_and(_as_designed(v, design, model), known.inside(m, v.read.known))
    holds = ca.logic_and(ca.logic_and(holds, ca.logic_not(incomplete)), s.certified > NONE)
    certified, rate = certify(known, s.guess_error, holds)
    return v.state.replace(
        v.z,
        m=m,
        Q=ca.if_else(finite, Q_after, _first_Q(v)),
        m_filtered=m,
        innovation=innovation,
        status=ca.if_else(incomplete, CODE.sample_rejected, ca.if_else(finite, CODE.corrected, CODE.solver_failed)),
        certified=certified,
        rate=rate,
        rejected=s.rejected + rejected,
        failures=s.failures + ca.logic_not(finite),
    )


def _as_designed(v: SimpleNamespace, design: Design, model: Model) -> Any:
    """1 while all parameters are those for which the certificate was computed; Ts is one of them where R is a sample's deviation."""
    q = v.q
    values = [q.model, q.N, q.R, q.Q0]
    wanted = [p.start for p in (*model.parameters, *design.ports)]
    if design.R.timed:
        values.append(q.sample_time)
        wanted.append(design.sample_time)
    return ca.sumsqr(ca.vertcat(*values) - ca.DM(wanted)) == 0


def _first_Q(v: SimpleNamespace) -> Any:
    return ca.vec(ca.densify(v.Q0))
