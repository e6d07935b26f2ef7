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

import casadi as ca
import numpy as np

from observers import ports
from observers.arguments import checked
from observers.component import Component, Port
from observers.free_motion import FreeMotion, accurate_step, free_motion
from observers.innovation_covariance import innovation_covariance
from observers.linear_inputs import with_linear_inputs
from observers.linearisation import Linearisation, chosen_step, linearisation, refuse_undetectable
from observers.model import Model
from observers.refusal import not_imposed, refuse
from observers.riccati import steps
from observers.riccati.certificates import CERTIFIED, Certificate, certificate_of, certificate_ports
from observers.riccati.design import UNKNOWN, Given, design
from observers.riccati.rosenbrock import along
from observers.riccati.suprema import suprema_of
from observers.status import shown
from observers.tables import refuse_tables_that_end
from observers.vigilance import TUNING

EXPONENTIAL = 1e-3  # error of a step, in units of a state's largest value or of its nominal value
POINTS = 60  # of the motion, at which it is looked at
STIFF = 2.0  # h |A| beyond which Runge-Kutta gives way to the exponential step
INITIAL_ERROR = Port(
    "tuning.initial_error",
    "bound on |x0 - m0| where it is known better than by the model's bounds",
    start=UNKNOWN,
    min=0.0,
    variability="fixed",
)


@checked
def riccati(
    model: Model,
    *,
    sample_time: float,
    process_noise: Mapping[str, float] | None = None,
    measurement_noise: Mapping[str, float] | None = None,
    initial_std: Mapping[str, float] | None = None,
    N: Given = None,
    R: Given = None,
    Q0: Given = None,
    guess: Mapping[str, float] | None = None,
    expose: Sequence[str] = (),
    stiff: bool | None = None,
    order: int = 8,
    name: str | None = None,
    max_step: float = 0.1,
    stop_time: float = 10.0,
) -> Component:
    """The observer for `model` as a component: measurements and known inputs in, `estimate.*` out.

    The arguments that all observers share are explained in `observers.ports`.

    Args:
        process_noise, measurement_noise, initial_std: standard deviations by name, as for every observer; on a linear model the estimate is
            then the Kalman filter's.
        N, R, Q0: the paper's design matrices instead: scalar, diagonal (in order, or by name) or whole, over the states and unknown
            parameters (N, Q0) and over the outputs (R); start values of `tuning.*`. N in units of the state per sqrt(s), R in units of the
            output times sqrt(s), Q0 of the state squared. Where one is given, the others are the identity; where nothing is
            given, the deviations' defaults.
        expose: "Q" puts out the matrix Q, `diagnostics.Q[i,j]`.
        stiff: the mean by an exponential Rosenbrock step (order 2, any stiffness) instead of Runge-Kutta. None: where h |A|
            exceeds STIFF, |A| over the model's bounds if it is finite there, else at the start values, and the model is not so nonlinear
            that the exponential step would have to be the shorter one.
        order: of the Runge-Kutta method, 8 or 4: a third of its cost, at an error of up to 1e-4 a step.
        max_step: the longest prediction step [s]; shortened as `prediction_step` says, the exponential one until its error along the motion
            from the start values is below EXPONENTIAL.

    Raises:
        ModelError: algebraic variables or unknown disturbances, a state or unknown parameter that no output can ever see and that does
            not decay by itself, a deviation of something that is not estimated or measured.
        ValueError: a design matrix of a wrong shape or singular, a Q0 that is not symmetric positive definite, a deviation beside the
            matrix that says the same, an unknown name in `expose`.
    """
    refuse(model, "riccati", "algebraic", "unknown_disturbances")
    refuse_tables_that_end(model, "riccati")
    unknown = sorted(set(expose) - {"Q"})
    if unknown:
        raise ValueError(f"riccati: expose = {unknown[0]!r} is unknown; known: Q")
    refuse_undetectable(model, "riccati")
    period = ports.sample_time("riccati", sample_time)
    line = linearisation(model)
    deviations = {"process_noise": process_noise, "measurement_noise": measurement_noise, "initial_std": initial_std}
    chosen = design(model, line.variables, sample_time, {"N": N, "R": R, "Q0": Q0}, deviations)
    known = certificate_of(suprema_of(model, line), chosen.N.start, chosen.R.start)(chosen.Q0.start)
    moving = free_motion(model, max_step)
    tableau, explicit = chosen_step(model, moving, max_step, order)
    exponential = max_step
    asked = stiff is not None
    if stiff is None:
        stiff = min(sample_time, max_step) * (known.A if np.isfinite(known.A) else _norm_at_start(model, line)) > STIFF
    if stiff:
        exponential = _exponential_step(moving, max_step)
        stiff = asked or exponential > min(sample_time, explicit)
    v = steps.parts(model, line, chosen, known, stiff)
    shown = _shown(v, "Q" in expose)
    made = Component(
        name=name or f"{model.name}_riccati",
        description=f"Riccati observer for {model.name} (James & Baras 1987)",
        start=steps.start(v),
        flow=steps.flow(v, tableau),
        jump=steps.jump(v),
        output=ca.Function("output", [v.z, v.u, v.p, v.t], [ca.vertcat(*shown)]),
        inputs=(*ports.inputs(model), *ports.validity(model)),
        parameters=(
            *ports.guesses(model, guess or {}),
            *ports.known_parameters(model),
            *chosen.ports,
            INITIAL_ERROR,
            *TUNING,
            period,
        ),
        outputs=(
            *ports.estimates(model),
            *ports.VERDICT,
            *ports.innovations(model),
            *ports.standard_deviations(model),
            *innovation_covariance(model),
            *CERTIFIED,
            *ports.COUNTERS,
            ports.RESTARTS,
            *(_entries(len(line.variables)) if "Q" in expose else ()),
        ),
        constants=certificate_ports(known),
        sample_time="sample_time",
        samples_inputs=True,
        max_step=exponential if stiff else explicit,
        stop_time=stop_time,
        step_size=sample_time,
        counters=tuple(port.name for port in ports.COUNTERS),
        documentation=_documentation(model, known, None if stiff else tableau.order) + not_imposed(model),
    )
    return with_linear_inputs(made, model, sample_time)


