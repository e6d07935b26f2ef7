"""The canonical DAE observer between samples and at a sample: what of (2.10), (2.11) it keeps, judges and says."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from observers import judgement, ports, undo
from observers.canonical_dae import fault_detector
from observers.canonical_dae.dae import Dae
from observers.canonical_dae.gain import Gain
from observers.canonical_dae.steps import bdf_step, consistent, integrated
from observers.model import Model
from observers.numerics.exact import product
from observers.numerics.finite import HUGE
from observers.numerics.layout import Layout
from observers.numerics.runge_kutta import CLASSICAL_4, runge_kutta
from observers.status import CODE, worst
from observers.status import shown as verdict

CONVERGED = 1e-6  # Newton's last relative correction; the next one would be about its square
SETTLED = 20  # samples after which an estimate without a relaxation is no longer settling


@dataclass(frozen=True)
class Method:
    """An observer's structure: the DAE and its gain, whether it goes by backward differentiation (`implicit`) and of which order, or by
    Runge-Kutta and with a polynomial of which degree through past measurements.
    """

    model: Model
    dae: Dae
    gain: Gain
    implicit: bool
    order: int
    degree: int

    @property
    def held(self) -> bool:
        return self.model.input_between_samples == "held"

    @property
    def kept(self) -> int:
        """How many past samples the polynomial wants."""
        return 0 if self.implicit else self.degree

    @property
    def settings(self) -> Layout:
        return Layout(
            guess=self.dae.n,
            model=len(self.model.parameters),
            sample_time=1,
            gain=len(self.gain.tuning),
            detector=fault_detector.SETTINGS if self.dae.n_lambda else 0,
            noise=self.dae.n_outputs,
            false_alarm=1,
        )


def memory(method: Method) -> Layout:
    """The observer's state from sample to sample."""
    n, ny, nu, nd = method.dae.n, method.dae.n_outputs, len(method.model.inputs), method.dae.n_disturbances
    return Layout(
        x=n,  # the prediction: the estimate of the current time
        x_filtered=n,  # the estimate of the last sample instant, where h(x) = y
        before=n,  # the prediction at the last sample, before it acted
        undoable=1,  # whether to go back to it is worth a try
        mu=ny,  # [delta; lambda] there
        d=nd,  # disturbances, means over the last interval
        y=ny * method.kept,  # past samples, newest first
        past=(n + ny) * (method.order - 1) * method.implicit,  # (x, mu) before the last sample, newest first
        u=nu * (not method.held),  # known inputs at the last sample
        input_integral=nu,  # since the last sample
        k=1,  # samples since the start, or since the last failed step
        innovation=ny,
        status=1,
        fault=1,
        above=1,
        below=1,
        **judgement.memory(method.model),
        singular=1,
        rejected=1,
        failures=1,
        restarts=1,
    )


@dataclass(frozen=True)
class Instant:
    """A sample instant: what the last one left (`s`), the parameters (`q`), what is read, and when [s]."""

    s: SimpleNamespace
    q: SimpleNamespace
    read: ports.Inputs
    t: Any


@dataclass(frozen=True)
class Advanced:
    """The relaxed DAE at the sample: x, mu, the disturbances d; Newton's last `change`; the samples and columns that are kept."""

    x: Any
    mu: Any
    d: Any
    change: Any
    y: Any
    past: Any


def start(method: Method) -> ca.Function:
    """start(p, t0) -> z: the guess."""
    state = memory(method)
    p, t = ca.SX.sym("p", method.settings.total), ca.SX.sym("t")
    q = method.settings.unpack(p)
    first = {part: ca.DM.zeros(size) for part, size in state.sizes.items()} | {
        "x": q.guess,
        "x_filtered": q.guess,
        "before": q.guess,
        "status": ca.DM(CODE.propagated_guess),
        "fault": ca.DM(fault_detector.SETTLING),
    }
    return ca.Function("start", [p, t], [state.pack(first)])


