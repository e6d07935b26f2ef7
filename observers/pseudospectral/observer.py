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
- Until the window is full it grows (Remark 3): the window starts at t0 with its final length, samples not yet taken weigh nothing.

What goes beyond it: windows of several segments, each with a polynomial of its own, whose cost grows with their number and not with its
cube; an arrival cost, by which samples that have left the window still count; algebraic variables (section 3.5) eliminated node by node.
Section 3.4's bounded noise is in `bounded_noise`, the arrival cost in `arrival`, the algorithm at one sample in `moving_horizon`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import casadi as ca
import numpy as np

from observers import ports
from observers.component import Component, Port
from observers.linearisation import refuse_unobservable
from observers.model import Model, ModelError, refuse
from observers.numerics import algebraic
from observers.numerics.equations import Equations
from observers.numerics.finite import HUGE
from observers.numerics.layout import Layout
from observers.numerics.runge_kutta import runge_kutta, stable_step
from observers.numerics.semilinear import Split, lift_inputs, split
from observers.pseudospectral import arrival, bounded_noise, memory, moving_horizon, warm_start
from observers.pseudospectral.method import Method
from observers.pseudospectral.ports import CODE, CONSTRAINT_VIOLATION, DIAGNOSTICS, QUALITY, REGULARITY_LIMIT, TUNING
from observers.pseudospectral.window.collocation import segment
from observers.pseudospectral.window.gauss_newton import Constraints
from observers.pseudospectral.window.pointwise import pointwise
from observers.pseudospectral.window.problem import LeastSquares

SMOOTHNESS = 2  # m of Assumption 2, for the bound (N - 1)^(3/2 - m)


