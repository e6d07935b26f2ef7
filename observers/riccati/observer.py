"""The Riccati observer of James & Baras, "An observer design for nonlinear control systems", University of Maryland SRC TR 87-18, 1987.

    m' = f(m, u) + Q H(m)' R^-1 (y - h(m)),  m(0) = m0                                (2.1)
    Q' = A(m, u) Q + Q A(m, u)' - Q H(m)' H(m) Q + N N',  Q(0) = Q0                   (2.2)

with A = Df, H = R^-1 Dh: the minimum-energy estimator, whose covariance-like Q gives the gain. Symbols are the paper's.

What deviates from the paper, and why:
- Measurements come as samples. Each step is split: over Ts the mean follows f and Q follows (2.2) without its third term; at t_k the sample
  corrects both exactly, as one of covariance Rd = R R' / Ts. For Ts -> 0 this is (2.1), (2.2). Holding a sample over the step instead costs
  a factor of 60 to 450 in accuracy.
- The paper's unknown parameters are states of their own; here they are appended to x with zero rates.
- Time-varying models are treated (the paper's remark at the end of section 2).
- The certificates are in `certificates`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from observers import ports
from observers.component import Component, Enumeration, Port
from observers.linearisation import Linearisation, linearisation, refuse_undetectable
from observers.model import Model, refuse
from observers.numerics.finite import HUGE
from observers.numerics.layout import Layout
from observers.numerics.riccati import propagator, symmetric
from observers.numerics.runge_kutta import runge_kutta
from observers.riccati import tuning
from observers.riccati.certificates import CERTIFIED, NONE, Certificate, certificate, certificate_ports, certify
from observers.riccati.correction import correction
from observers.riccati.rosenbrock import rosenbrock

STIFF = 2.0  # h |A| beyond which Runge-Kutta gives way to the exponential step

STATUS = Enumeration(
    "RiccatiStatus",
    (
        ("propagated_guess", "no sample yet: the estimate is the propagated guess"),
        ("corrected", "the last sample corrected the estimate"),
        (
            "sample_rejected",
            "a measurement was missing or not finite: the estimate is the prediction, or rests on the other outputs",
        ),
        ("solver_failed", "a step was not finite: the estimate was held, Q starts again from Q0"),
    ),
)
CODE = SimpleNamespace(**{item: i for i, (item, _) in enumerate(STATUS.items, start=1)})

STATUS_PORT = ports.status(STATUS)


def riccati(
    model: Model,
    *,
    sample_time: float,
    N: ArrayLike = 1.0,
    R: ArrayLike = 1.0,
    Q0: ArrayLike = 1.0,
    guess: Mapping[str, float] | None = None,
    expose: Sequence[str] = (),
    stiff: bool | None = None,
    name: str | None = None,
    max_step: float = 0.1,
    stop_time: float = 10.0,
) -> Component:
    """The observer for `model` as a component: measurements and known inputs in, `estimate.*` out.

    Args:
        sample_time: start value of the parameter `sample_time`, Ts [s].
        N, R, Q0: the paper's design matrices: scalar, diagonal or whole, over the states and unknown parameters (N, Q0) and over
            the outputs (R); start values of `tuning.*`. N in units of the state per sqrt(s), R in units of the output times
            sqrt(s), Q0 of the state squared.
        guess: start values of `guess.*` (m0) that differ from the model's.
        expose: "Q" puts out the matrix Q, `diagnostics.Q[i,j]`.
        stiff: the mean by an exponential Rosenbrock step (order 2, any stiffness) instead of Runge-Kutta (order 8). None: where h |A|
            exceeds STIFF, |A| over the model's bounds if it is finite there, else at the start values.
        name: the component's name; `<model>_riccati` if absent.
        max_step: the longest prediction step [s].
        stop_time: of the default experiment [s].

    Raises:
        ModelError: algebraic variables or unknown disturbances, a state or unknown parameter that no output can ever see and that does
            not decay by itself.
        ValueError: a design matrix of a wrong shape or singular, a Q0 that is not symmetric positive definite, an unknown name in `expose`.
    """
    refuse(model, "riccati", "algebraic", "unknown_disturbances")
    unknown = sorted(set(expose) - {"Q"})
    if unknown:
        raise ValueError(f"riccati: expose = {unknown[0]!r} is unknown; known: Q")
    refuse_undetectable(model, "riccati")
    period = ports.sample_time("riccati", sample_time)
    line = linearisation(model)
    design = _design(model, line, N, R, Q0)
    known = certificate(model, line, design.N.start, design.R.start, design.Q0.start)
    if stiff is None:
        stiff = min(sample_time, max_step) * (known.A if np.isfinite(known.A) else _norm_at_start(model, line)) > STIFF

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
    s, q = state.unpack(z), settings.unpack(p)
    read = ports.read(model, u)
    matrices = {key: getattr(design, key).expression(getattr(q, key)) for key in ("N", "R", "Q0")}
    inner = SimpleNamespace(
        z=z, y=read.y, u=read.known, offered=read.offered, p=p, t=t, h=h, s=s, q=q, state=state, **matrices
    )

    start = {
        "m": q.guess,
        "Q": ca.vec(ca.densify(inner.Q0)),
        "m_filtered": q.guess,
        "guess_error": known.distance(q.guess, q.initial_error),
        "innovation": ca.DM.zeros(ny),
        "status": ca.DM(CODE.propagated_guess),
        "rejected": ca.DM(0),
        "failures": ca.DM(0),
    }
    start["certified"], start["rate"] = certify(known, start["guess_error"], 1)
    entries = [(i, j) for i in range(n) for j in range(n)] if "Q" in expose else []
    Q_ports = tuple(
        Port(f"diagnostics.Q[{i + 1},{j + 1}]", "covariance-like matrix Q of the gain, now") for i, j in entries
    )
    measured = [s.m, s.m_filtered, s.status, s.innovation, s.certified, s.rate, s.rejected, s.failures]
    measured += [s.Q[i * n + j] for i, j in entries]
    bounds = (
        Port(
            "tuning.initial_error",
            "bound on |x0 - m0| where it is known better than by the model's bounds",
            start=tuning.UNKNOWN,
            min=0.0,
            variability="fixed",
        ),
        period,
    )
    return Component(
        name=name or f"{model.name}_riccati",
        description=f"Riccati observer for {model.name} (James & Baras 1987)",
        start=ca.Function("start", [p, t], [state.pack(start)]),
        flow=ca.Function("flow", [z, u, p, t, h], [_flow(inner, line, stiff)]),
        jump=ca.Function("jump", [z, u, p, t], [_jump(inner, line, design, known, model)]),
        output=ca.Function("output", [z, u, p, t], [ca.vertcat(*measured)]),
        inputs=(*ports.inputs(model), *ports.validity(model)),
        parameters=(
            *ports.guesses(model, guess or {}),
            *ports.known_parameters(model),
            *design.N.ports,
            *design.R.ports,
            *design.Q0.ports,
            *bounds,
        ),
        outputs=(
            *ports.estimates(model),
            STATUS_PORT,
            *ports.innovations(model),
            *CERTIFIED,
            *ports.COUNTERS,
            *Q_ports,
        ),
        constants=certificate_ports(known),
        sample_time="sample_time",
        samples_inputs=True,
        max_step=max_step,
        stop_time=stop_time,
        step_size=sample_time,
        counters=tuple(port.name for port in ports.COUNTERS),
        documentation=_documentation(model, known, stiff),
    )


def _design(model: Model, line: Linearisation, N: ArrayLike, R: ArrayLike, Q0: ArrayLike) -> SimpleNamespace:
    """The design matrices N, R, Q0 as tuning parameters."""
    design = SimpleNamespace(
        N=tuning.matrix("riccati", "N", N, line.variables, "disturbance intensity, in its unit per sqrt(s), of"),
        R=tuning.matrix("riccati", "R", R, model.outputs, "measurement error, in its unit times sqrt(s), of"),
        Q0=tuning.matrix("riccati", "Q0", Q0, line.variables, "first Q, in its unit squared, of", "fixed"),
    )
    if not np.array_equal(design.Q0.start, design.Q0.start.T) or np.linalg.eigvalsh(design.Q0.start).min() <= 0:
        raise ValueError(f"riccati: Q0 = {design.Q0.start.tolist()} is not symmetric positive definite")
    return design


def _norm_at_start(model: Model, line: Linearisation) -> float:
    """|A| at the model's start values and t = 0."""
    start = [np.array([v.start for v in group]) for group in (line.variables, model.inputs, model.parameters)]
    return float(np.linalg.norm(line.jacobian(*start, 0.0).full(), 2))