def flow(method: Method) -> ca.Function:
    """flow(z, u, p, t, h) -> z: the prediction, by the model with the last disturbances.

    Where it escapes, the last sample is undone; a prediction that escapes by itself starts again from the guess.
    """
    dae, state = method.dae, memory(method)
    z, u = ca.SX.sym("z", state.total), ca.SX.sym("u", ports.n_inputs(method.model))
    p, t, h = ca.SX.sym("p", method.settings.total), ca.SX.sym("t"), ca.SX.sym("h")
    s, q = state.unpack(z), method.settings.unpack(p)
    inputs = ports.read(method.model, u).known
    rhs = ca.Function("rhs", dae.arguments, [dae.f])
    forced = ca.mtimes(ca.DM(dae.E), s.d) if dae.n_disturbances else 0
    moved = runge_kutta(lambda x, time: rhs(x, inputs, q.model, time) + forced, s.x, t, h, CLASSICAL_4)
    whole = ca.sumsqr(moved) < HUGE
    back, told = undo.escaped(s, q.guess, whole)
    after = state.replace(
        z,
        x=ca.if_else(whole, moved, back),
        x_filtered=ca.if_else(whole, s.x_filtered, back),
        mu=ca.if_else(whole, s.mu, 0),
        d=ca.if_else(whole, s.d, 0),
        k=ca.if_else(whole, s.k, 0),
        input_integral=s.input_integral + h * inputs,
        **told,
    )
    return ca.Function("flow", [z, u, p, t, h], [after])


def output(method: Method) -> ca.Function:
    """output(z, u, p, t) -> y: what of the state is shown."""
    dae, state = method.dae, memory(method)
    z, u = ca.SX.sym("z", state.total), ca.SX.sym("u", ports.n_inputs(method.model))
    p, t, s = ca.SX.sym("p", method.settings.total), ca.SX.sym("t"), state.unpack(z)
    residual = [s.mu[dae.n_disturbances :], s.fault] if dae.n_lambda else []
    shown = [
        s.x,
        s.x_filtered,
        s.d,
        s.d,
        verdict(s.status),
        *residual,
        s.innovation,
        s.singular,
        s.rejected,
        s.failures,
        s.restarts,
    ]
    return ca.Function("output", [z, u, p, t], [ca.vertcat(*shown)])


def jump(method: Method) -> ca.Function:
    """jump(z, u, p, t) -> z: the DAE at the sample; the prediction where it has none, or does not converge; the guess where it is lost."""
    dae, state = method.dae, memory(method)
    ny, nu = dae.n_outputs, len(method.model.inputs)
    z, u, p, t = (
        ca.MX.sym(*shape)
        for shape in (
            ("z", state.total), ("u", ports.n_inputs(method.model)), ("p", method.settings.total), ("t",),
        )
    )  # fmt: skip
    now = Instant(state.unpack(z), method.settings.unpack(p), ports.read(method.model, u), t)
    s, q, read = now.s, now.q, now.read

    # 1. The sample, and the step over the last interval to it.
    outputs = ca.Function("outputs", dae.arguments, [ca.densify(dae.h), ca.densify(dae.r)])
    (expected, added), (of_guess, _) = (outputs(x, read.known, q.model, t) for x in (s.x, q.guess))
    sample = judgement.judged(method.model, s, read.y - added, read.offered, expected, of_guess, q.noise, q.false_alarm)
    any_valid = ca.sum1(sample.valid) > 0
    found = _advanced(method, now, sample.y)
    sound = ca.logic_and(ca.sumsqr(ca.vertcat(found.x, found.mu, found.d)) < HUGE, found.change < CONVERGED)
    failed = ca.logic_or(ca.logic_not(sample.readable), ca.logic_and(any_valid, ca.logic_not(sound)))
    accepted = ca.logic_and(any_valid, ca.logic_not(failed))

    # 2. Where it failed, the prediction; where the prediction left the domain, the one before the last sample; in the end the guess.
    lost = ca.if_else(failed, s.outpredicted + 1, sample.memory["outpredicted"])
    undone, stuck = undo.at_sample(s, ca.logic_not(sample.readable))
    again = ca.logic_or(lost >= judgement.PATIENCE, stuck)
    left = ca.if_else(again, q.guess, ca.if_else(undone, s.before, s.x))
    fresh = ca.logic_or(failed, again)
    x = ca.if_else(ca.logic_and(accepted, ca.logic_not(again)), found.x, left)
    mu = ca.if_else(fresh, 0, ca.if_else(accepted, found.mu, s.mu))
    d = ca.if_else(again, 0, ca.if_else(accepted, found.d, s.d))

    # 3. What is to be said of it.
    relaxation = mu[dae.n_disturbances :] if dae.n_lambda else ca.MX(0, 1)
    singular = ca.logic_not(method.gain.gamma(x, read.known, q.model, t, relaxation, q.gain)[1])
    fault, above, below = (
        ca.if_else(again, first, new)
        for first, new in zip((fault_detector.SETTLING, 0, 0), _watched(method, now, mu, any_valid), strict=True)
    )
    k = ca.if_else(fresh, 0, s.k + 1)
    settling, contradicted = k < SETTLED, sample.contradiction
    if dae.n_lambda:
        settling = fault == fault_detector.SETTLING
        contradicted = ca.logic_or(contradicted, fault > fault_detector.QUIET)
    status = worst(
        (sample.outlier, CODE.outlier),
        (ca.sum1(sample.valid) + ny * sample.outlier < ny, CODE.sample_rejected),
        (settling, CODE.settling),
        (ca.logic_or(contradicted, again), CODE.inconsistent),
        (singular, CODE.singular),
        (failed, CODE.solver_failed),
    )

    result = state.pack(
        {
            "x": x,
            "x_filtered": x,
            "before": left,
            "undoable": undo.undoable(s, undone, again),
            "mu": mu,
            "d": d,
            "y": found.y,
            "past": found.past,
            "u": ca.MX(0, 1) if method.held else read.known,
            "input_integral": ca.DM.zeros(nu),
            "k": k,
            "innovation": sample.innovation,
            "status": status,
            "fault": fault,
            "above": above,
            "below": below,
            **{part: ca.if_else(again, 0, value) for part, value in (sample.memory | {"outpredicted": lost}).items()},
            "singular": s.singular + singular,
            "rejected": s.rejected + sample.rejected,
            "failures": s.failures + failed,
            "restarts": s.restarts + again,
        }
    )
    made = ca.Function("jump", [z, u, p, t], [result])
    return made.expand("jump", {"cse": True})