def pseudospectral(
    model: Model,
    *,
    sample_time: float,
    N: int = 15,
    L: int = 8,
    segments: int = 1,
    cost: str = "samples",
    noise_bound: float | Mapping[str, float] | None = None,
    arrival_cost: bool = False,
    process_noise: Mapping[str, float] | None = None,
    measurement_noise: Mapping[str, float] | None = None,
    initial_std: Mapping[str, float] | None = None,
    guess: Mapping[str, float] | None = None,
    name: str | None = None,
    max_step: float = 0.1,
    stop_time: float = 50.0,
) -> Component:
    """The observer for `model` as a component: measurements and known inputs in, `estimate.*` out.

    Finite bounds of the model's states and unknown parameters (`Variable.min`, `max`) are constraints of the solve, (3) and (18).

    Args:
        sample_time: Ts [s]; structural, because the constants of the window hold delta = L Ts.
        N: order of a segment's polynomial (N + 1 nodes). L: length of the window in sample intervals.
        segments: number of equal segments that the window is made of; divides L. 1 is the paper's method.
        cost: "samples" sums the squared residuals at the sample instants, "spline" is the paper's quadrature (19) of a
            not-a-knot cubic spline through the samples at the nodes (it waits for a full window, as the paper does).
        noise_bound: start value of `tuning.noise_bound`, for all outputs or by name, in the outputs' units; with it the estimated
            output stays in the tube (38), which Problem 3 makes narrower. None: no tube.
        arrival_cost: whether samples that have left the window go on counting, through a quadratic cost of the window's
            first state; on a linear model the estimate is then the Kalman filter's.
        process_noise, measurement_noise, initial_std: with an arrival cost, start values of `tuning.process_noise.<state or unknown
            parameter>` (intensity in the variable's unit per sqrt(s), 0 if absent), `tuning.measurement_noise.<output>` (standard deviation
            of a sample, 0.1 of the nominal value) and `tuning.initial_std.<...>` (that of the guess, the nominal value).
        guess: start values of `guess.*` that differ from the model's.
        name: the component's name; `<model>_pseudospectral` if absent.
        max_step: the longest prediction step [s] (Dormand-Prince, order 8); shortened where the model's constant linear part is stiff.
        stop_time: of the default experiment [s].

    Raises:
        ModelError: unknown disturbances, a state or unknown parameter that no output can ever see, algebraic variables that do not act on
            the states, a noise bound of something that is no output.
        ValueError: N, L, segments or sample_time out of range, a window with fewer measurements than unknowns; an unknown cost, or one
            that does not go with segments or a noise bound.
    """
    refuse(model, "pseudospectral", "unknown_disturbances")
    _check_structure(model, sample_time, N, L, segments, cost, noise_bound is not None or arrival_cost)
    refuse_unobservable(model, "pseudospectral")
    eq = model.equations
    if model.algebraic and not ca.depends_on(eq.ode, eq.z):
        raise ModelError(
            f"pseudospectral: model '{model.name}' has algebraic variables that no state's equation contains: "
            "write their solution into the outputs"
        )
    tuning = (*TUNING, REGULARITY_LIMIT) if model.algebraic else TUNING
    bound_ports = bounded_noise.ports_of(model, noise_bound)
    arrival_ports = arrival.ports_of(model, arrival_cost, process_noise, measurement_noise, initial_std)
    lifted, lift = lift_inputs(eq)
    problem = _problem(model, lifted, N, L, segments, sample_time, cost)
    nx, ny, nu, nz = len(model.states), len(model.outputs), len(model.inputs), len(model.algebraic)
    settings = Layout(
        guess_x=nx,
        guess_z=nz,
        guess_theta=len(model.unknown_parameters),
        model=len(model.parameters),
        **{ports.last_name(port): 1 for port in tuning},
        noise_bound=ny if bound_ports.tuning else 0,
        bound_margin=1 if bound_ports.tuning else 0,
        **arrival.settings(model, arrival_cost),
    )
    method = Method(
        model=model,
        equations=lifted,
        lift=lift,
        problem=problem,
        settings=settings,
        constraints=_constraints(model, problem, bool(bound_ports.tuning)),
        spline=cost == "spline",
        arrival=arrival_cost,
    )
    state = memory.layout(method)
    z, u = ca.SX.sym("z", state.total), ca.SX.sym("u", 2 * ny + nu)
    p, t, h = ca.SX.sym("p", settings.total), ca.SX.sym("t"), ca.SX.sym("h")
    s, q = state.unpack(z), settings.unpack(p)
    known = u[ny : ny + nu] if nu else ca.SX(0, 1)

    motion = algebraic.motion(eq)
    moved = runge_kutta(lambda x, time: motion(x, known, q.model, s.theta, time, s.z)[0], s.x, t, h)
    moved_z, lost = algebraic.followed(eq, [v.nominal for v in model.algebraic])(
        moved, s.z, known, q.model, s.theta, t + h
    )
    sound = ca.logic_and(ca.sumsqr(ca.vertcat(moved, moved_z)) < HUGE, ca.logic_not(lost))
    after = {
        "x": ca.if_else(sound, moved, q.guess_x),
        "z": ca.if_else(sound, moved_z, q.guess_z),
        "theta": ca.if_else(sound, s.theta, q.guess_theta),
        "input_integral": s.input_integral + h * lift(known, q.model),
        "fresh": ca.if_else(sound, s.fresh, warm_start.AT_GUESS),
        "status": ca.if_else(sound, s.status, ca.if_else(lost, CODE.singular, CODE.solver_failed)),
        "failures": s.failures + ca.logic_not(sound),
    }
    start = {part: ca.DM.zeros(size) for part, size in state.sizes.items()} | {
        "x": q.guess_x,
        "z": q.guess_z,
        "theta": q.guess_theta,
        "x_filtered": q.guess_x,
        "z_filtered": q.guess_z,
        "theta_filtered": q.guess_theta,
        "fresh": ca.DM(warm_start.AT_PREDICTION),
        "status": ca.DM(CODE.propagated_guess),
        "model": q.model,
        **arrival.start(q, arrival_cost),
    }
    measured = [s.x, s.z, s.theta, s.x_filtered, s.z_filtered, s.theta_filtered, s.status, s.cost, s.iterations]
    measured += [s.innovation, s.conditioning, s.deviation, s.node0_residual, s.slack, s.bounds, s.rejected, s.failures]
    return Component(
        name=name or f"{model.name}_pseudospectral",
        description=(
            f"Pseudospectral moving-horizon observer for {model.name} (Gong, Ross & Kang 2007), "
            f"N = {N}, L = {L}, {f'{segments} segments, ' if segments > 1 else ''}Ts = {sample_time:g} s"
        ),
        start=ca.Function("start", [p, t], [state.pack(start)]),
        flow=ca.Function("flow", [z, u, p, t, h], [state.replace(z, **after)]),
        jump=moving_horizon.jump(method),
        output=ca.Function("output", [z, u, p, t], [ca.vertcat(*measured)]),
        inputs=(*ports.inputs(model), *ports.validity(model)),
        parameters=(
            *ports.guesses(model, guess or {}),
            *ports.known_parameters(model),
            *tuning,
            *bound_ports.tuning,
            *arrival_ports,
        ),
        outputs=(
            *ports.estimates(model),
            *DIAGNOSTICS,
            *ports.innovations(model),
            *QUALITY,
            *((CONSTRAINT_VIOLATION,) if method.constraints.any else ()),
            *bound_ports.diagnostics,
            *ports.COUNTERS,
        ),
        constants=_constants(N, L, segments, sample_time),
        sample_time=sample_time,
        samples_inputs=True,
        max_step=stable_step(problem.segment.split.A, max_step),
        stop_time=stop_time,
        step_size=sample_time,
        counters=tuple(port.name for port in ports.COUNTERS),
        documentation=_documentation(model, N, L, segments, sample_time, cost),
    )