def _flow(v: SimpleNamespace, line: Linearisation, stiff: bool) -> Any:
    """(2.1), (2.2) without measurements over h; A at the middle of the step, so that Q too is of second order in it."""
    s, q = v.s, v.q
    n = len(line.variables)
    Q, W = ca.reshape(s.Q, n, n), v.N @ v.N.T
    if stiff:
        at = (s.m, v.u, q.model, v.t)
        dm, Phi, Wd = rosenbrock(line.jacobian(*at), line.rate(*at), line.rate_t(*at), W, v.h)
        m = s.m + dm
    else:
        m = runge_kutta(lambda x, time: line.rate(x, v.u, q.model, time), s.m, v.t, v.h)
        Phi, Wd = propagator(n)(line.jacobian((s.m + m) / 2, v.u, q.model, v.t + v.h / 2), W, v.h)
    Q = ca.vec(symmetric(Wd + Phi @ Q @ Phi.T))
    finite = ca.sumsqr(ca.vertcat(m, Q)) < HUGE
    return v.state.replace(
        v.z,
        m=ca.if_else(finite, m, s.m),
        Q=ca.if_else(finite, Q, ca.vec(ca.densify(v.Q0))),
        status=ca.if_else(finite, s.status, CODE.solver_failed),
        failures=s.failures + ca.logic_not(finite),
    )


