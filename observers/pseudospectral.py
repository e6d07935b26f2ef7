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
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import casadi as ca
import numpy as np

from observers import ports
from observers.component import Component, Port
from observers.linearisation import refuse_unobservable
from observers.model import Model, refuse
from observers.numerics import lgl, trajectory
from observers.numerics.collocation import Window, window
from observers.numerics.equations import Equations
from observers.numerics.gauss_newton import output_residual
from observers.numerics.iteration import HUGE, solve
from observers.numerics.layout import Layout
from observers.numerics.least_squares import LeastSquares, known_terms
from observers.numerics.pointwise import Pointwise, pointwise
from observers.numerics.runge_kutta import runge_kutta, stable_step
from observers.numerics.semilinear import lift_inputs, split
from observers.numerics.sliding import insert_input, insert_sample
from observers.numerics.spline import spline_matrix
from observers.pseudospectral_ports import CODE, DIAGNOSTICS, QUALITY, TUNING

WARM, AT_PREDICTION, AT_GUESS = 0, 1, 2  # where a solve starts from
SMOOTHNESS = 2  # m of Assumption 2, for the bound (N - 1)^(3/2 - m)


def pseudospectral(
    model: Model,
    *,
    sample_time: float,
    N: int = 15,
    L: int = 8,
    cost: str = "samples",
    guess: Mapping[str, float] | None = None,
    name: str | None = None,
    max_step: float = 0.1,
    stop_time: float = 50.0,
) -> Component:
    """The observer for `model` as a component: measurements and known inputs in, `estimate.*` out.

    Args:
        sample_time: Ts [s]; structural, because the constants of the window hold delta = L Ts.
        N: order of the polynomial (N + 1 nodes). L: length of the window in sample intervals.
        cost: "samples" sums the squared residuals at the sample instants, "spline" is the paper's quadrature (19) of a
            not-a-knot cubic spline through the samples at the nodes (it waits for a full window, as the paper does).
        guess: start values of `guess.*` that differ from the model's.
        name: the component's name; `<model>_pseudospectral` if absent.
        max_step: the longest prediction step [s] (Dormand-Prince, order 8); shortened where the model's constant linear part is stiff.
        stop_time: of the default experiment [s].

    Raises:
        ModelError: algebraic variables or unknown disturbances, a state or unknown parameter that no output can ever see.
        ValueError: N, L or sample_time out of range, a window with fewer measurements than unknowns; an unknown cost.
    """
    refuse(model, "pseudospectral", "algebraic", "unknown_disturbances")
    for name_of, value, least in (("N", N, 2), ("L", L, 3 if cost == "spline" else 1)):
        if not isinstance(value, int) or value < least:
            raise ValueError(f"pseudospectral: {name_of} = {value!r} must be a whole number of at least {least}")
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
    eq = model.equations
    refuse_unobservable(model, "pseudospectral")

    lifted, lift = lift_inputs(eq)
    parts = split(lifted.ode, lifted.x, lifted.u)
    w = window(parts, N, L, sample_time, model.input_between_samples)
    problem = _problem(model, lifted, w, pointwise(parts, lifted), cost)
    nx, ny = len(model.states), len(model.outputs)
    settings = Layout(
        guess_x=nx,
        guess_theta=len(model.unknown_parameters),
        model=len(model.parameters),
        **{ports.last_name(port): 1 for port in TUNING},
    )
    jump, state = _jump(model, lifted, lift, problem, settings, cost)
    z, u = ca.SX.sym("z", state.total), ca.SX.sym("u", ny + len(model.inputs))
    p, t, h = ca.SX.sym("p", settings.total), ca.SX.sym("t"), ca.SX.sym("h")
    s, q = state.unpack(z), settings.unpack(p)
    known = u[ny:] if len(model.inputs) else ca.SX(0, 1)

    rhs = ca.Function("rhs", [eq.x, eq.u, eq.p, eq.theta, eq.t], [eq.ode])
    moved = runge_kutta(lambda x, time: rhs(x, known, q.model, s.theta, time), s.x, t, h)
    sound = ca.sumsqr(moved) < HUGE
    after = {
        "x": ca.if_else(sound, moved, q.guess_x),
        "theta": ca.if_else(sound, s.theta, q.guess_theta),
        "input_integral": s.input_integral + h * lift(known, q.model),
        "fresh": ca.if_else(sound, s.fresh, AT_GUESS),
        "status": ca.if_else(sound, s.status, CODE.solver_failed),
        "failures": s.failures + ca.logic_not(sound),
    }
    start = {part: ca.DM.zeros(size) for part, size in state.sizes.items()} | {
        "x": q.guess_x,
        "theta": q.guess_theta,
        "x_filtered": q.guess_x,
        "theta_filtered": q.guess_theta,
        "fresh": ca.DM(AT_PREDICTION),
        "status": ca.DM(CODE.propagated_guess),
        "model": q.model,
    }
    measured = [s.x, s.theta, s.x_filtered, s.theta_filtered, s.status, s.cost, s.iterations, s.innovation]
    measured += [s.conditioning, s.node0_residual, s.rejected, s.failures]
    return Component(
        name=name or f"{model.name}_pseudospectral",
        description=(
            f"Pseudospectral moving-horizon observer for {model.name} (Gong, Ross & Kang 2007), "
            f"N = {N}, L = {L}, Ts = {sample_time:g} s"
        ),
        start=ca.Function("start", [p, t], [state.pack(start)]),
        flow=ca.Function("flow", [z, u, p, t, h], [state.replace(z, **after)]),
        jump=jump,
        output=ca.Function("output", [z, u, p, t], [ca.vertcat(*measured)]),
        inputs=ports.inputs(model),
        parameters=(*ports.guesses(model, guess or {}), *ports.known_parameters(model), *TUNING),
        outputs=(*ports.estimates(model), *DIAGNOSTICS, *ports.innovations(model), *QUALITY, *ports.COUNTERS),
        constants=(
            Port("sample_time", "sample time", "s", sample_time, variability="constant", local=True),
            Port("structure.N", "order of the polynomial", start=N, kind="Integer", variability="constant", local=True),
            Port(
                "structure.L",
                "length of the window in sample intervals",
                start=L,
                kind="Integer",
                variability="constant",
                local=True,
            ),
            Port(
                "diagnostics.node0_bound",
                "(N - 1)^(3/2 - m), m = 2: the bound on node0_residual",
                start=_bound(N),
                variability="constant",
                local=True,
            ),
        ),
        sample_time=sample_time,
        samples_inputs=True,
        max_step=stable_step(parts.A, max_step),
        stop_time=stop_time,
        step_size=sample_time,
        counters=tuple(port.name for port in ports.COUNTERS),
        documentation=_documentation(model, N, L, sample_time, cost),
    )


