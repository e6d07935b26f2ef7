"""The canonical DAE observer of Nikoukhah, "A new methodology for observer design and implementation", INRIA RR-2677, 1995.

    x' = f(x, u) + h_x(x)' lambda' + Gamma(x, u) lambda     (2.10)
     0 = y - h(x)                                           (2.11)

x is the estimate; lambda, the relaxation, goes to zero with its error and is a residual: it stays away from zero where the measurements
and the model contradict each other. `dae` holds the equations, `dae_gain` the choice of Gamma (section 3), `dae_steps` the integration.

What deviates from the paper, and why:
- The w-form, w = x - h_x' lambda, w' = f + Gamma lambda for a constant h_x, is the same DAE as an ODE of w; x and lambda follow from
  w and (2.11). Classical Runge-Kutta steps it from sample to sample, y between them on a polynomial through the last few. Where h_x
  moves, a half-explicit Runge-Kutta method does, free of y' as well. The paper's BDF is there too (`form="bdf"`).
- (5.5) to (5.7) have a wrong sign in the third entry (one eigenvalue would be +2.19); Gamma is made by automatic differentiation.
  (2.58) and the Gamma block of (4.4) are misprinted as well.
- Divisions of the gain are guarded where the pair (C, A) is not observable; such samples are counted.
- Unknown inputs, the report's outlook: see `dae`. Unknown parameters are states with zero rate.
- Between samples the estimate follows the model: `filtered.*` satisfies (2.11), `estimate.*` is its prediction.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from observers import ports
from observers.canonical_dae import fault_detector
from observers.canonical_dae.bdf import MOST
from observers.canonical_dae.dae import Dae, relaxed
from observers.canonical_dae.gain import Design, Gain, choose, reduced_pair
from observers.canonical_dae.interpolation import HIGHEST
from observers.canonical_dae.ports import CODE, SINGULAR, STATUS, disturbances, documentation, lambdas
from observers.canonical_dae.region import Region, region
from observers.canonical_dae.steps import bdf_step, consistent, integrated
from observers.component import Component, Port
from observers.model import Model, refuse
from observers.numerics.exact import product
from observers.numerics.finite import HUGE
from observers.numerics.layout import Layout
from observers.numerics.runge_kutta import CLASSICAL_4, runge_kutta

CONVERGED = 1e-6  # Newton's last relative correction; the next one would be about its square


def canonical_dae(
    model: Model,
    *,
    sample_time: float,
    gain: str | Design = "exact",
    poles: Sequence[complex] | None = None,
    alpha: float = 10.0,
    X: ArrayLike | None = None,
    form: str = "w",
    order: int = 2,
    degree: int = 3,
    guess: Mapping[str, float] | None = None,
    name: str | None = None,
    max_step: float = 0.01,
    stop_time: float = 10.0,
) -> Component:
    """The observer for `model` as a component: measurements and known inputs in, `estimate.*` and `diagnostics.lambda` out.

    Args:
        sample_time: start value of the fixed parameter `sample_time`, Ts [s].
        gain: "exact" places all eigenvalues of the linearised error dynamics (3.17)-(3.22), "regional" shifts them left of -alpha by the
            Riccati equation (3.25), (3.26); or a function `(x, u, p, t)` that returns the rows of Gamma (n x p), written like the model.
        poles: for "exact", the eigenvalues [1/s], one for each state (less the unknown disturbances), real or in conjugate pairs; -10 each
            if absent. Tunable.
        alpha, X: for "regional", the decay rate [1/s] and X, its diagonal or all of it (p - q x p - q); the identity if absent. Tunable.
        form: "w" (Runge-Kutta on the w-form) or "bdf" (the paper's section 4).
        order: of the backward differentiation, 1 to 5.
        degree: of the polynomial through past measurements that the w-form takes between samples, 1 to 9. A higher one follows faster
            signals and amplifies noise near half the sampling frequency.
        guess: start values of `guess.*` that differ from the model's. The first sample projects it onto h(x) = y.
        name: the component's name; `<model>_canonical_dae` if absent.
        max_step: the longest prediction step [s] (classical Runge-Kutta).
        stop_time: of the default experiment [s].

    Raises:
        ModelError: algebraic variables; outputs that a held input moves other than by a sum; unknown disturbances with which the DAE's
            index is not 1; at a point of the model's region that is named, outputs that are not independent, or states that are not
            observable and do not decay as fast as the gain promises.
        ValueError: an option out of range.
    """
    refuse(model, "canonical_dae", "algebraic")
    period = ports.sample_time("canonical_dae", sample_time)
    if form not in ("w", "bdf"):
        raise ValueError(f"canonical_dae: form = {form!r} must be 'w' or 'bdf'")
    if not 1 <= order <= MOST:
        raise ValueError(f"canonical_dae: order = {order} must be 1 to {MOST}")
    if not 1 <= degree <= HIGHEST:
        raise ValueError(f"canonical_dae: degree = {degree} must be 1 to {HIGHEST}")
    dae, checked = relaxed(model), region(model)
    # How far left what no gain moves must lie: exact placement leaves nothing, a given gain is asked for stability.
    _check(dae, checked, math.inf if gain == "exact" else alpha if gain == "regional" else 0.0)
    chosen = choose(model, dae, checked, gain, poles, alpha, X)

    known = ports.known_parameters(model)
    # Without a relaxation there is no residual to watch.
    detector = fault_detector.TUNING if dae.n_lambda else ()
    tuning = (*chosen.tuning, *detector)
    settings = Layout(guess=dae.n, model=len(known), sample_time=1, gain=len(chosen.tuning), detector=len(detector))
    jump, state = _jump(model, dae, chosen, settings, form, order, degree)
    z, u = ca.SX.sym("z", state.total), ca.SX.sym("u", ports.n_inputs(model))
    p, t, h = ca.SX.sym("p", settings.total), ca.SX.sym("t"), ca.SX.sym("h")
    s, q = state.unpack(z), settings.unpack(p)
    inputs = ports.read(model, u).known

    rhs = ca.Function("rhs", dae.arguments, [dae.f])
    forced = ca.mtimes(ca.DM(dae.E), s.d) if dae.n_disturbances else 0
    moved = runge_kutta(lambda x, time: rhs(x, inputs, q.model, time) + forced, s.x, t, h, CLASSICAL_4)
    start = {part: ca.DM.zeros(size) for part, size in state.sizes.items()} | {
        "x": q.guess,
        "x_filtered": q.guess,
        "status": ca.DM(CODE.initial_guess),
        "fault": ca.DM(fault_detector.SETTLING),
    }
    residual = [s.mu[dae.n_disturbances :], s.fault] if dae.n_lambda else []
    shown = [s.x, s.x_filtered, s.d, s.d, s.status, *residual, s.innovation, s.singular, s.rejected, s.failures]
    return Component(
        name=name or f"{model.name}_canonical_dae",
        description=f"Canonical DAE observer for {model.name} (Nikoukhah 1995), {chosen.description}",
        start=ca.Function("start", [p, t], [state.pack(start)]),
        flow=ca.Function(
            "flow", [z, u, p, t, h], [state.replace(z, x=moved, input_integral=s.input_integral + h * inputs)]
        ),
        jump=jump,
        output=ca.Function("output", [z, u, p, t], [ca.vertcat(*shown)]),
        inputs=(*ports.inputs(model), *ports.validity(model)),
        parameters=(*ports.guesses(model, guess or {}), *known, period, *tuning),
        outputs=(
            *ports.estimates(model),
            *disturbances(model),
            STATUS,
            *lambdas(model, dae),
            *([fault_detector.PORT] if dae.n_lambda else []),
            *ports.innovations(model),
            SINGULAR,
            *ports.COUNTERS,
        ),
        constants=(
            Port(
                "structure.order",
                "order of the backward differentiation; 0: w-form",
                start=order if form == "bdf" else 0,
                kind="Integer",
                variability="constant",
                local=True,
            ),
            Port(
                "structure.degree",
                "degree of the polynomial through past measurements; 0: backward differentiation, which needs none",
                start=0 if form == "bdf" else degree,
                kind="Integer",
                variability="constant",
                local=True,
            ),
        ),
        sample_time="sample_time",
        samples_inputs=True,
        max_step=max_step,
        stop_time=stop_time,
        step_size=sample_time,
        counters=(SINGULAR.name, *(port.name for port in ports.COUNTERS)),
        documentation=documentation(model, chosen, form, order, degree),
    )


def _check(dae: Dae, checked: Region, left_of: float) -> None:
    """The assumptions of Theorem 3.2 at points of the region; (2.11) then has index 1 there (Lemma 2.1).

    The proof of Lemma 3.2 needs less than observability: what (C, A) hides must decay faster than exp(-left_of t) by itself.
    """
    at = dae.arguments
    checked.require_rank("canonical_dae", "h_x", ca.Function("C", at, [ca.densify(dae.C)]), dae.n_outputs)
    hidden = ", ".join(v.name for v in checked.model.unknown_disturbances)
    what = f"what the unknown disturbances ({hidden}) leave of (h_x, f_x)" if hidden else "(h_x, f_x)"
    pair = ca.Function("pair", at, [ca.densify(block) for block in reduced_pair(dae)])
    checked.require_detectable("canonical_dae", what, pair, left_of)


def _jump(
    model: Model, dae: Dae, gain: Gain, settings: Layout, form: str, order: int, degree: int
) -> tuple[ca.Function, Layout]:
    """One sample, and the layout of the state it works on."""
    n, ny, nu, nd = dae.n, dae.n_outputs, len(model.inputs), dae.n_disturbances
    held, implicit = model.input_between_samples == "held", form == "bdf"
    kept = 0 if implicit else degree
    state = Layout(
        x=n,  # the prediction: the estimate of the current time
        x_filtered=n,  # the estimate of the last sample instant, where h(x) = y
        mu=ny,  # [delta; lambda] there
        d=nd,  # disturbances, means over the last interval
        y=ny * kept,  # past samples, newest first
        past=(n + ny) * (order - 1) * implicit,  # (x, mu) before the last sample, newest first
        u=nu * (not held),  # known inputs at the last sample
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
    z, u, p, t = (
        ca.MX.sym(*shape) for shape in (("z", state.total), ("u", ports.n_inputs(model)), ("p", settings.total), ("t",))
    )
    s, q = state.unpack(z), settings.unpack(p)
    read = ports.read(model, u)
    known = read.known
    Ts = q.sample_time

    # A measurement that is missing or not finite is replaced by its prediction.
    valid, rejected = ports.judged(read.y, read.offered)
    outputs = ca.Function("outputs", dae.arguments, [ca.densify(dae.h), ca.densify(dae.r)])
    predicted, added = outputs(s.x, known, q.model, t)
    y = ca.if_else(valid, read.y - added, predicted)
    any_valid, all_valid = ca.sum1(valid) > 0, ca.sum1(valid) == ny

    u_end = s.input_integral / Ts if held else known
    u_begin = u_end if held else s.u
    first = s.k < 1
    if implicit:
        columns = [
            ca.vertcat(s.x_filtered, s.mu),
            *(s.past[i * (n + ny) : (i + 1) * (n + ny)] for i in range(order - 1)),
        ]
        x, mu, change, mu_dot = bdf_step(dae, gain, order)(s.x, s.mu, y, columns, s.k, u_end, q.model, t, Ts, q.gain)
        d, y_kept, past = _head(mu_dot, nd), ca.MX(0, 1), ca.vertcat(*columns[: order - 1], ca.MX(0, 1))
    else:
        samples = [y, *(s.y[i * ny : (i + 1) * ny] for i in range(kept))]
        x, mu, change = integrated(dae, gain, degree)(
            s.x_filtered, s.mu, samples, s.k, u_begin, u_end, q.model, t, Ts, q.gain
        )
        # delta is known up to a constant: it counts from sample to sample.
        d, mu = _head(mu, nd) / Ts, (ca.vertcat(ca.DM.zeros(nd), mu[nd:]) if dae.n_lambda else ca.DM.zeros(nd))
        y_kept, past = ca.vertcat(*samples[:kept]), ca.MX(0, 1)
    x_first, _, change_first = consistent(dae)(s.x, y, s.x, ca.DM.zeros(ny), known, q.model, t)
    x, mu = ca.if_else(first, x_first, x), ca.if_else(first, 0, mu)
    d, change = ca.if_else(first, s.d, d), ca.if_else(first, change_first, change)

    sound = ca.logic_and(ca.sumsqr(ca.vertcat(x, mu, d)) < HUGE, change < CONVERGED)
    failed = ca.logic_and(any_valid, ca.logic_not(sound))
    accepted = ca.logic_and(any_valid, sound)
    x = ca.if_else(accepted, x, s.x)
    mu = ca.if_else(accepted, mu, ca.if_else(failed, 0, s.mu))
    d = ca.if_else(accepted, d, s.d)
    singular = ca.logic_not(gain.gamma(x, known, q.model, t, q.gain)[1])

    fault, above, below = s.fault, s.above, s.below
    if dae.n_lambda:
        scale = product(np.abs(dae.M.T), np.array([[v.nominal] for v in model.outputs]))
        size = ca.mmax(ca.fabs(mu[nd:]) / ca.DM(scale))
        threshold, persistence, settling = ca.vertsplit(q.detector)
        detected = fault_detector.detect(fault, above, below, size, threshold, persistence, settling, Ts)
        fault, above, below = (
            ca.if_else(any_valid, new, old) for new, old in zip(detected, (fault, above, below), strict=True)
        )
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
            "u": ca.MX(0, 1) if held else known,
            "input_integral": ca.DM.zeros(nu),
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
    jump = ca.Function("jump", [z, u, p, t], [result])
    return jump.expand("jump", {"cse": True}), state


def _head(column: Any, count: int) -> Any:
    """The first entries of a column; an empty slice would be 1 x 0."""
    return column[:count] if count else ca.MX(0, 1)
