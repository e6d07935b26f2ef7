"""The motion of the least-squares observer: its start, the prediction between samples, a sample with the reset before it.

All take `v`, the symbols of one component, see `symbols`.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers import ports
from observers.least_squares.information import contraction, information_update
from observers.least_squares.ports import CODE
from observers.least_squares.tuning import Weight, information
from observers.linearisation import Linearisation
from observers.model import Model
from observers.numerics.finite import HUGE
from observers.numerics.layout import Layout
from observers.numerics.riccati import UNROLLED
from observers.numerics.runge_kutta import runge_kutta


def symbols(model: Model, line: Linearisation, weight: Weight, reset: Weight) -> SimpleNamespace:
    """z, u, p, t, h; `state` (the layout of z), `s` and `q` (the parts of z and p); `read` (the parts of u); `weight`, `reset`."""
    n, ny = len(line.variables), len(model.outputs)
    state = Layout(
        x=n, Phi=n * n, Y=n * n, x_filtered=n, samples=1, innovation=ny, status=1, contraction=1, certified=1, intervals=1,
        rejected=1, failures=1,
    )  # fmt: skip
    settings = Layout(
        guess=n,
        model=len(model.parameters),
        T=1,
        weight=len(weight.ports),
        reset=len(reset.ports),
        sample_time=1,
    )
    z, u, p, t, h = (
        ca.MX.sym(*shape)
        for shape in (("z", state.total), ("u", ports.n_inputs(model)), ("p", settings.total), ("t",), ("h",))
    )
    return SimpleNamespace(
        z=z,
        u=u,
        p=p,
        t=t,
        h=h,
        state=state,
        s=state.unpack(z),
        q=settings.unpack(p),
        read=ports.read(model, u),
        weight=weight,
        reset=reset,
    )


def start(v: SimpleNamespace) -> Any:
    """The guess, at the begin of an interval."""
    n = v.s.x.numel()
    return v.state.pack(
        {part: ca.DM.zeros(size) for part, size in v.state.sizes.items()}
        | {
            "x": v.q.guess,
            "Phi": ca.vec(ca.DM.eye(n).full()),
            "Y": information(v.reset, v.q.reset, n),
            "x_filtered": v.q.guess,
            "status": ca.DM(CODE.propagated_guess),
        }
    )


def flow(v: SimpleNamespace, line: Linearisation) -> Any:
    """(8) without correction, and (11), over h."""
    s = v.s
    n = len(line.variables)
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
    finite = ca.sumsqr(moved) < HUGE
    one = ca.DM.eye(n).full().ravel()
    return v.state.replace(
        v.z,
        x=ca.if_else(finite, moved[:n], s.x),
        Phi=ca.if_else(finite, moved[n:], one),
        Y=ca.if_else(finite, s.Y, information(v.reset, v.q.reset, n)),
        samples=ca.if_else(finite, s.samples, 0),
        status=ca.if_else(finite, s.status, CODE.solver_failed),
        failures=s.failures + ca.logic_not(finite),
    )


def jump(v: SimpleNamespace, line: Linearisation) -> Any:
    """At t_k: the sample, as the last one of an interval that ends here, then, after the reset, as the first one of the next."""
    s, q = v.s, v.q
    n, ny = len(line.variables), v.read.y.numel()
    one = ca.DM.eye(n).full().ravel()
    ended = s.samples >= ca.fmax(ca.floor(q.T / q.sample_time + 0.5), 1)
    residual = v.read.y - line.measure(s.x, v.read.known, q.model, v.t)
    valid, rejected = ports.judged(residual, v.read.offered)
    innovation = ca.if_else(valid, residual, 0)

    sample = _sample(line, v.weight)
    noise = q.weight if v.weight.by_name else q.weight * q.sample_time
    given = (v.read.known, q.model, v.t, ca.if_else(valid, v.read.y, 0), valid, noise)
    at_end = ca.logic_or(ended, s.samples == 0)
    x, Y = sample(s.x, s.Phi, s.Y, *given, ca.if_else(at_end, 0.5, 1))
    x, Phi, Y, factors = _reset(line, sample, v.reset)(
        ended, x, s.Phi, Y, *given, q.reset, ca.vertcat(s.contraction, s.certified)
    )
    finite = ca.sumsqr(ca.vertcat(x, Y, factors)) < HUGE
    incomplete = ca.sum1(valid) < ny
    x = ca.if_else(finite, x, s.x)
    return v.state.replace(
        v.z,
        x=x,
        Phi=ca.if_else(finite, Phi, one),
        Y=ca.if_else(finite, Y, information(v.reset, q.reset, n)),
        x_filtered=x,
        samples=ca.if_else(finite, ca.if_else(ended, 0, s.samples) + 1, 0),
        innovation=innovation,
        status=ca.if_else(incomplete, CODE.sample_rejected, ca.if_else(finite, CODE.corrected, CODE.solver_failed)),
        contraction=ca.if_else(finite, factors[0], s.contraction),
        certified=ca.if_else(finite, factors[1], s.certified),
        intervals=s.intervals + ended,
        rejected=s.rejected + rejected,
        failures=s.failures + ca.logic_not(finite),
    )


def _sample(line: Linearisation, noise: Weight) -> ca.Function:
    """sample(x, Phi, Y, u, p, t, y, valid, g, weight) -> (x, Y) after a sample of that weight; where `valid` is 0 it has none.

    g: gamma Ts, or the standard deviations (ny) of the outputs, which then are counted in units of them.
    """
    n, ny = len(line.variables), line.h.numel()
    x, Phi, Y, u, p, t, y, valid, g, weight = (
        ca.MX.sym(*shape)
        for shape in (
            ("x", n), ("Phi", n * n), ("Y", n * n), ("u", line.u.numel()), ("p", line.p.numel()), ("t",), ("y", ny),
            ("valid", ny), ("g", ny if noise.by_name else 1), ("weight",),
        )
    )  # fmt: skip
    C = ca.diag(valid) @ line.gradient(x, u, p, t)
    r = ca.if_else(valid, y - line.measure(x, u, p, t), 0)
    gain = g
    if noise.by_name:
        C, r, gain = ca.diag(1 / g) @ C, r / g, ca.MX(1)
    update = information_update(n, ny)
    x_after, Y_after = update(x, ca.reshape(Phi, n, n), ca.reshape(Y, n, n), C, r, weight * gain)
    function = ca.Function("sample", [x, Phi, Y, u, p, t, y, valid, g, weight], [x_after, ca.vec(Y_after)])
    return function.expand() if n <= UNROLLED else function


def _reset(line: Linearisation, sample: ca.Function, weight: Weight) -> ca.Function:
    """reset(ended, x, Phi, Y, u, p, t, y, valid, g, p0, factors) -> (x, Phi, Y, factors); nothing changes unless `ended`.

    p0: the parameters of `weight`, p0 or the deviations. `factors` are the actual and the certified contraction of the interval that ended.
    """
    n = len(line.variables)
    p0, old = ca.MX.sym("p0", len(weight.ports)), ca.MX.sym("old", 2)
    x, Phi, Y, *given = (ca.MX.sym(sample.name_in(i), sample.numel_in(i)) for i in range(sample.n_in() - 1))
    one = ca.DM.eye(n).full().ravel()
    moved, gathered, scale = ca.reshape(Phi, n, n), ca.reshape(Y, n, n), p0
    if weight.by_name:  # the same with the states in units of their deviations
        moved, gathered, scale = ca.diag(1 / p0) @ moved @ ca.diag(p0), ca.diag(p0) @ gathered @ ca.diag(p0), ca.MX(1)
    factors = contraction(n)(moved, gathered, scale)
    x_new, Y_new = sample(x, one, information(weight, p0, n), *given, 0.5)
    arguments = [x, Phi, Y, *given, p0, old]
    begin = ca.Function("begin", arguments, [x_new, ca.MX(one), Y_new, factors])
    go_on = ca.Function("go_on", arguments, [x, Phi, Y, old])
    return ca.Function.if_else("reset", begin, go_on)
