"""What the canonical DAE observer does at a sample instant, step by step, and the state it works on."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from observers import ports
from observers.canonical_dae import fault_detector
from observers.canonical_dae.dae import Dae
from observers.canonical_dae.gain import Gain
from observers.canonical_dae.ports import CODE
from observers.canonical_dae.steps import bdf_step, consistent, integrated
from observers.model import Model
from observers.numerics.exact import product
from observers.numerics.finite import HUGE
from observers.numerics.layout import Layout

CONVERGED = 1e-6  # Newton's last relative correction; the next one would be about its square


@dataclass(frozen=True)
class Form:
    """By BDF of `order` where `implicit`, else by Runge-Kutta with a polynomial of `degree` through past samples."""

    implicit: bool
    order: int
    degree: int


def layout(model: Model, dae: Dae, form: Form) -> Layout:
    """The observer's state."""
    n, ny, nu, nd = dae.n, dae.n_outputs, len(model.inputs), dae.n_disturbances
    return Layout(
        x=n,  # the prediction: the estimate of the current time
        x_filtered=n,  # the estimate of the last sample instant, where h(x) = y
        mu=ny,  # [delta; lambda] there
        d=nd,  # disturbances, means over the last interval
        y=ny * _kept(form),  # past samples, newest first
        past=(n + ny) * (form.order - 1) * form.implicit,  # (x, mu) before the last sample, newest first
        u=nu * (model.input_between_samples != "held"),  # known inputs at the last sample
        input_integral=nu,  # since the last sample
        k=1,  # samples since the start, or since the last failed step
        innovation=ny,
        status=1,
        fault=1,
        above=1,
        below=1,
        singular=1,
        rejected=1,
        failures=1,
    )


def jump(model: Model, dae: Dae, gain: Gain, state: Layout, settings: Layout, form: Form) -> ca.Function:
    """jump(z, u, p, t) -> z: one sample."""
    v = _symbols(model, dae, state, settings)
    s, q, known = v.s, v.q, v.read.known
    nd = dae.n_disturbances

    # 1. The measurement, y = h(x); one that is missing or not finite is replaced by its prediction.
    valid, rejected = ports.judged(v.read.y, v.read.offered)
    outputs = ca.Function("outputs", dae.arguments, [ca.densify(dae.h), ca.densify(dae.r)])
    predicted, added = outputs(s.x, known, q.model, v.t)
    y = ca.if_else(valid, v.read.y - added, predicted)
    any_valid, all_valid = ca.sum1(valid) > 0, ca.sum1(valid) == dae.n_outputs

    # 2. The DAE over the interval that ends here; at the first sample the guess is projected onto h(x) = y.
    u_end = s.input_integral / q.sample_time if v.held else known
    advance = _by_bdf if form.implicit else _by_runge_kutta
    x, mu, d, change, y_kept, past = advance(v, dae, gain, form, y, u_end)
    x_first, _, change_first = consistent(dae)(s.x, y, s.x, ca.DM.zeros(dae.n_outputs), known, q.model, v.t)
    first = s.k < 1
    x, mu = ca.if_else(first, x_first, x), ca.if_else(first, 0, mu)
    d, change = ca.if_else(first, s.d, d), ca.if_else(first, change_first, change)

    # 3. It counts where something was measured and Newton's method converged.
    sound = ca.logic_and(ca.sumsqr(ca.vertcat(x, mu, d)) < HUGE, change < CONVERGED)
    failed = ca.logic_and(any_valid, ca.logic_not(sound))
    accepted = ca.logic_and(any_valid, sound)
    x = ca.if_else(accepted, x, s.x)
    mu = ca.if_else(accepted, mu, ca.if_else(failed, 0, s.mu))
    d = ca.if_else(accepted, d, s.d)

    # 4. What is to be said of it.
    singular = ca.logic_not(gain.gamma(x, known, q.model, v.t, q.gain)[1])
    fault, above, below = _watched(v, model, dae, mu[nd:] if dae.n_lambda else None, any_valid)
    status: Any = CODE.estimating
    for condition, code in (
        (singular, CODE.singular_gain),
        (ca.logic_not(all_valid), CODE.sample_rejected),
        (failed, CODE.solver_failed),
    ):
        status = ca.if_else(condition, code, status)
    result = state.pack(
        {
            "x": x,
            "x_filtered": x,
            "mu": mu,
            "d": d,
            "y": y_kept,
            "past": past,
            "u": ca.MX(0, 1) if v.held else known,
            "input_integral": ca.DM.zeros(len(model.inputs)),
            "k": ca.if_else(failed, 0, s.k + 1),
            "innovation": y - predicted,
            "status": status,
            "fault": fault,
            "above": above,
            "below": below,
            "singular": s.singular + singular,
            "rejected": s.rejected + rejected,
            "failures": s.failures + failed,
        }
    )
    made = ca.Function("jump", [v.z, v.u, v.p, v.t], [result])
    return made.expand("jump", {"cse": True})