def _check_structure(model: Model, sample_time: float, N: int, L: int, segments: int, cost: str, more: bool) -> None:
    least = (("N", N, 2), ("L", L, 3 if cost == "spline" else 1), ("segments", segments, 1))
    for name_of, value, lowest in least:
        if not isinstance(value, int) or value < lowest:
            raise ValueError(f"pseudospectral: {name_of} = {value!r} must be a whole number of at least {lowest}")
    if L % segments:
        raise ValueError(f"pseudospectral: segments = {segments} must divide L = {L}")
    unknowns = len(model.states) + len(model.unknown_parameters)
    if (L + 1) * len(model.outputs) < unknowns:
        raise ValueError(
            f"pseudospectral: L = {L} gives {(L + 1) * len(model.outputs)} measurements in a window, "
            f"too few for the {unknowns} states and unknown parameters of model '{model.name}'"
        )
    if not (math.isfinite(sample_time) and sample_time > 0):
        raise ValueError(f"pseudospectral: sample_time = {sample_time:g} must be positive")
    if cost not in ("samples", "spline"):
        raise ValueError(f"pseudospectral: cost = {cost!r} must be 'samples' or 'spline'")
    if cost == "spline" and (segments > 1 or more):
        raise ValueError("pseudospectral: the spline cost goes with one segment, without noise bound or arrival cost")


def _problem(model: Model, eq: Equations, N: int, L: int, segments: int, sample_time: float, cost: str) -> LeastSquares:
    """Problem 2's data: where the outputs are compared, and in which units steps are measured."""
    parts, output = (_with_algebraic(split(f, eq.x, eq.u), eq) for f in (eq.ode, eq.output))
    s = segment(parts, N, L // segments, sample_time, model.input_between_samples)
    nominal = np.array([v.nominal for v in (*model.states, *model.unknown_parameters)])
    z_scale = tuple(v.nominal for v in model.algebraic)
    bounded = [i for i, v in enumerate(model.states) if math.isfinite(v.min) or math.isfinite(v.max)]
    return LeastSquares(
        segment=s,
        count=segments,
        rates=pointwise(parts, eq, z_scale),
        output=output,
        output_rest=pointwise(output, eq, z_scale),
        points=s.node_times if cost == "spline" else np.arange(s.samples + 1) * sample_time,
        scale=nominal,
        rate_scale=2 / s.length * nominal[parts.rows],  # a rate's effect over half a segment, in the state's unit
        output_scale=np.array([v.nominal for v in model.outputs]),
        n_parameters=len(model.parameters),
        n_theta=len(model.unknown_parameters),
        bounded=tuple(bounded),
    )


def _with_algebraic(part: Split, eq: Equations) -> Split:
    """`part` with the states that its algebraic variables depend on among those that phi depends on."""
    if not (eq.z.numel() and part.phi.numel() and ca.depends_on(part.phi, eq.z)):
        return part
    everything = ca.vertcat(part.phi, eq.algebraic)
    states = [i for i, x in enumerate(ca.vertsplit(eq.x)) if ca.depends_on(everything, x)]
    return replace(part, states=states)


def _constraints(model: Model, problem: LeastSquares, tube: bool) -> Constraints:
    estimated = (*model.states, *model.unknown_parameters)
    states = [model.states[i] for i in problem.bounded]
    return Constraints(
        lower=np.array([v.min for v in estimated]),
        upper=np.array([v.max for v in estimated]),
        node_lower=np.array([v.min for v in states]),
        node_upper=np.array([v.max for v in states]),
        tube=tube,
    )


def _bound(N: int) -> float:
    """The right-hand side of (17), (20): (N - 1)^(3/2 - m)."""
    return float((N - 1) ** (1.5 - SMOOTHNESS))


def _constants(N: int, L: int, segments: int, sample_time: float) -> tuple[Port, ...]:
    def structure(name: str, text: str, value: int) -> Port:
        return Port(f"structure.{name}", text, start=value, kind="Integer", variability="constant", local=True)

    return (
        Port("sample_time", "sample time", "s", sample_time, variability="constant", local=True),
        structure("N", "order of the polynomial", N),
        structure("L", "length of the window in sample intervals", L),
        structure("segments", "segments of the window, each with a polynomial of its own", segments),
        Port(
            "diagnostics.node0_bound",
            "(N - 1)^(3/2 - m), m = 2: the bound on node0_residual",
            start=_bound(N),
            variability="constant",
            local=True,
        ),
    )


def _documentation(model: Model, N: int, L: int, segments: int, sample_time: float, cost: str) -> str:
    where = "at the sample instants" if cost == "samples" else "through a cubic spline at the nodes, as in the paper"
    shape = f"a polynomial of order {N}" if segments == 1 else f"{segments} polynomials of order {N}, end to end,"
    return (
        f"<p>At every sample instant the trajectory of the model {model.name} that fits the last {L + 1} samples best ({where}) is "
        f"computed as {shape} on Legendre-Gauss-Lobatto nodes (Gong, Ross and Kang, DCDS-B 8 (3), 2007). Its end is "
        "the estimate, which follows the model until the next sample. Connect the measurements and the known inputs, and step with at "
        f"most the sample time, {sample_time:g} s.</p>"
        "<p><code>diagnostics.status</code> says whether the estimate can be trusted; <code>estimate.*</code> is of the current time, "
        "<code>filtered.*</code> of the last sample instant. Where a sample has not arrived, set its <code>measurement_valid.*</code> "
        "to false for that step.</p>"
    )
