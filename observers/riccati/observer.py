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
- Instead of N, R, Q0 the tuning may be given as standard deviations by name (`tuning`): on a linear model the observer then is the
  Kalman filter of these, to rounding.
The steps are in `steps`, the certificates in `certificates`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from observers import ports
from observers.component import Component
from observers.linearisation import Linearisation, linearisation, refuse_undetectable
from observers.model import Model, refuse
from observers.riccati import steps
from observers.riccati.certificates import CERTIFIED, certificate, certificate_ports
from observers.riccati.ports import STATUS, covariance, documentation, initial_error
from observers.riccati.tuning import METHOD, Given, design

STIFF = 2.0  # h |A| beyond which Runge-Kutta gives way to the exponential step


def riccati(
    model: Model,
    *,
    sample_time: float,
    process_noise: Mapping[str, float] | None = None,
    measurement_noise: Mapping[str, float] | None = None,
    initial_std: Mapping[str, float] | None = None,
    N: Given | None = None,
    R: Given | None = None,
    Q0: Given | None = None,
    guess: Mapping[str, float] | None = None,
    expose: Sequence[str] = (),
    stiff: bool | None = None,
    name: str | None = None,
    max_step: float = 0.1,
    stop_time: float = 10.0,
) -> Component:
    """The observer for `model` as a component: measurements and known inputs in, `estimate.*` out.

    The arguments that all observers share are described in `observers.ports`.

    Args:
        process_noise, measurement_noise, initial_std: N N' = diag(process_noise^2), R R' = diag(measurement_noise^2) Ts,
            Q0 = diag(initial_std^2); a name that is absent has 1e-3, 0.1 and 1 of the nominal value. A process noise of 0 is legal, but
            leaves no certificate.
        N, R, Q0: instead, each by itself, the paper's design matrices: scalar, diagonal (also by name) or whole, over the states and
            unknown parameters (N, Q0) and over the outputs (R); start values of `tuning.*`, 1 if nothing is given. N in units of the
            state per sqrt(s), R in units of the output times sqrt(s), Q0 of the state squared.
        expose: "Q" puts out the matrix Q, `diagnostics.Q[i,j]`.
        stiff: the mean by an exponential Rosenbrock step (order 2, any stiffness) instead of Runge-Kutta (order 8). None: where h |A|
            exceeds STIFF, |A| over the model's bounds if it is finite there, else at the start values.

    Raises:
        ModelError: algebraic variables or unknown disturbances, a state or unknown parameter that no output can ever see and that does
            not decay by itself, a tuning of something that is not estimated or measured, a deviation out of range.
        ValueError: sample_time out of range; a design matrix of a wrong shape or singular, a Q0 that is not symmetric positive definite,
            one that is given in both ways; an unknown name in `expose`.
    """
    refuse(model, METHOD, "algebraic", "unknown_disturbances")
    unknown = sorted(set(expose) - {"Q"})
    if unknown:
        raise ValueError(f"{METHOD}: expose = {unknown[0]!r} is unknown; known: Q")
    refuse_undetectable(model, METHOD)
    period = ports.sample_time(METHOD, sample_time)
    line = linearisation(model)
    deviations = {"process_noise": process_noise, "measurement_noise": measurement_noise, "initial_std": initial_std}
    chosen = design(model, line, sample_time, deviations, {"N": N, "R": R, "Q0": Q0})
    known = certificate(model, line, chosen.N.start, chosen.R.start, chosen.Q0.start)
    if stiff is None:
        stiff = min(sample_time, max_step) * (known.A if np.isfinite(known.A) else _norm_at_start(model, line)) > STIFF

    v = steps.symbols(model, line, chosen)
    shown = [v.s.m, v.s.m_filtered, v.s.status, v.s.innovation, v.s.certified, v.s.rate, v.s.rejected, v.s.failures]
    Q_ports = covariance(line) if "Q" in expose else ()
    n = len(line.variables)
    shown += [v.s.Q[i * n + j] for i in range(n) for j in range(n)] if Q_ports else []
    return Component(
        name=name or f"{model.name}_riccati",
        description=f"Riccati observer for {model.name} (James & Baras 1987)",
        start=ca.Function("start", [v.p, v.t], [steps.start(v, known)]),
        flow=ca.Function("flow", [v.z, v.u, v.p, v.t, v.h], [steps.flow(v, line, stiff)]),
        jump=ca.Function("jump", [v.z, v.u, v.p, v.t], [steps.jump(v, line, chosen, known, model)]),
        output=ca.Function("output", [v.z, v.u, v.p, v.t], [ca.vertcat(*shown)]),
        inputs=(*ports.inputs(model), *ports.validity(model)),
        parameters=(
            *ports.guesses(model, guess or {}),
            *ports.known_parameters(model),
            *chosen.ports,
            initial_error(line),
            period,
        ),
        outputs=(*ports.estimates(model), STATUS, *ports.innovations(model), *CERTIFIED, *ports.COUNTERS, *Q_ports),
        constants=certificate_ports(known),
        sample_time="sample_time",
        samples_inputs=True,
        max_step=max_step,
        stop_time=stop_time,
        step_size=sample_time,
        counters=tuple(port.name for port in ports.COUNTERS),
        documentation=documentation(model, known, stiff),
    )


def _norm_at_start(model: Model, line: Linearisation) -> float:
    """|A| at the model's start values and t = 0."""
    start = [np.array([v.start for v in group]) for group in (line.variables, model.inputs, model.parameters)]
    return float(np.linalg.norm(line.jacobian(*start, 0.0).full(), 2))