def _bound(N: int) -> float:
    """The right-hand side of (17), (20): (N - 1)^(3/2 - m)."""
    return float((N - 1) ** (1.5 - SMOOTHNESS))


def _sees_inputs(model: Model) -> bool:
    eq = model.equations
    return bool(ca.depends_on(eq.output, eq.u)) if model.inputs else False


def _problem(model: Model, eq: Equations, w: Window, rates: Pointwise, cost: str) -> LeastSquares:
    """Problem 2's data: where the outputs are compared, and in which units steps are measured."""
    output = split(eq.output, eq.x, eq.u)
    nominal = np.array([v.nominal for v in (*model.states, *model.unknown_parameters)])
    return LeastSquares(
        window=w,
        rates=rates,
        output=output,
        output_rest=pointwise(output, eq),
        points=w.node_times if cost == "spline" else np.arange(w.samples + 1) * w.sample_time,
        scale=nominal,
        rate_scale=2 / w.length * nominal[w.split.rows],  # a rate's effect over half a window, in the state's unit
        n_parameters=len(model.parameters),
        n_theta=len(model.unknown_parameters),
    )


def _jump(
    model: Model, eq: Equations, lift: ca.Function, problem: LeastSquares, settings: Layout, cost: str
) -> tuple[ca.Function, Layout]:
    """The main algorithm of section 3.1 at one sample instant, and the layout of the state it works on."""
    w = problem.window
    nx, ny, nu, nt, L = problem.nx, problem.ny, eq.u.numel(), problem.n_theta, w.samples
    held = w.input_kind == "held"
    state = Layout(
        x=nx,  # the prediction: the estimate of the current time
        theta=nt,
        x_filtered=nx,  # the estimate of the last sample instant
        theta_filtered=nt,
        y=ny * (L + 1),  # the window's samples, oldest first, and their weights: 0 = not taken yet, or rejected
        weight=ny * (L + 1),
        u=nu * (L + (not held)),  # its known inputs: means over the intervals (held), or values at the samples (linear)
        seen=nu * (L + 1) if _sees_inputs(model) else 0,  # and their values at the samples, where the outputs see them
        input_integral=nu,  # since the last sample
        V=problem.n_rates,  # the window's trajectory: rates at the nodes and first state
        x0=nx,
        innovation=ny,
        model=len(model.parameters),  # model parameters at the last sample
        k=1,  # samples so far
        fresh=1,  # where the next solve starts from: WARM, AT_PREDICTION, AT_GUESS
        changed=1,  # samples until a changed model parameter has left the window
        status=1,
        cost=1,
        iterations=1,
        conditioning=1,
        node0_residual=1,
        rejected=1,
        failures=1,
    )
    z, u, p, t = (
        ca.MX.sym(*shape)
        for shape in (("z", state.total), ("u", ny + len(model.inputs)), ("p", settings.total), ("t",))
    )
    s, q = state.unpack(z), settings.unpack(p)
    known = lift(u[ny:] if nu else ca.MX(0, 1), q.model)

    # Steps 1, 2: collect the measurement. A rejected one weighs nothing and never enters the window.
    valid = ca.fabs(u[:ny]) <= HUGE  # false for NaN
    y = ca.if_else(valid, u[:ny], 0)
    moving = s.k > L
    place = ca.fmin(s.k, L)
    Y, W = (insert_sample(ny, L + 1)(column, new, s.k) for column, new in ((s.y, y), (s.weight, valid)))
    U = insert_input(nu, L, held)(s.u, s.input_integral / w.sample_time if held else known, known, s.k)
    start_time = t - place * w.sample_time
    seen = insert_input(nu, L, False)(s.seen, known, known, s.k) if _sees_inputs(model) else ca.MX(0, 1)
    if cost == "spline":
        at_points = ca.MX(ca.DM(np.kron(w.inputs_at(problem.points), np.eye(nu)))) @ U if nu else ca.MX(0, 1)
    else:
        at_points = seen if _sees_inputs(model) else ca.MX(ca.DM.zeros(nu * (L + 1)))
    data = known_terms(problem)(start_time, U, at_points, q.model)
    measure = ca.Function("measure", [eq.x, eq.u, eq.p, eq.theta, eq.t], [eq.output])
    innovation = ca.if_else(valid, u[:ny] - measure(s.x, known, q.model, s.theta, t), 0)

    # Steps 5, 6 of the last sample, now that the input since then is known: the warm start.
    # A solve that failed is followed by one from a flat trajectory at the prediction, a second one by one at the guess.
    flat_state = ca.if_else(ca.logic_and(moving, s.fresh < AT_GUESS), s.x, q.guess_x)
    flat = trajectory.flat(w, problem.rates.n)(flat_state, known)
    last_input = U[U.numel() - nu :] if nu else known
    rhs = ca.Function("rhs", [eq.x, eq.u, eq.p, eq.theta, eq.t], [eq.ode])
    moved = trajectory.shift(problem, rhs)(s.V, s.x0, s.u, s.x_filtered, s.x, s.theta, q.model, data, last_input, t)
    fresh = ca.fmax(s.fresh, AT_PREDICTION * ca.logic_not(ca.sumsqr(ca.vertcat(s.V, s.x0, *moved)) < HUGE))
    V, x0 = (
        ca.if_else(fresh > WARM, f, ca.if_else(moving, m, old))
        for f, m, old in zip(flat, moved, (s.V, s.x0), strict=True)
    )
    from_guess = ca.logic_or(s.fresh == AT_GUESS, ca.logic_and(fresh > WARM, ca.logic_not(moving)))
    unknown = ca.vertcat(x0, ca.if_else(from_guess, q.guess_theta, s.theta))

    # Step 3: Problem 2.
    if cost == "spline":
        spline = spline_matrix(L, w.node_times / w.sample_time)
        filled = ca.if_else(W, Y, trajectory.outputs_at_samples(w, measure)(V, x0, s.theta, q.model, U, start_time))
        compared = ca.MX(ca.DM(np.kron(spline, np.eye(ny)))) @ filled
        point_weight = ca.MX(ca.DM(np.repeat(lgl.weights(w.order) * w.length / 2, ny)))
        # The trajectory stands in for rejected samples, but a flat first guess is no data.
        enough = ca.logic_and(s.k >= L, ca.logic_or(ca.sum1(W) == ny * (L + 1), fresh == WARM))
    else:
        compared, point_weight = Y, w.sample_time * W
        enough = ca.sum1(W) >= nx + nt
    residual = output_residual(problem)(V, unknown, data, q.model, compared)
    units = ca.DM(np.tile([1 / v.nominal**2 for v in model.outputs], len(problem.points)))
    scaled_weight = units * point_weight
    before = ca.dot(scaled_weight, residual**2)
    wanted = ca.logic_and(enough, ca.sum1(valid) > 0)
    due = ca.logic_and(wanted, ca.logic_or(ca.logic_not(before < q.cost_threshold), fresh > WARM))
    found = solve(problem)(
        due, V, unknown, data, q.model, compared, scaled_weight, q.regularisation, q.tolerance, q.iteration_limit
    )
    V_new, unknown_new, size, cost_after, conditioning, iterations = found
    finite = ca.sumsqr(ca.vertcat(V_new, unknown_new)) < HUGE
    converged = ca.logic_and(ca.logic_and(due, finite), size < q.tolerance**2)
    determined = conditioning > q.conditioning_limit
    accepted = ca.logic_and(converged, determined)
    failed = ca.logic_and(due, ca.logic_not(converged))
    kept = ca.logic_and(wanted, ca.logic_not(due))

    # The estimate of t_k, or the prediction where there is none.
    V, unknown = ca.if_else(accepted, V_new, V), ca.if_else(accepted, unknown_new, unknown)
    fitted = Layout(x0=nx, theta=nt).unpack(unknown)
    x0 = fitted.x0
    x = ca.if_else(accepted, trajectory.state_at(w)(place, V, x0, U), s.x)
    theta = ca.if_else(accepted, fitted.theta, s.theta)
    node0 = trajectory.node0(problem)(V, x0, theta, q.model, start_time, U)
    cost_now = ca.if_else(accepted, cost_after, ca.if_else(enough, before, 0))

    changed = ca.if_else(
        ca.logic_and(s.k > 0, ca.sumsqr(q.model - s.model) > 0) if len(model.parameters) else 0,
        L,
        ca.fmax(s.changed - 1, 0),
    )
    rms = ca.sqrt(cost_now / ca.fmax(ca.sum1(point_weight), w.sample_time))
    status = ca.if_else(moving + (s.k == L), CODE.converged, CODE.growing_window)
    for condition, code in (
        (kept, CODE.prediction_kept),
        (ca.sum1(valid) < ny, CODE.sample_rejected),
        (node0 > q.collocation_limit, CODE.coarse_collocation),
        (changed > 0, CODE.parameter_changed),
        (rms > q.residual_limit, CODE.inconsistent),
        (ca.logic_and(converged, ca.logic_not(determined)), CODE.undetermined),
        (failed, CODE.solver_failed),
        (ca.logic_not(enough), CODE.propagated_guess),
        (ca.sum1(valid) == 0, CODE.sample_rejected),
    ):
        status = ca.if_else(condition, code, status)

    result = state.pack(
        {
            "x": x,
            "theta": theta,
            "x_filtered": x,
            "theta_filtered": theta,
            "y": Y,
            "weight": W,
            "u": U,
            "seen": seen,
            "input_integral": ca.DM.zeros(nu),
            "V": V,
            "x0": x0,
            "innovation": innovation,
            "model": q.model,
            "k": s.k + 1,
            "fresh": ca.if_else(
                accepted, WARM, ca.if_else(failed, ca.if_else(s.fresh == AT_PREDICTION, AT_GUESS, AT_PREDICTION), fresh)
            ),
            "changed": changed,
            "status": status,
            "cost": cost_now,
            "iterations": iterations,
            "conditioning": conditioning,
            "node0_residual": node0,
            "rejected": s.rejected + (ca.sum1(valid) < ny),
            "failures": s.failures + failed,
        }
    )
    return ca.Function("jump", [z, u, p, t], [result]), state


def _documentation(model: Model, N: int, L: int, sample_time: float, cost: str) -> str:
    where = "at the sample instants" if cost == "samples" else "through a cubic spline at the nodes, as in the paper"
    return (
        f"<p>At every sample instant the trajectory of the model {model.name} that fits the last {L + 1} samples best ({where}) is "
        f"computed as a polynomial of order {N} on Legendre-Gauss-Lobatto nodes (Gong, Ross and Kang, DCDS-B 8 (3), 2007). Its end is "
        "the estimate, which follows the model until the next sample. Connect the measurements and the known inputs, and step with at "
        f"most the sample time, {sample_time:g} s.</p>"
        "<p><code>diagnostics.status</code> says whether the estimate can be trusted; <code>estimate.*</code> is of the current time, "
        "<code>filtered.*</code> of the last sample instant.</p>"
    )
