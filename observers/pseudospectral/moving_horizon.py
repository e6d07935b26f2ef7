"""The main algorithm of section 3.1 of Gong, Ross & Kang 2007 at one sample instant: see `pseudospectral.py`."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from observers.numerics import algebraic
from observers.numerics.finite import HUGE
from observers.numerics.layout import Layout
from observers.pseudospectral import arrival, bounded_noise
from observers.pseudospectral.method import Method
from observers.pseudospectral.ports import CODE
from observers.pseudospectral.window import lgl, trajectory
from observers.pseudospectral.window.condense import output_residual
from observers.pseudospectral.window.gauss_newton import Solve
from observers.pseudospectral.window.iteration import iterate
from observers.pseudospectral.window.problem import known_terms
from observers.pseudospectral.window.sliding import insert_input, insert_sample
from observers.pseudospectral.window.spline import spline_matrix

WARM, AT_PREDICTION, AT_GUESS = 0, 1, 2  # where a solve starts from
VIOLATED = 1e-6  # slack beyond which the constraints contradict each other, in nominal units


def state(method: Method) -> Layout:
    """The observer's state from sample to sample."""
    problem, nu, L = method.problem, method.equations.u.numel(), method.samples
    nx, nz, ny, nt = problem.nx, len(method.model.algebraic), problem.ny, problem.n_theta
    held = problem.segment.input_kind == "held"
    return Layout(
        x=nx,  # the prediction: the estimate of the current time
        z=nz,
        theta=nt,
        x_filtered=nx,  # the estimate of the last sample instant
        z_filtered=nz,
        theta_filtered=nt,
        y=ny * (L + 1),  # the window's samples, oldest first, and their weights: 0 = not taken yet, or rejected
        weight=ny * (L + 1),
        u=nu * (L + (not held)),  # its known inputs: means over the intervals (held), or values at the samples (linear)
        seen=nu * (L + 1) if method.sees_inputs else 0,  # and their values at the samples, where the outputs see them
        input_integral=nu,  # since the last sample
        V=problem.count
        * problem.n_rates,  # the window's trajectory: rates and algebraic variables at the nodes, first state
        Z=problem.count * problem.n_algebraic,
        x0=nx,
        **arrival.state(method.model, method.arrival),
        **bounded_noise.state(method.model, method.constraints, L),
        innovation=ny,
        model=len(method.model.parameters),  # model parameters at the last sample
        k=1,  # samples so far
        fresh=1,  # where the next solve starts from: WARM, AT_PREDICTION, AT_GUESS
        changed=1,  # samples until a changed model parameter has left the window
        status=1,
        cost=1,
        iterations=1,
        conditioning=1,
        deviation=1,
        node0_residual=1,
        slack=int(method.constraints.any),
        rejected=1,
        failures=1,
    )