def _kept(form: Form) -> int:
    """Past samples that are kept."""
    return 0 if form.implicit else form.degree


def _symbols(model: Model, dae: Dae, state: Layout, settings: Layout) -> SimpleNamespace:
    """z, u, p, t; `s` and `q` (the parts of z and p); `read` (the parts of u); `held`: known inputs are, between samples."""
    z, u, p, t = (
        ca.MX.sym(*shape) for shape in (("z", state.total), ("u", ports.n_inputs(model)), ("p", settings.total), ("t",))
    )
    held = model.input_between_samples == "held"
    return SimpleNamespace(
        z=z, u=u, p=p, t=t, s=state.unpack(z), q=settings.unpack(p), read=ports.read(model, u), held=held
    )


def _by_bdf(v: SimpleNamespace, dae: Dae, gain: Gain, form: Form, y: Any, u_end: Any) -> tuple[Any, ...]:
    """(x, mu, d, change, past samples, past (x, mu)) at t_k by backward differentiation."""
    s, q, size = v.s, v.q, dae.n + dae.n_outputs
    columns = [ca.vertcat(s.x_filtered, s.mu), *(s.past[i * size : (i + 1) * size] for i in range(form.order - 1))]
    x, mu, change, mu_dot = bdf_step(dae, gain, form.order)(
        s.x, s.mu, y, columns, s.k, u_end, q.model, v.t, q.sample_time, q.gain
    )
    past = ca.vertcat(*columns[: form.order - 1], ca.MX(0, 1))
    return x, mu, _head(mu_dot, dae.n_disturbances), change, ca.MX(0, 1), past


def _by_runge_kutta(v: SimpleNamespace, dae: Dae, gain: Gain, form: Form, y: Any, u_end: Any) -> tuple[Any, ...]:
    """The same by the w-form, or where h_x moves by half-explicit Runge-Kutta."""
    s, q, ny, nd = v.s, v.q, dae.n_outputs, dae.n_disturbances
    samples = [y, *(s.y[i * ny : (i + 1) * ny] for i in range(form.degree))]
    x, mu, change = integrated(dae, gain, form.degree)(
        s.x_filtered, s.mu, samples, s.k, u_end if v.held else s.u, u_end, q.model, v.t, q.sample_time, q.gain
    )
    # delta is known up to a constant: it counts from sample to sample.
    d = _head(mu, nd) / q.sample_time
    mu = ca.vertcat(ca.DM.zeros(nd), mu[nd:]) if dae.n_lambda else ca.DM.zeros(nd)
    return x, mu, d, change, ca.vertcat(*samples[: form.degree]), ca.MX(0, 1)


def _watched(v: SimpleNamespace, model: Model, dae: Dae, relaxation: Any, any_valid: Any) -> tuple[Any, ...]:
    """(fault, above, below) of the detector after this sample; as they were without a `relaxation`, or where nothing was measured."""
    before = (v.s.fault, v.s.above, v.s.below)
    if relaxation is None:
        return before
    scale = product(np.abs(dae.M.T), np.array([[o.nominal] for o in model.outputs]))
    size = ca.mmax(ca.fabs(relaxation) / ca.DM(scale))
    threshold, persistence, settling = ca.vertsplit(v.q.detector)
    detected = fault_detector.detect(*before, size, threshold, persistence, settling, v.q.sample_time)
    return tuple(ca.if_else(any_valid, new, old) for new, old in zip(detected, before, strict=True))


def _head(column: Any, count: int) -> Any:
    """The first entries of a column; an empty slice would be 1 x 0."""
    return column[:count] if count else ca.MX(0, 1)