def _advanced(method: Method, now: Instant, y: Any) -> Advanced:
    """The step over the last interval to the measurement y; at the first sample the guess, projected onto h(x) = y."""
    dae, gain, s, q, t, Ts = method.dae, method.gain, now.s, now.q, now.t, now.q.sample_time
    n, ny, nd, order, kept = dae.n, dae.n_outputs, dae.n_disturbances, method.order, method.kept
    known = now.read.known
    u_end = s.input_integral / Ts if method.held else known
    u_begin = u_end if method.held else s.u
    if method.implicit:
        columns = [
            ca.vertcat(s.x_filtered, s.mu),
            *(s.past[i * (n + ny) : (i + 1) * (n + ny)] for i in range(order - 1)),
        ]
        x, mu, change, mu_dot = bdf_step(dae, gain, order)(s.x, s.mu, y, columns, s.k, u_end, q.model, t, Ts, q.gain)
        d, y_kept, past = _head(mu_dot, nd), ca.MX(0, 1), ca.vertcat(*columns[: order - 1], ca.MX(0, 1))
    else:
        samples = [y, *(s.y[i * ny : (i + 1) * ny] for i in range(kept))]
        x, mu, change = integrated(dae, gain, method.degree)(
            s.x_filtered, s.mu, samples, s.k, u_begin, u_end, q.model, t, Ts, q.gain
        )
        # delta is known up to a constant: it counts from sample to sample.
        d, mu = _head(mu, nd) / Ts, (ca.vertcat(ca.DM.zeros(nd), mu[nd:]) if dae.n_lambda else ca.DM.zeros(nd))
        y_kept, past = ca.vertcat(*samples[:kept]), ca.MX(0, 1)
    first = s.k < 1
    x_first, _, change_first = consistent(dae)(s.x, y, s.x, ca.DM.zeros(ny), known, q.model, t)
    x, mu = ca.if_else(first, x_first, x), ca.if_else(first, 0, mu)
    d, change = ca.if_else(first, s.d, d), ca.if_else(first, change_first, change)
    return Advanced(x, mu, d, change, y_kept, past)


def _watched(method: Method, now: Instant, mu: Any, any_valid: Any) -> tuple[Any, Any, Any]:
    """The fault detector's state after the sample; it watches lambda where there is one."""
    dae, s, q = method.dae, now.s, now.q
    if not dae.n_lambda:
        return s.fault, s.above, s.below
    scale = product(np.abs(dae.M.T), np.array([[v.nominal] for v in method.model.outputs]))
    size = ca.mmax(ca.fabs(mu[dae.n_disturbances :]) / ca.DM(scale))
    threshold, persistence, settling = ca.vertsplit(q.detector)
    detected = fault_detector.detect(s.fault, s.above, s.below, size, threshold, persistence, settling, q.sample_time)
    old = (s.fault, s.above, s.below)
    fault, above, below = (ca.if_else(any_valid, new, kept) for new, kept in zip(detected, old, strict=True))
    return fault, above, below


def _head(column: Any, count: int) -> Any:
    """The first entries of a column; an empty slice would be 1 x 0."""
    return column[:count] if count else ca.MX(0, 1)