def jump(method: Method) -> ca.Function:
    """jump(z, u, p, t) -> z at a sample instant; u = [measurements, known inputs, whether each measurement is valid]."""
    problem, model, eq, L = method.problem, method.model, method.equations, method.samples
    s_window, settings, layout = problem.segment, method.settings, state(method)
    nx, ny, nu, nt, Ts = problem.nx, problem.ny, eq.u.numel(), problem.n_theta, s_window.sample_time
    n_known = len(model.inputs)
    held = s_window.input_kind == "held"
    z, u, p, t = (
        ca.MX.sym(*shape) for shape in (("z", layout.total), ("u", 2 * ny + n_known), ("p", settings.total), ("t",))
    )
    s, q = layout.unpack(z), settings.unpack(p)
    known = method.lift(u[ny : ny + n_known] if nu else ca.MX(0, 1), q.model)
    motion, measure = algebraic.motion(eq), algebraic.measurement(eq)

    # Steps 1, 2: collect the measurement. A rejected one weighs nothing and never enters the window.
    finite = ca.fabs(u[:ny]) <= HUGE  # false for NaN
    offered = u[ny + n_known :] > 0.5
    valid = ca.logic_and(finite, offered)
    y = ca.if_else(valid, u[:ny], 0)
    moving = s.k > L
    place = ca.fmin(s.k, L)
    Y, W = (insert_sample(ny, L + 1)(column, new, s.k) for column, new in ((s.y, y), (s.weight, valid)))
    U = insert_input(nu, L, held)(s.u, s.input_integral / Ts if held else known, known, s.k)
    start_time = t - place * Ts
    seen = insert_input(nu, L, False)(s.seen, known, known, s.k) if method.sees_inputs else ca.MX(0, 1)
    if method.spline:
        at_points = ca.MX(ca.DM(np.kron(s_window.inputs_at(problem.points), np.eye(nu)))) @ U if nu else ca.MX(0, 1)
    else:
        at_points = seen if method.sees_inputs else ca.MX(ca.DM.zeros(nu * (L + 1)))
    data = known_terms(problem)(start_time, U, at_points, q.model)
    innovation = ca.if_else(valid, u[:ny] - measure(s.x, known, q.model, s.theta, t, s.z)[0], 0)

    # Steps 5, 6 of the last sample, now that the input since then is known: the warm start.
    # A solve that failed is followed by one from a flat trajectory at the prediction, a second one by one at the guess.
    at_prediction = ca.logic_and(moving, s.fresh < AT_GUESS)
    flat_x = ca.if_else(at_prediction, s.x, q.guess_x)
    flat_z = ca.if_else(at_prediction, s.z, q.guess_z)[: problem.rates.n_algebraic]
    flat = trajectory.flat(problem)(flat_x, flat_z, known)
    last_input = U[U.numel() - nu :] if nu else known
    z_now = s.z[: problem.rates.n_algebraic]
    moved = trajectory.shift(problem, eq)(
        s.V, s.Z, s.x0, s.u, s.x_filtered, s.x, z_now, s.theta, q.model, data, last_input, t
    )
    whole = ca.sumsqr(ca.vertcat(s.V, s.x0, *moved)) < HUGE
    fresh = ca.fmax(s.fresh, AT_PREDICTION * ca.logic_not(whole))
    V, Z, x0 = (
        ca.if_else(fresh > WARM, f, ca.if_else(moving, m, old))
        for f, m, old in zip(flat, moved, (s.V, s.Z, s.x0), strict=True)
    )
    active = ca.MX(1)
    if problem.count > 1:
        # A segment without a sample yet waits, flat at the prediction.
        active = ca.vertcat(1, place > ca.DM(range(1, problem.count)) * s_window.samples)
        ahead = trajectory.flat(problem)(s.x, z_now, known)
        V = _where_active(active, problem.n_rates, V, ahead[0])
        Z = _where_active(active, problem.n_algebraic, Z, ahead[1])
    from_guess = ca.logic_or(s.fresh == AT_GUESS, ca.logic_and(fresh > WARM, ca.logic_not(moving)))
    unknown = ca.vertcat(x0, ca.if_else(from_guess, q.guess_theta, s.theta))

    # Step 3: Problem 2.
    if method.spline:
        spline = spline_matrix(L, s_window.node_times / Ts)
        along = trajectory.outputs_at_samples(problem, measure)(V, Z, x0, s.theta, q.model, U, start_time)
        compared = ca.MX(ca.DM(np.kron(spline, np.eye(ny)))) @ ca.if_else(W, Y, along)
        point_weight = ca.MX(ca.DM(np.repeat(lgl.weights(s_window.order) * s_window.length / 2, ny)))
        # The trajectory stands in for rejected samples, but a flat first guess is no data.
        enough = ca.logic_and(s.k >= L, ca.logic_or(ca.sum1(W) == ny * (L + 1), fresh == WARM))
    else:
        compared, point_weight = Y, Ts * W
        enough = ca.sum1(W) >= (1 if method.arrival else nx + nt)
    if method.arrival:
        weight = ca.repmat(1 / q.measurement_noise**2, problem.n_measured, 1) * point_weight
    else:
        weight = ca.DM(np.tile(1 / problem.output_scale**2, problem.n_measured)) * point_weight
    residual = output_residual(problem)(V, Z, unknown, data, q.model, compared)
    before = ca.dot(weight, residual**2)
    wanted = ca.logic_and(enough, ca.sum1(valid) > 0)
    given = {"data": data, "p": q.model, "y": compared, "w": weight, "lam": q.regularisation, "active": active}
    given |= arrival.given(method.arrival, s, problem.scale, Ts)
    bounds: dict[str, Any] = {}
    if method.constraints.tube:
        bounds = bounded_noise.bounds(method, s, q, (V, Z, unknown), given, residual, valid, y, W, place, fresh == WARM)
        given |= {"lower": bounds["lower"], "upper": bounds["upper"], "mask": W}
    below = ca.logic_and(before < q.cost_threshold, fresh == WARM)
    due = ca.logic_and(wanted, ca.logic_not(below))
    problem_2 = Solve(problem, method.constraints, method.arrival)
    solve = iterate(problem_2)
    limits = [q.tolerance, q.iteration_limit]
    found: Any = solve(due, V, Z, unknown, *limits, *[given[name] for name in problem_2.given])
    if method.constraints.tube:
        # Bounds that contradict each other have gone wrong somewhere: all of them start again from y +- b.
        *_, slack, _ = found
        contradiction = ca.logic_and(due, ca.logic_not(slack <= VIOLATED))
        bounds = bounded_noise.released(method, q, bounds, compared, y, contradiction)
        given |= {"lower": bounds["lower"], "upper": bounds["upper"]}
        again = solve(contradiction, V, Z, unknown, *limits, *[given[name] for name in problem_2.given])
        found = [ca.if_else(contradiction, b, a) for a, b in zip(found, again, strict=True)]
    V_new, Z_new, unknown_new, size, cost_after, conditioning, spread, slack, iterations = found
    sound = ca.sumsqr(ca.vertcat(V_new, Z_new, unknown_new)) < HUGE
    converged = ca.logic_and(ca.logic_and(due, sound), size < q.tolerance**2)
    # With an arrival cost the past decides what the window leaves open.
    determined = 1 if method.arrival else conditioning > q.conditioning_limit
    accepted = ca.logic_and(converged, determined)
    failed = ca.logic_and(due, ca.logic_not(converged))
    kept = ca.logic_and(wanted, ca.logic_not(due))

    # The estimate of t_k, or the prediction where there is none.
    V, Z, unknown = (ca.if_else(accepted, new, old) for new, old in ((V_new, V), (Z_new, Z), (unknown_new, unknown)))
    fitted = Layout(x0=nx, theta=nt).unpack(unknown)
    x0 = fitted.x0
    x_fitted, z_near = trajectory.state_at(problem)(place, V, Z, x0, U)
    x = ca.if_else(accepted, x_fitted, s.x)
    theta = ca.if_else(accepted, fitted.theta, s.theta)
    x_algebraic = motion(
        x, known, q.model, theta, t, ca.if_else(accepted, z_near, s.z) if problem.n_algebraic else s.z
    )[1]
    node0, regularity = trajectory.node0(problem)(
        V, Z, x0, theta, q.model, start_time, U, *([active] if problem.count > 1 else [])
    )
    cost_now = ca.if_else(accepted, cost_after, ca.if_else(enough, before, 0))

    changed = ca.if_else(
        ca.logic_and(s.k > 0, ca.sumsqr(q.model - s.model) > 0) if len(model.parameters) else 0,
        L,
        ca.fmax(s.changed - 1, 0),
    )
    rms = ca.sqrt(cost_now / ca.fmax(ca.sum1(point_weight), Ts))
    # The samples' noise is what the fit leaves, or what tuning says of it.
    redundancy = ca.fmax(ca.sum1(W) - nx - nt, 1)
    variance = spread * (Ts if method.arrival else cost_after / redundancy)
    deviation = ca.if_else(accepted, ca.sqrt(ca.fmax(variance, 0)), s.deviation)
    status = ca.if_else(moving + (s.k == L), CODE.converged, CODE.growing_window)
    for condition, code in (
        (kept, CODE.prediction_kept),
        (ca.sum1(valid) < ny, CODE.sample_rejected),
        (node0 > q.collocation_limit, CODE.coarse_collocation),
        (changed > 0, CODE.parameter_changed),
        (deviation > q.deviation_limit, CODE.uncertain),
        (rms > q.residual_limit, CODE.inconsistent),
        (slack > VIOLATED, CODE.inconsistent),
        (ca.logic_and(converged, ca.logic_not(determined)), CODE.undetermined),
        (failed, CODE.solver_failed),
        (regularity < q.regularity_limit if model.algebraic else 0, CODE.singular),
        (ca.logic_not(enough), CODE.propagated_guess),
        (ca.sum1(valid) == 0, CODE.sample_rejected),
    ):
        status = ca.if_else(condition, code, status)

    absent = {name: ca.DM(0, 1) for name, size in layout.sizes.items() if size == 0}
    result = absent | {
        "x": x,
        "z": x_algebraic,
        "theta": theta,
        "x_filtered": x,
        "z_filtered": x_algebraic,
        "theta_filtered": theta,
        "y": Y,
        "weight": W,
        "u": U,
        "seen": seen,
        "input_integral": ca.DM.zeros(nu),
        "V": V,
        "Z": Z,
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
        "deviation": deviation,
        "node0_residual": node0,
        "rejected": s.rejected + (ca.sum1(ca.logic_and(offered, ca.logic_not(finite))) > 0),
        "failures": s.failures + failed,
        "slack": slack if method.constraints.any else ca.DM(0, 1),
    }
    if method.arrival:
        result |= arrival.advance(method, s, q, (V, Z, unknown), data, Y[:ny], W[:ny], (U, at_points), start_time)
    if method.constraints.tube:
        result |= bounds
    return ca.Function("jump", [z, u, p, t], [layout.pack(result)])


def _where_active(active: Any, each: int, now: Any, flat: Any) -> Any:
    if each == 0:
        return now
    mask = ca.vec(ca.repmat(active.T, each, 1))
    return ca.if_else(mask, now, flat)
