"""The unscented Kalman filter in square-root form, the comparator of Gong, Ross & Kang 2007 and an observer in its own right.

Julier & Uhlmann, "Unscented filtering and nonlinear estimation", Proc. IEEE 92 (3), 2004; in the square-root form of van der Merwe &
Wan, 2001.
2 n + 1 sigma points carry mean and covariance P = S S' through the model:

    X = [x, x + sqrt(n + kappa) S_j, x - sqrt(n + kappa) S_j],   weights kappa / (n + kappa) and 1 / (2 (n + kappa))

What deviates, and why:
- Unknown parameters are appended to the state with zero rate; with a process noise of zero they end up frozen, which is all that "the UKF
  fails" in the paper comes from.
- The points move with the flow, continuously, so that outputs between samples are the mean of their own time.
- kappa >= 0: no weight is negative, and every square root is a QR factorisation of a stack of columns. No Cholesky downdate can fail.
- A measurement that is not finite leaves the correction; the others still act.
"""

from __future__ import annotations

from collections.abc import Mapping

from observers import ports
from observers.arguments import checked
from observers.component import Component, Port
from observers.free_motion import free_motion
from observers.innovation_covariance import innovation_covariance
from observers.linear_inputs import with_linear_inputs
from observers.linearisation import chosen_step, refuse_unobservable
from observers.model import Model, ModelError
from observers.refusal import not_imposed, refuse
from observers.tables import refuse_tables_that_end
from observers.ukf import steps
from observers.ukf.parts import parts
from observers.vigilance import TUNING

KAPPA = Port(
    "tuning.kappa",
    "spread of the sigma points, sqrt(n + kappa) deviations",
    start=1.0,
    min=0.0,
    variability="tunable",
)


MOST_ESTIMATED = 100  # of which the C compiler takes 46 s, of 50 it takes 14 s


@checked
def ukf(
    model: Model,
    *,
    sample_time: float,
    process_noise: Mapping[str, float] | None = None,
    measurement_noise: Mapping[str, float] | None = None,
    initial_std: Mapping[str, float] | None = None,
    guess: Mapping[str, float] | None = None,
    name: str | None = None,
    order: int = 8,
    max_step: float = 0.1,
    stop_time: float = 50.0,
) -> Component:
    """The filter for `model` as a component: measurements and known inputs in, `estimate.*` and `diagnostics.std.*` out.

    The arguments that all observers share are explained in `observers.ports`.

    Args:
        order: of the Runge-Kutta method that moves the points, 8 or 4: half the cost, at an error of up to 1e-4 a step.
        max_step: the longest prediction step [s]; shortened as `prediction_step` says.

    Raises:
        ModelError: algebraic variables or unknown disturbances, a state or unknown parameter that no output can ever see, a deviation of
            something that is not estimated or measured.
        ValueError: sample_time out of range, another order.
    """
    refuse(model, "ukf", "algebraic", "unknown_disturbances")
    count = len(model.states) + len(model.unknown_parameters)
    if count > MOST_ESTIMATED:
        raise ModelError(
            f"ukf: model '{model.name}' has {count} states and unknown parameters; the sigma points of more than "
            f"{MOST_ESTIMATED} would take longer than minutes to build: take riccati, which follows one point only"
        )
    refuse_tables_that_end(model, "ukf")
    refuse_unobservable(model, "ukf")
    period = ports.sample_time("ukf", sample_time)
    estimated = (*model.states, *model.unknown_parameters)
    tuning = (
        *ports.process_noise("ukf", model, process_noise, sample_time),
        *ports.deviations("ukf", "measurement_noise", ports.MEASUREMENT_NOISE, model.outputs, measurement_noise, 0.1),
        *ports.deviations("ukf", "initial_std", ports.INITIAL_STD, estimated, initial_std, 1.0, "fixed"),
        KAPPA,
        *TUNING,
    )
    tableau, step = chosen_step(model, free_motion(model, max_step), max_step, order)
    v = parts(model, measurement_noise is not None)
    made = Component(
        name=name or f"{model.name}_ukf",
        description=f"Square-root unscented Kalman filter for {model.name}",
        start=steps.start(v),
        flow=steps.flow(v, tableau),
        jump=steps.jump(v),
        output=steps.output(v),
        inputs=(*ports.inputs(model), *ports.validity(model)),
        parameters=(*ports.guesses(model, guess or {}), *ports.known_parameters(model), *tuning, period),
        outputs=(
            *ports.estimates(model),
            *ports.VERDICT,
            *ports.innovations(model),
            *ports.standard_deviations(model),
            *innovation_covariance(model),
            *ports.COUNTERS,
            ports.RESTARTS,
        ),
        sample_time="sample_time",
        samples_inputs=True,
        max_step=step,
        stop_time=stop_time,
        step_size=sample_time,
        counters=tuple(port.name for port in ports.COUNTERS),
        documentation=(
            f"<p>A square-root unscented Kalman filter for the model {model.name} (Julier and Uhlmann, Proc. IEEE 92 (3), 2004). "
            "<code>tuning.process_noise.*</code> says how fast each state or unknown parameter may wander away from the model: with 0 an "
            "unknown parameter freezes once it is believed. <code>diagnostics.std.*</code> is the estimate's own standard deviation.</p>"
            f"{not_imposed(model)}"
        ),
    )
    return with_linear_inputs(made, model, sample_time)
