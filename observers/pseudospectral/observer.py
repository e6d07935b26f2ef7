"""The pseudospectral moving-horizon observer of Gong, Ross & Kang, "A pseudospectral observer for nonlinear systems", DCDS-B 8 (3), 2007.

At each sample instant t_k the trajectory over the window [t_k - L Ts, t_k] that fits the last L + 1 measurements best is found (Problem 2),
as a polynomial on N + 1 Legendre-Gauss-Lobatto nodes; its end is the estimate. Between samples the estimate follows the model.

What deviates from the paper, and why:
- (16) is imposed at the nodes 1..N. At all N + 1 it is overdetermined (D has rank N), and the relaxation (17) is far too loose (an error
  of 0.05 in theta). The residual of (16) at the dropped node 0 is an output, beside the bound of (17).
- Unknown parameters are constants of the window, not states with zero rates (34).
- The cost is summed at the sample instants (`cost="samples"`). The paper's spline through the samples, evaluated at the nodes, is there too
  (`cost="spline"`); its interpolation error is what limits the paper's accuracy.
- (19) prints z - y for h(z) - y.
- Instead of the paper's step 3 (propagate the guess), the first guess is flat: propagation over a long window can overflow.
- Until the window is full it grows (Remark 3): the window starts at t0 with its final length, samples not yet taken weigh nothing. Later
  `tuning.window_length` says how many of the newest samples count; the trajectory still begins L samples back.
- Section 3.1 warm starts with the covectors too (the covector mapping theorem). There are none here: the model's equations are
  eliminated, not multiplied, and what is subject to bounds is a small program in s that is solved anew. The warm start is the trajectory.

What goes beyond it: windows of several segments, each with a polynomial of its own, whose cost grows with their number and not with its
cube; an arrival cost, by which samples that have left the window still count; algebraic variables (section 3.5) eliminated node by node.
Section 3.4's bounded noise is in `bounded_noise`, the arrival cost in `arrival`, the algorithm at one sample in `moving_horizon`.
"""

from __future__ import annotations

from collections.abc import Mapping

from observers import ports
from observers.arguments import checked
from observers.component import Component
from observers.linear_inputs import with_linear_inputs
from observers.linearisation import prediction_step
from observers.model import Model
from observers.numerics.layout import Layout
from observers.numerics.semilinear import lift_inputs
from observers.pseudospectral import (
    arrival,
    bounded_noise,
    defaults,
    disturbances,
    memory,
    moving_horizon,
    prediction,
    structure,
)
from observers.pseudospectral.defaults import Structure
from observers.pseudospectral.method import Method
from observers.pseudospectral.ports import (
    CONSTRAINT_VIOLATION,
    DIAGNOSTICS,
    QUALITY,
    REGULARITY_LIMIT,
    constants,
    window_length,
)
from observers.pseudospectral.ports import constraints as path_values
from observers.pseudospectral.ports import tuning as tuning_of