def _shown(v: steps.Parts, with_Q: bool) -> list[ca.MX]:
    """The outputs, in their order."""
    s, n = v.s, len(v.line.variables)
    columns = [s.m, s.m_filtered, shown(s.status), s.innovation, v.deviations(s), s.covariance]
    columns += [s.certified, s.rate, s.rejected, s.failures, s.restarts]
    return columns + [s.Q[i * n + j] for i in range(n) for j in range(n)] * with_Q


def _entries(n: int) -> tuple[Port, ...]:
    text = "covariance-like matrix Q of the gain, now"
    return tuple(Port(f"diagnostics.Q[{i + 1},{j + 1}]", text) for i in range(n) for j in range(n))


def _norm_at_start(model: Model, line: Linearisation) -> float:
    """|A| at the model's start values and t = 0."""
    start = [np.array([v.start for v in group]) for group in (line.variables, model.inputs, model.parameters)]
    return float(np.linalg.norm(line.jacobian(*start, 0.0).full(), 2))


def _exponential_step(moving: FreeMotion | None, longest: float) -> float:
    if moving is None:
        return longest
    return accurate_step(moving.thinned(POINTS), along(moving), longest, 2, EXPONENTIAL)


def _documentation(model: Model, known: Certificate, order: int | None) -> str:
    how = {
        None: "an exponential Rosenbrock step",
        4: "the classical Runge-Kutta method of order 4",
        8: "Dormand and Prince's method of order 8",
    }[order]
    return (
        f"<p>At every sample instant the estimate of the model {model.name} is corrected with the gain of a Riccati equation along it "
        f"(James and Baras, University of Maryland, 1987); between samples the estimate moves by {how}. Connect the measurements and "
        "the known inputs, and step with at most the sample time.</p>"
        f"{known.html()}"
        "<p><code>diagnostics.status</code> says whether the estimate can be trusted; <code>estimate.*</code> is of the current time, "
        "<code>filtered.*</code> of the last sample instant.</p>"
        f"{ports.VALIDITY_HTML}"
    )
