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
- Instead of gamma and p0 the weights may be standard deviations by name (`tuning`). Within an interval the observer then is the Kalman
  filter without process noise that starts from diag(initial_std^2) at the reset, the sample there with twice its variance: it weighs half.
- `linearise=True` treats a nonlinear model along the estimate: xhat' = f(xhat, u), A = Df, C = Dh there. The theorem then says nothing.
The steps are in `steps`.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from observers import ports
from observers.component import Component, Port
from observers.least_squares import steps
from observers.least_squares.ports import INTERVALS, STATUS, contraction, documentation
from observers.least_squares.tuning import METHOD, refuse_process_noise, reset_weight, sample_weight
from observers.linearisation import Linearisation, linearisation, refuse_unobservable
from observers.model import Model, ModelError, refuse
from observers.numerics.finite import HUGE


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

    The arguments that all observers share are described in `observers.ports`.

    Args:
        T: start value of `tuning.T`, the time between resets [s], a whole number of sample times (rounded to one).
        process_noise: refused by name; the reset takes its place.
        measurement_noise: a sample of the output weighs 1 / measurement_noise^2; 0.1 of the nominal value where a name is absent.
        initial_std: P_o is diag(initial_std^2) at the start and again after each reset; the nominal value where a name is absent.
        gamma, p0: instead, each by itself, the paper's: start values of `tuning.gamma`, the least-squares gain, and `tuning.p0`, what P_o
            is reset to; 1 if nothing is given.
        linearise: treat a nonlinear model along its estimate instead of refusing it.
        max_step: the prediction is Dormand and Prince's, of order 8. Where A(t) switches between samples max_step bounds the error, which
            is of first order in it; a smooth A(t) allows ten times the default, and a cheaper sample where Ts is longer.

    Raises:
        ModelError: algebraic variables or unknown disturbances, a state or unknown parameter that no output can ever see, a model that
            is not linear in its states and unknown parameters (without `linearise`), a process noise, a tuning of something that is not
            estimated or measured, a deviation out of range.
        ValueError: sample_time out of range; T, gamma or p0 is not positive, T is shorter than the sample time; a weight that is given in
            both ways.
    """
    refuse(model, METHOD, "algebraic", "unknown_disturbances")
    refuse_unobservable(model, METHOD)
    period = ports.sample_time(METHOD, sample_time)
    line = linearisation(model)
    if not linearise:
        _refuse_nonlinear(model, line)
    refuse_process_noise(process_noise)
    weight, reset = sample_weight(model, gamma, measurement_noise), reset_weight(line, p0, initial_std)
    if not sample_time <= T < HUGE:
        raise ValueError(f"{METHOD}: T = {T:g} s must be finite and at least the sample time, {sample_time:g} s")

    v = steps.symbols(model, line, weight, reset)
    s = v.s
    shown = [s.x, s.x_filtered, s.status, s.innovation, s.contraction, s.certified, s.intervals, s.rejected, s.failures]
    return Component(
        name=name or f"{model.name}_least_squares",
        description=f"Least-squares observer with covariance reset for {model.name} (Chen & Yen 1999)",
        start=ca.Function("start", [v.p, v.t], [steps.start(v)]),
        flow=ca.Function("flow", [v.z, v.u, v.p, v.t, v.h], [steps.flow(v, line)]),
        jump=ca.Function("jump", [v.z, v.u, v.p, v.t], [steps.jump(v, line)]),
        output=ca.Function("output", [v.z, v.u, v.p, v.t], [ca.vertcat(*shown)]),
        inputs=(*ports.inputs(model), *ports.validity(model)),
        parameters=(
            *ports.guesses(model, guess or {}),
            *ports.known_parameters(model),
            Port("tuning.T", "time between covariance resets", "s", T, min=1e-6, variability="tunable"),
            *weight.ports,
            *reset.ports,
            period,
        ),
        outputs=(
            *ports.estimates(model),
            STATUS,
            *ports.innovations(model),
            *contraction(reset),
            INTERVALS,
            *ports.COUNTERS,
        ),
        sample_time="sample_time",
        samples_inputs=True,
        max_step=max_step,
        stop_time=stop_time,
        step_size=sample_time,
        counters=tuple(port.name for port in ports.COUNTERS),
        documentation=documentation(model, linearise),
    )


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