@checked
def pseudospectral(
    model: Model,
    *,
    sample_time: float,
    N: int | None = None,
    L: int | None = None,
    segments: int | None = None,
    cost: str = "samples",
    noise_bound: float | Mapping[str, float] | None = None,
    arrival_cost: bool | None = None,
    process_noise: Mapping[str, float] | None = None,
    measurement_noise: Mapping[str, float] | None = None,
    initial_std: Mapping[str, float] | None = None,
    guess: Mapping[str, float] | None = None,
    name: str | None = None,
    max_step: float | None = None,
    stop_time: float = 50.0,
) -> Component:
    """The observer for `model` as a component: measurements and known inputs in, `estimate.*` out.

    Finite bounds of the model's states and unknown parameters (`Variable.min`, `max`), and the model's `constraints`, are constraints of
    the solve, (3) and (18): those at the nodes, these at the nodes and at the samples.

    Args:
        sample_time: Ts [s]; structural, because the constants of the window hold delta = L Ts.
        N: order of a segment's polynomial (N + 1 nodes). L: length of the window in sample intervals. segments: number of equal segments
            that the window is made of; divides L. Where none of them is given `defaults` chooses them by the model, with an arrival cost;
            where one is, the others are the paper's: 15, 8, 1.
        cost: "samples" sums the squared residuals at the sample instants, "spline" is the paper's quadrature (19) of a
            not-a-knot cubic spline through the samples at the nodes (it waits for a full window, as the paper does).
        noise_bound: start value of `tuning.noise_bound`, for all outputs or by name, in the outputs' units; with it the estimated
            output stays in the tube (38), which Problem 3 makes narrower. None: no tube.
        arrival_cost: whether samples that have left the window go on counting, through a quadratic cost of the window's
            first state; on a linear model with one segment a sample the estimate is then the Kalman filter's. None: where the structure is
            chosen by the model.
        process_noise: start values of `tuning.process_noise.<state, unknown parameter or unknown disturbance>`, intensities in the
            variable's unit per sqrt(s), so that its variance grows by their square per second; 0 if absent, the nominal value for an
            unknown disturbance. What is given more than 0 acts inside the window, constant over each segment (with a noise bound: in
            the arrival cost only). None: where the structure is chosen by the model `defaults` says what acts in the arrival cost.
        measurement_noise, initial_std: start values of `tuning.measurement_noise.<output>` (standard deviation of a sample; with an arrival
            cost or process noise 0.1 of the nominal value if absent) and, with an arrival cost, `tuning.initial_std.<...>` (that of the
            guess, the nominal value if absent).
        guess: start values of `guess.*` that differ from the model's.
        name: the component's name; `<model>_pseudospectral` if absent.
        max_step: the longest prediction step [s] (Dormand-Prince, order 8); shortened as `prediction_step` says. None: 0.1 s, or a tenth of
            a longer sample time.
        stop_time: of the default experiment [s].

    Raises:
        ModelError: a state or unknown parameter that no output can ever see, algebraic variables that do not act on the states or have
            bounds, a noise bound of something that is no output, or one beside process noise without an arrival cost.
        ValueError: N, L, segments or sample_time out of range, a window with fewer measurements than unknowns; an unknown cost, or one
            that does not go with segments or a noise bound.
    """
    structure.check_sample_time(sample_time)
    model, process_noise = disturbances.wandering(model, process_noise)
    chosen = defaults.structure(
        model,
        sample_time,
        {"N": N, "L": L, "segments": segments},
        arrival_cost,
        plain=cost != "samples" or noise_bound is not None,
    )
    N, L, segments, arrival_cost = chosen.N, chosen.L, chosen.segments, chosen.arrival
    noisy = structure.noisy(model, process_noise, noise_bound is not None, arrival_cost)
    if chosen.why and arrival_cost and process_noise is None:
        process_noise = defaults.process_noise(model, sample_time)
    more = noise_bound is not None or arrival_cost or any(noisy)
    structure.check(model, N, L, segments, cost, more)
    tuning = tuning_of(len(model.states) + len(model.unknown_parameters))
    tuning = (*tuning, REGULARITY_LIMIT) if model.algebraic else tuning
    # With an arrival cost what has left the window counts for good; the paper's spline wants all samples.
    window_tunable = not arrival_cost and cost == "samples"
    tuning = (*tuning, window_length(L)) if window_tunable else tuning
    tube = bounded_noise.ports_of(model, noise_bound)
    weighted = arrival_cost or any(noisy) or measurement_noise is not None
    given = arrival.Given(arrival_cost, weighted, process_noise, measurement_noise, initial_std)
    arrival_ports = arrival.ports_of(model, given)
    settings = Layout(
        guess_x=len(model.states),
        guess_z=len(model.algebraic),
        guess_theta=len(model.unknown_parameters),
        model=len(model.parameters),
        **{ports.last_name(port): 1 for port in tuning},
        **({} if window_tunable else {"window_length": 0}),
        noise_bound=len(model.outputs) if tube.tuning else 0,
        bound_margin=1 if tube.tuning else 0,
        **arrival.settings(model, given),
    )
    lifted, lift = lift_inputs(model.equations)
    problem = structure.problem(model, lifted, N, L, segments, sample_time, cost, noisy)
    constraints = structure.constraints(model, problem, bool(tube.tuning))
    method = Method(
        model,
        lifted,
        lift,
        problem,
        settings,
        constraints,
        spline=cost == "spline",
        arrival=arrival_cost,
        weighted=weighted,
        noise_given=measurement_noise is not None,
    )
    made = Component(
        name=name or f"{model.name}_pseudospectral",
        description=(
            f"Pseudospectral moving-horizon observer for {model.name} (Gong, Ross & Kang 2007), "
            f"N = {N}, L = {L}, {f'{segments} segments, ' if segments > 1 else ''}Ts = {sample_time:g} s{chosen.why}"
        ),
        start=memory.start(method),
        flow=prediction.flow(method),
        jump=moving_horizon.jump(method),
        output=memory.output(method),
        inputs=(*ports.inputs(model), *ports.validity(model)),
        parameters=(
            *ports.guesses(model, guess or {}),
            *ports.known_parameters(model),
            *tuning,
            *tube.tuning,
            *arrival_ports,
        ),
        outputs=(
            *ports.estimates(model),
            *DIAGNOSTICS,
            *ports.innovations(model),
            *ports.standard_deviations(model),
            *QUALITY,
            *((CONSTRAINT_VIOLATION,) if method.constraints.any else ()),
            *path_values(model),
            *tube.diagnostics,
            *ports.COUNTERS,
            ports.RESTARTS,
        ),
        constants=constants(N, L, segments, sample_time),
        sample_time=sample_time,
        samples_inputs=True,
        max_step=prediction_step(model, defaults.longest_step(sample_time) if max_step is None else max_step),
        stop_time=stop_time,
        step_size=sample_time,
        counters=tuple(port.name for port in ports.COUNTERS),
        documentation=_documentation(model, chosen, sample_time, cost),
    )
    return with_linear_inputs(made, model, sample_time)


def _documentation(model: Model, chosen: Structure, sample_time: float, cost: str) -> str:
    N, L, segments = chosen.N, chosen.L, chosen.segments
    where = "at the sample instants" if cost == "samples" else "through a cubic spline at the nodes, as in the paper"
    names = ", ".join(v.name for v in model.constraints)
    imposed = f"<p>At the nodes and at the samples the fit obeys the constraints {names}.</p>" if names else ""
    shape = f"a polynomial of order {N}" if segments == 1 else f"{segments} polynomials of order {N}, end to end,"
    return (
        f"<p>At every sample instant the trajectory of the model {model.name} that fits the last {L + 1} samples best ({where}) is "
        f"computed as {shape} on Legendre-Gauss-Lobatto nodes (Gong, Ross and Kang, DCDS-B 8 (3), 2007). Its end is "
        "the estimate, which follows the model until the next sample. Connect the measurements and the known inputs, and step with at "
        f"most the sample time, {sample_time:g} s.</p>"
        "<p><code>diagnostics.status</code> says whether the estimate can be trusted; <code>estimate.*</code> is of the current time, "
        "<code>filtered.*</code> of the last sample instant. Where a sample has not arrived, set its <code>measurement_valid.*</code> "
        "to false for that step.</p>"
        f"{imposed}"
    )
