"""The least-squares observer with covariance reset of Chen & Yen, "Application of the least squares algorithm to the observer design for
linear time-varying systems", IEEE Trans. Automat. Contr. 44 (9), 1999.

    xhat' = A(t) xhat + B(t) u + L(t) (y - C(t) xhat)                                  (8)
    L = gamma Phi P_o w_o,  w_o = Phi' C',  Phi(t, kT) the transition matrix since kT   (11) to (13)
    P_o' = -gamma P_o w_o w_o' P_o,  P_o(kT) = p0 I                                    (15)

For linear models, time-varying or not; within each interval [kT, (k+1)T) recursive least squares for the state at its start, forgotten at
its end (covariance reset). Symbols are the paper's.

What deviates from the paper, and why:
- Information form: Y = P_o^-1 obeys Y' = gamma w_o w_o', a sum over the samples, Y = I / p0 + gamma sum Ts w_o w_o'. A sample corrects
  xhat by gamma Ts Phi Y^-1 w_o (y - C xhat), with the Y that includes it: the same estimate as that of the sums Y and
  b = gamma sum Ts w_o r, without the reference to the interval's start. The gain form (13) with Runge-Kutta blows up at
  Ts >= 0.125; this does not.
- The integral of w_o w_o' over an interval is summed by the trapezoidal rule: the sample at a reset weighs half in the interval that ends
  and half in the one that begins. On the paper's example, T = 0.25, Ts = 0.01, |e| at 20 s is then 7.15e-6, against 7.16e-6 of the
  continuous observer (scipy, 1e-12); with the whole sample in the new interval it is 7.60e-6, in the old one 6.82e-6, of first order in Ts.
- The lemma's m1^2 is dropped: with the Gramian W referenced to the interval's start, an interval contracts by at most
  mu / (1 + gamma p0 lmin(W)), mu = |Phi((k+1)T, kT)|. Each interval has its own mu and W here; the theorem's mu and alpha1 are the largest
  and the smallest of all. Both that factor and the actual |Phi Y^-1| / p0 are outputs. The first need not be below 1 for convergence: on
  the paper's own example it is not.
- `measurement_noise` and `initial_std` by name are the weighted form of the same: a sample adds w_o w_o' / sigma^2 instead of
  gamma Ts w_o w_o', and P_o starts, and is reset to, diag(initial_std^2) instead of p0 I. Process noise has no place in it: the reset
  forgets instead.
- `linearise=True` treats a nonlinear model along the estimate: xhat' = f(xhat, u), A = Df, C = Dh there. The theorem then says nothing.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from observers import ports
from observers.arguments import checked
from observers.component import Component, Port
from observers.innovation_covariance import innovation_covariance
from observers.least_squares import steps
from observers.least_squares.weights import weights
from observers.linear_inputs import with_linear_inputs
from observers.linearisation import Linearisation, linearisation, prediction_step, refuse_unobservable
from observers.model import Model, ModelError
from observers.numerics.finite import HUGE
from observers.refusal import not_imposed, refuse, refuse_opaque
from observers.status import shown as verdict
from observers.tables import refuse_tables_that_end
from observers.vigilance import TUNING

CONTRACTION = (
    Port(
        "diagnostics.contraction",
        "|Phi Y^-1| / p0 of the last whole interval: no error has grown by more",
        variability="discrete",
    ),
    Port(
        "diagnostics.certified_contraction",
        "mu / (1 + gamma p0 lmin(W)) of the last whole interval, the theorem's bound",
        variability="discrete",
    ),
    Port("diagnostics.intervals", "intervals completed so far", kind="Integer", variability="discrete"),
)


@checked
def least_squares(
    model: Model,
    *,
    sample_time: float,
    T: float,
    process_noise: Mapping[str, float] | None = None,
    measurement_noise: Mapping[str, float] | None = None,
    initial_std: Mapping[str, float] | None = None,
    gamma: float | None = None,
    p0: float | None = None,
    linearise: bool = False,
    guess: Mapping[str, float] | None = None,
    name: str | None = None,
    max_step: float = 0.01,
    stop_time: float = 20.0,
) -> Component:
    """The observer for `model` as a component: measurements and known inputs in, `estimate.*` out.

    The arguments that all observers share are explained in `observers.ports`.

    Args:
        T: start value of `tuning.T`, the time between resets [s], a whole number of sample times (rounded to one).
        measurement_noise, initial_std: standard deviations by name, as for every observer, the latter at the start and after each reset.
        process_noise: refused: the reset every T is what takes its place.
        gamma, p0: the paper's least-squares gain [per squared unit of the outputs and s] and what P_o is reset to instead; start values of
            `tuning.gamma`, `tuning.p0`. 1 where nothing is given.
        linearise: treat a nonlinear model along its estimate instead of refusing it.
        max_step: the longest prediction step [s] (Dormand-Prince, order 8). Where A(t) switches between samples it bounds the error, which
            is of first order in it; a smooth A(t) allows ten times the default, and a cheaper sample where Ts is longer.

    Raises:
        ModelError: algebraic variables or unknown disturbances, a state or unknown parameter that no output can ever see, a model that
            is not linear in its states and unknown parameters (without `linearise`), a deviation of something that is not estimated or
            measured.
        ValueError: T, gamma or p0 is not positive, T is shorter than the sample time; a process noise; both ways to say one thing.
    """
    refuse(model, "least_squares", "algebraic", "unknown_disturbances")
    refuse_opaque(model, "least_squares")
    refuse_tables_that_end(model, "least_squares")
    refuse_unobservable(model, "least_squares")
    if process_noise is not None:
        raise ValueError(
            "least_squares: process_noise has no meaning here: a reset every T forgets in its place; shorten T instead"
        )
    period = ports.sample_time("least_squares", sample_time)
    line = linearisation(model)
    if not linearise:
        _refuse_nonlinear(model, line)
    if not sample_time <= T < HUGE:
        raise ValueError(f"least_squares: T = {T:g} s must be finite and at least the sample time, {sample_time:g} s")
    chosen = weights(model, line.variables, gamma, p0, measurement_noise, initial_std)
    v = steps.parts(model, line, chosen)
    shown = [v.s.x, v.s.x_filtered, verdict(v.s.status), v.s.innovation, v.deviations(v.s), v.s.covariance]
    shown += [v.s.contraction, v.s.certified, v.s.intervals]
    shown += [v.s.rejected, v.s.failures, v.s.restarts]
    made = Component(
        name=name or f"{model.name}_least_squares",
        description=f"Least-squares observer with covariance reset for {model.name} (Chen & Yen 1999)",
        start=steps.start(v),
        flow=steps.flow(v),
        jump=steps.jump(v),
        output=ca.Function("output", [v.z, v.u, v.p, v.t], [ca.vertcat(*shown)]),
        inputs=(*ports.inputs(model), *ports.validity(model)),
        parameters=(
            *ports.guesses(model, guess or {}),
            *ports.known_parameters(model),
            Port("tuning.T", "time between covariance resets", "s", T, min=1e-6, variability="tunable"),
            *chosen.ports,
            *TUNING,
            period,
        ),
        outputs=(
            *ports.estimates(model),
            *ports.VERDICT,
            *ports.innovations(model),
            *ports.standard_deviations(model),
            *innovation_covariance(model),
            *CONTRACTION,
            *ports.COUNTERS,
            ports.RESTARTS,
        ),
        sample_time="sample_time",
        samples_inputs=True,
        max_step=prediction_step(model, max_step),
        stop_time=stop_time,
        step_size=sample_time,
        counters=tuple(port.name for port in ports.COUNTERS),
        documentation=_documentation(model, linearise) + not_imposed(model),
    )
    return with_linear_inputs(made, model, sample_time)


def _refuse_nonlinear(model: Model, line: Linearisation) -> None:
    """Raise a ModelError that names the first equation which is not linear in states and unknown parameters, and the variable."""
    for group, column, names in (
        ("the rate of", line.f, [v.name for v in line.variables]),
        ("the output", line.h, [v.name for v in model.outputs]),
    ):
        for expression, name in zip(ca.vertsplit(column), names, strict=True):
            bent = ca.which_depends(expression, line.m, 2, False)
            if any(bent):
                variable = line.variables[bent.index(True)].name
                raise ModelError(
                    f"least_squares: model '{model.name}' is not linear: {group} '{name}' is nonlinear in '{variable}' "
                    "(linearise=True treats it along the estimate)"
                )


def _documentation(model: Model, linearise: bool) -> str:
    along = ", linearised along its estimate" if linearise else ""
    return (
        f"<p>Between two resets the samples fit the state of the model {model.name}{along} at the interval's start by recursive "
        "least squares; each reset forgets them (Chen and Yen, IEEE Trans. Automat. Contr., 1999). Connect the measurements and "
        "the known inputs, and step with at most the sample time.</p>"
        "<p><code>diagnostics.contraction</code> is the factor by which the error of the last interval can have grown or shrunk at most, "
        "<code>diagnostics.certified_contraction</code> the theorem's bound of it.</p>"
        "<p><code>diagnostics.status</code> says whether the estimate can be trusted; <code>estimate.*</code> is of the current time, "
        f"<code>filtered.*</code> of the last sample instant.</p>{ports.VALIDITY_HTML}"
    )