def _jump(v: SimpleNamespace, line: Linearisation, design: SimpleNamespace, known: Certificate, model: Model) -> Any:
    """The correction of m and Q by the sample at t_k."""
    s, q = v.s, v.q
    n, ny = len(line.variables), len(model.outputs)
    at = (s.m, v.u, q.model, v.t)
    residual = v.y - line.measure(*at)
    valid, rejected = ports.judged(residual, v.offered)
    innovation = ca.if_else(valid, residual, 0)
    Q = ca.reshape(s.Q, n, n)
    m, Q_after = correction(n, ny)(s.m, Q, line.gradient(*at), innovation, v.R @ v.R.T / q.sample_time, valid)
    Q_after = ca.vec(Q_after)
    finite = ca.sumsqr(ca.vertcat(m, Q_after)) < HUGE
    # The certificate holds for the design it was computed for, and while the estimate is where its bounds are valid.
    values = ca.vertcat(q.model, q.N, q.R, q.Q0)
    wanted = [
        *(p.start for p in model.parameters),
        *(p.start for key in ("N", "R", "Q0") for p in getattr(design, key).ports),
    ]
    holds = ca.logic_and(ca.sumsqr(values - ca.DM(wanted)) == 0, known.inside(ca.if_else(finite, m, s.m), v.u))
    incomplete = ca.sum1(valid) < ny
    holds = ca.logic_and(ca.logic_and(holds, ca.logic_not(incomplete)), s.certified > NONE)
    certified, rate = certify(known, s.guess_error, holds)
    status = ca.if_else(incomplete, CODE.sample_rejected, ca.if_else(finite, CODE.corrected, CODE.solver_failed))
    m = ca.if_else(finite, m, s.m)
    return v.state.replace(
        v.z,
        m=m,
        Q=ca.if_else(finite, Q_after, ca.vec(ca.densify(v.Q0))),
        m_filtered=m,
        innovation=innovation,
        status=status,
        certified=certified,
        rate=rate,
        rejected=s.rejected + rejected,
        failures=s.failures + ca.logic_not(finite),
    )


def _documentation(model: Model, known: Certificate, stiff: bool) -> str:
    how = "an exponential Rosenbrock step" if stiff else "Dormand and Prince's method of order 8"
    return (
        f"<p>At every sample instant the estimate of the model {model.name} is corrected with the gain of a Riccati equation along it "
        f"(James and Baras, University of Maryland, 1987); between samples the estimate moves by {how}. Connect the measurements and "
        "the known inputs, and step with at most the sample time.</p>"
        f"{known.html()}"
        "<p><code>diagnostics.status</code> says whether the estimate can be trusted; <code>estimate.*</code> is of the current time, "
        "<code>filtered.*</code> of the last sample instant.</p>"
        f"{ports.VALIDITY_HTML}"
    )
