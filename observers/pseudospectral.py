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
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from observers import layout as lay
from observers.component import Component, Enumeration, Port
from observers.model import Model, ModelError, Variable, refuse
from observers.numerics import gauss_newton, lgl
from observers.numerics.collocation import Window, window
from observers.numerics.pointwise import Pointwise, pointwise
from observers.numerics.runge_kutta import CLASSICAL_4, runge_kutta
from observers.numerics.semilinear import split, unreachable
from observers.numerics.spline import spline_matrix

MOST_ITERATIONS = 40
HUGE = 1e150  # |measurement| beyond: not finite; its square still is a number
SMOOTHNESS = 2  # m of Assumption 2, for the bound (N - 1)^(3/2 - m)

STATUS = Enumeration(
    "PseudospectralStatus",
    (
        ("propagated_guess", "too few samples yet: the estimate is the propagated guess"),
        ("growing_window", "the window is not full yet: the estimate rests on fewer samples"),
        ("converged", "the estimate fits a full window"),
        ("prediction_kept", "the prediction's cost lies below tuning.cost_threshold: no solve was needed"),
        (
            "sample_rejected",
            "a measurement was not finite: the estimate is the prediction, or rests on the other outputs",
        ),
        ("solver_failed", "Gauss-Newton did not converge: the estimate is the prediction"),
        ("undetermined", "the window does not determine the state: the estimate is the prediction"),
        ("coarse_collocation", "the residual at node 0 exceeds its bound: N is too small for the window"),
        ("parameter_changed", "a model parameter was changed within the window: its older samples obey the old value"),
        (
            "inconsistent",
            "the rms output residual exceeds tuning.residual_limit: the window's samples do not fit the model",
        ),
    ),
)
CODE = SimpleNamespace(**{item: i for i, (item, _) in enumerate(STATUS.items, start=1)})


def pseudospectral(
    model: Model,
    *,
    sample_time: float,
    N: int = 15,
    L: int = 8,
    cost: str = "samples",
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
        name: the component's name; `<model>_pseudospectral` if absent.
        max_step: the longest prediction step [s] (Dormand-Prince, order 8).
        stop_time: of the default experiment [s].

    Raises:
        ModelError: algebraic variables or unknown disturbances, a state or unknown parameter that no output can ever see.
        ValueError: N, L or sample_time out of range; an unknown cost.
    """
    refuse(model, "pseudospectral", "algebraic", "unknown_disturbances")
    if N < 2 or L < 1 or (cost == "spline" and L < 3):
        raise ValueError(
            f"pseudospectral: N = {N} must be at least 2 and L = {L} at least {3 if cost == 'spline' else 1}"
        )
    if not (math.isfinite(sample_time) and sample_time > 0):
        raise ValueError(f"pseudospectral: sample_time = {sample_time:g} must be positive")
    if cost not in ("samples", "spline"):
        raise ValueError(f"pseudospectral: cost = {cost!r} must be 'samples' or 'spline'")
    eq = model.equations
    unseen = unreachable(eq.ode, eq.output, ca.vertcat(eq.x, eq.theta), eq.x)
    if unseen:
        names = ", ".join(
            [*(v.name for v in model.states), *(v.name for v in model.unknown_parameters)][i] for i in unseen
        )
        raise ModelError(f"pseudospectral: model '{model.name}' is not observable: no output ever sees {names}")

    parts = split(eq.ode, eq.x, eq.u)
    w = window(parts, N, L, sample_time, model.input_between_samples)
    problem = _problem(model, w, pointwise(parts, eq), cost)
    ports = _ports(model)
    jump, state = _jump(model, problem, ports, cost)
    nx, ny = len(model.states), len(model.outputs)
    z, u = ca.SX.sym("z", state.total), ca.SX.sym("u", len(ports.inputs))
    p, t, h = ca.SX.sym("p", len(ports.parameters)), ca.SX.sym("t"), ca.SX.sym("h")
    s, q = state.unpack(z), ports.unpack(p)
    known = u[ny:] if len(model.inputs) else ca.SX(0, 1)

    rhs = ca.Function("rhs", [eq.x, eq.u, eq.p, eq.theta, eq.t], [eq.ode])
    moved = runge_kutta(lambda x, time: rhs(x, known, q.model, s.theta, time), s.x, t, h)
    start = {part: ca.DM.zeros(size) for part, size in state.sizes.items()} | {
        "x": q.guess[:nx],
        "theta": q.guess[nx:],
        "x_filtered": q.guess[:nx],
        "theta_filtered": q.guess[nx:],
        "fresh": ca.DM(1),
        "status": ca.DM(CODE.propagated_guess),
        "model": q.model,
    }
    measured = [s.x, s.theta, s.x_filtered, s.theta_filtered, s.status, s.cost, s.iterations, s.innovation]
    measured += [s.conditioning, s.node0_residual, s.rejected, s.failures]
    return Component(
        name=name or f"{model.name}_pseudospectral",
        description=f"Pseudospectral moving-horizon observer for {model.name} (Gong, Ross & Kang 2007), N = {N}, L = {L}, Ts = {sample_time:g} s",
        start=ca.Function("start", [p, t], [state.pack(start)]),
        flow=ca.Function(
            "flow", [z, u, p, t, h], [state.replace(z, x=moved, input_integral=s.input_integral + h * known)]
        ),
        jump=jump,
        output=ca.Function("output", [z, u, p, t], [ca.vertcat(*measured)]),
        inputs=ports.inputs,
        parameters=ports.parameters,
        outputs=ports.outputs,
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
        max_step=max_step,
        stop_time=stop_time,
        step_size=sample_time,
        counters=("diagnostics.rejected_samples", "diagnostics.solver_failures"),
        documentation=_documentation(model, N, L, sample_time, cost),
    )


def _bound(N: int) -> float:
    """The right-hand side of (17), (20): (N - 1)^(3/2 - m)."""
    return float((N - 1) ** (1.5 - SMOOTHNESS))


def _problem(model: Model, w: Window, rates: Pointwise, cost: str) -> gauss_newton.LeastSquares:
    """Problem 2's data: where the outputs are compared, and in which units steps are measured."""
    eq = model.equations
    output = split(eq.output, eq.x, eq.u)
    nominal = np.array([v.nominal for v in (*model.states, *model.unknown_parameters)])
    return gauss_newton.LeastSquares(
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
    model: Model, problem: gauss_newton.LeastSquares, ports: SimpleNamespace, cost: str
) -> tuple[ca.Function, lay.Layout]:
    """The main algorithm of section 3.1 at one sample instant, and the layout of the state it works on."""
    w, eq = problem.window, model.equations
    nx, ny, nu, nt, L = problem.nx, problem.ny, len(model.inputs), problem.n_theta, w.samples
    held = w.input_kind == "held"
    state = lay.Layout(
        x=nx,  # the prediction: the estimate of the current time
        theta=nt,
        x_filtered=nx,  # the estimate of the last sample instant
        theta_filtered=nt,
        y=ny * (L + 1),  # the window's samples, oldest first, and their weights: 0 = not taken yet, or rejected
        weight=ny * (L + 1),
        u=nu * (L + (not held)),  # its known inputs: means over the intervals (held), or values at the samples (linear)
        input_integral=nu,  # since the last sample
        V=problem.n_rates,  # the window's trajectory: rates at the nodes and first state
        x0=nx,
        innovation=ny,
        model=len(model.parameters),  # model parameters at the last sample
        k=1,  # samples so far
        fresh=1,  # 1: the next solve starts from the flat guess
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
        ca.MX.sym(*shape) for shape in (("z", state.total), ("u", ny + nu), ("p", len(ports.parameters)), ("t",))
    )
    s, q = state.unpack(z), ports.unpack(p)
    known = u[ny:] if nu else ca.MX(0, 1)

    # Steps 1, 2: collect the measurement. A rejected one weighs nothing and never enters the window.
    valid = ca.fabs(u[:ny]) <= HUGE  # false for NaN
    y = ca.if_else(valid, u[:ny], 0)
    moving = s.k > L
    place = ca.fmin(s.k, L)
    Y, W = (_insert(ny, L + 1)(column, new, s.k) for column, new in ((s.y, y), (s.weight, valid)))
    U = _inputs(nu, L, held)(s.u, s.input_integral / w.sample_time if held else known, known, s.k)
    start_time = t - place * w.sample_time
    known_terms, lengths = gauss_newton.known_terms(problem)
    data = known_terms(start_time, U, q.model)

    predicted = ca.Function("predicted", [eq.x, eq.u, eq.p, eq.theta, eq.t], [eq.output])(
        s.x, known, q.model, s.theta, t
    )
    innovation = ca.if_else(valid, u[:ny] - predicted, 0)

    # Steps 5, 6 of the last sample, now that the input since then is known: the warm start.
    fresh = ca.logic_or(s.fresh, ca.logic_not(ca.sumsqr(ca.vertcat(s.V, s.x0)) < HUGE))
    flat_state = ca.if_else(moving, s.x, q.guess[:nx])
    flat = _flat(w, problem.rates.n)(flat_state, known)
    interval_input = U[U.numel() - nu :]
    moved = _shift(problem, lengths, rhs=_rhs(model))(
        s.V,
        s.x0,
        s.u,
        s.x_filtered,
        s.x,
        s.theta,
        q.model,
        data,
        interval_input,
        known if not held else interval_input,
        t,
    )
    V, x0 = (
        ca.if_else(fresh, f, ca.if_else(moving, m, old)) for f, m, old in zip(flat, moved, (s.V, s.x0), strict=True)
    )
    unknown = ca.vertcat(x0, ca.if_else(ca.logic_and(fresh, ca.logic_not(moving)), q.guess[nx:], s.theta))

    # Step 3: Problem 2.
    if cost == "spline":
        spline = spline_matrix(L, w.node_times / w.sample_time)
        filled = ca.if_else(W, Y, _outputs_at_samples(model, w)(V, x0, s.theta, q.model, U, start_time))
        compared = ca.MX(ca.DM(np.kron(spline, np.eye(ny)))) @ filled
        point_weight = ca.MX(ca.DM(np.repeat(lgl.weights(w.order) * w.length / 2, ny)))
        enough = ca.logic_and(s.k >= L, ca.sum1(W) >= nx + nt)
    else:
        compared, point_weight = Y, w.sample_time * W
        enough = ca.sum1(W) >= nx + nt
    residual = gauss_newton.output_residual(problem, lengths)(V, unknown, data, q.model, compared)
    before = ca.dot(point_weight, residual**2)
    wanted = ca.logic_and(enough, ca.sum1(valid) > 0)
    solve = ca.logic_and(wanted, ca.logic_or(before > q.cost_threshold, fresh))
    found = _solve(problem, lengths)(
        solve, V, unknown, data, q.model, compared, point_weight, q.regularisation, q.tolerance, q.iteration_limit
    )
    V_new, unknown_new, size, cost_after, conditioning, iterations = found
    converged = ca.logic_and(solve, size < q.tolerance**2)
    determined = conditioning > q.conditioning_limit
    accepted = ca.logic_and(converged, determined)
    failed = ca.logic_and(solve, ca.logic_not(converged))
    kept = ca.logic_and(wanted, ca.logic_not(solve))

    # The estimate of t_k, or the prediction where there is none.
    V, unknown = ca.if_else(accepted, V_new, V), ca.if_else(accepted, unknown_new, unknown)
    x0, theta_fit = unknown[:nx], unknown[nx:]
    x_fit = _state_at(w)(place, V, x0, U)
    x, theta = ca.if_else(accepted, x_fit, s.x), ca.if_else(accepted, theta_fit, s.theta)
    node0 = _node0(problem, model)(V, x0, theta, q.model, start_time, U)
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
        (node0 > _bound(w.order), CODE.coarse_collocation),
        (changed > 0, CODE.parameter_changed),
        (rms > q.residual_limit, CODE.inconsistent),
        (ca.logic_and(converged, ca.logic_not(determined)), CODE.undetermined),
        (failed, CODE.solver_failed),
        (ca.logic_not(enough), CODE.propagated_guess),
        (ca.sum1(valid) < ny, CODE.sample_rejected),
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
            "input_integral": ca.DM.zeros(nu),
            "V": V,
            "x0": x0,
            "innovation": innovation,
            "model": q.model,
            "k": s.k + 1,
            "fresh": ca.if_else(accepted, 0, ca.if_else(failed, 1, fresh)),
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


def _solve(problem: gauss_newton.LeastSquares, lengths: list[int]) -> ca.Function:
    """Function solve(go, V, s, data, p, y, w, lam, tol, limit) -> (V, s, size, cost, conditioning, iterations): full Gauss-Newton steps.

    Iterates while the scaled step exceeds `tol`, stays finite, and fewer than `limit` steps are done; the last step is applied, so that an
    error of tol before it is one of about tol^2 after. A line search on a merit function solved fewer cold starts.
    """
    newton = gauss_newton.newton_step(problem, lengths)
    V, s, data, p, y, w, lam = (ca.MX.sym(newton.name_in(i), newton.numel_in(i)) for i in range(newton.n_in()))
    go, tolerance, limit = ca.MX.sym("go"), ca.MX.sym("tolerance"), ca.MX.sym("limit")
    state = lay.Layout(V=V.numel(), s=s.numel(), size=1, cost=1, conditioning=1, iterations=1)
    fixed = [data, p, y, w, lam]
    now = ca.MX.sym("now", state.total)
    parts = state.unpack(now)
    V_next, s_next, size, cost, conditioning = newton(parts.V, parts.s, *fixed)
    after = {
        "V": V_next,
        "s": s_next,
        "size": size,
        "cost": cost,
        "conditioning": conditioning,
        "iterations": parts.iterations + 1,
    }
    once = ca.Function("iterate", [now, *fixed], [state.pack(after)])
    stay = ca.Function("stay", [now, *fixed], [now])
    maybe = ca.Function.if_else("maybe_iterate", once, stay)

    def chain(value: Any, count: int) -> Any:
        for _ in range(count):
            part = state.unpack(value)
            # NaN fails every comparison, which ends the loop.
            unfinished = (part.size >= tolerance**2) * (part.size < HUGE) * (part.iterations < limit)
            value = maybe(unfinished, value, *fixed)
        return value

    # Most samples need one or two steps: the long tail of the chain is jumped over as a whole.
    short = 3
    tail = ca.Function("tail", [now, *fixed, tolerance, limit], [chain(now, MOST_ITERATIONS - short)])
    no_tail = ca.Function("no_tail", [now, *fixed, tolerance, limit], [now])
    first = {"V": V, "s": s, "size": ca.if_else(go, HUGE / 2, 0), "cost": 0, "conditioning": 0, "iterations": 0}
    value = chain(state.pack(first), short)
    part = state.unpack(value)
    unfinished = (part.size >= tolerance**2) * (part.size < HUGE) * (part.iterations < limit)
    value = ca.Function.if_else("maybe_tail", tail, no_tail)(unfinished, value, *fixed, tolerance, limit)
    part = state.unpack(value)
    return ca.Function(
        "solve",
        [go, V, s, *fixed, tolerance, limit],
        [part.V, part.s, part.size, part.cost, part.conditioning, part.iterations],
    )


def _insert(ny: int, count: int) -> ca.Function:
    """insert(column, new, k): a window of `count` samples with the k-th one put in place, or moved up by one and the new one at its end."""
    column, new, k = ca.SX.sym("column", ny * count), ca.SX.sym("new", ny), ca.SX.sym("k")
    moving = k > count - 1
    rows = []
    for i in range(count):
        here = column[i * ny : (i + 1) * ny]
        following = column[(i + 1) * ny : (i + 2) * ny] if i + 1 < count else new
        rows.append(ca.if_else(moving, following, ca.if_else(k == i, new, here)))
    return ca.Function("insert", [column, new, k], [ca.vertcat(*rows)])


def _inputs(nu: int, L: int, held: bool) -> ca.Function:
    """inputs(window, last, now, k): the known inputs of the new window; what lies ahead is held at its present value.

    `last` is the mean over the last interval (held) or the present value (linear).
    """
    count = L if held else L + 1
    column, last, now, k = ca.SX.sym("window", nu * count), ca.SX.sym("last", nu), ca.SX.sym("now", nu), ca.SX.sym("k")
    newest = k - 1 if held else k
    rows = []
    for i in range(count):
        here = column[i * nu : (i + 1) * nu]
        following = column[(i + 1) * nu : (i + 2) * nu] if i + 1 < count else last
        filling = ca.if_else(newest == i, last, ca.if_else(newest < i, now, here))
        rows.append(ca.if_else(k > L, following, filling))
    return ca.Function("inputs", [column, last, now, k], [ca.vertcat(*rows)])


def _flat(w: Window, nv: int) -> ca.Function:
    """flat(x, u) -> (V, x0): rates under which the states with nonlinear equations stay at x over the window."""
    parts = w.split
    x, u = ca.SX.sym("x", len(parts.A)), ca.SX.sym("u", parts.B.shape[1])
    rate = -ca.mtimes(ca.DM(parts.E.T), ca.mtimes(ca.DM(parts.A), x) + ca.mtimes(ca.DM(parts.B), u))
    return ca.Function("flat", [x, u], [ca.repmat(rate, w.order, 1) if nv else ca.SX(0, 1), x])


def _rhs(model: Model) -> ca.Function:
    eq = model.equations
    return ca.Function("rhs", [eq.x, eq.u, eq.p, eq.theta, eq.t], [eq.ode])


def _shift(problem: gauss_newton.LeastSquares, lengths: list[int], rhs: ca.Function) -> ca.Function:
    """shift(V, x0, U_old, x_last, x_now, theta, p, data, u, u_end, t) -> (V, x0) of the window moved on by one sample.

    Inside the old window its polynomial is evaluated at the new nodes; beyond its end a Runge-Kutta chain from the last estimate runs from
    node to node, and the last node is the prediction. `data` belongs to the new window; `u` is the input over the last interval.
    """
    w, rates = problem.window, problem.rates
    nx, nq, ne, N = problem.nx, rates.n_states, rates.n_known, w.order
    kind = ca.SX if problem.is_small else ca.MX
    V, x0, U, x_last, x_now = (
        kind.sym(*shape)
        for shape in (
            ("V", problem.n_rates),
            ("x0", nx),
            ("U", w.inputs_at(w.node_times).shape[1] * w.split.B.shape[1]),
            ("x_last", nx),
            ("x_now", nx),
        )
    )
    theta, p, data = (
        kind.sym("theta", problem.n_theta),
        kind.sym("p", problem.n_parameters),
        kind.sym("data", sum(lengths)),
    )
    u, u_end, t = kind.sym("u", w.split.B.shape[1]), kind.sym("u_end", w.split.B.shape[1]), kind.sym("t")

    def old_window(times: np.ndarray, states: list[int] | None) -> Any:
        Ph, Ps, Xi = w.at(times, states)
        total = ca.mtimes(kind(ca.DM(Ph)), x0) + ca.mtimes(kind(ca.DM(Ps)), V)
        return total + ca.mtimes(kind(ca.DM(Xi)), U) if Xi.any() else total

    times = w.node_times[1:] + w.sample_time  # since the old window's start
    inside = [float(time) for time in times if time <= w.length * (1 + 1e-12)]
    states = [old_window(np.array(inside), w.split.states)] if inside else []
    x, since = x_last, 0.0
    for time in times[len(inside) : -1]:
        ahead = float(time) - w.length
        x = runge_kutta(lambda a, b: rhs(a, u, p, theta, b), x, t - w.sample_time + since, ahead - since, CLASSICAL_4)
        states.append(x[w.split.states] if nq else kind(0, 1))
        since = ahead
    states.append(x_now[w.split.states] if nq else kind(0, 1))
    xq = ca.vertcat(*states)
    e = data[lengths[0] : lengths[0] + lengths[1]]
    V_new = (
        [rates.value(xq[j * nq : (j + 1) * nq], e[j * ne : (j + 1) * ne], p, theta)[0] for j in range(N)]
        if rates.n
        else []
    )
    arguments = [V, x0, U, x_last, x_now, theta, p, data, u, u_end, t]
    return ca.Function(
        "shift", arguments, [ca.vertcat(*V_new) if V_new else kind(0, 1), old_window(np.array([w.sample_time]), None)]
    )


def _outputs_at_samples(model: Model, w: Window) -> ca.Function:
    """outputs(V, x0, theta, p, U, t_start) -> h along the window's trajectory at its sample instants, stacked: stands in for rejected samples."""
    eq = model.equations
    times = np.arange(w.samples + 1) * w.sample_time
    Ph, Ps, Xi = w.at(times)
    at = w.inputs_at(times)
    nx, nu = len(w.split.A), w.split.B.shape[1]
    V, x0, U = ca.MX.sym("V", Ps.shape[1]), ca.MX.sym("x0", nx), ca.MX.sym("U", at.shape[1] * nu)
    t = ca.MX.sym("t")
    theta, p = ca.MX.sym("theta", eq.theta.numel()), ca.MX.sym("p", eq.p.numel())
    measure = ca.Function("measure", [eq.x, eq.u, eq.p, eq.theta, eq.t], [eq.output])
    X = ca.DM(Ph) @ x0 + ca.DM(Ps) @ V + ca.DM(Xi) @ U
    u = ca.DM(np.kron(at, np.eye(nu))) @ U if nu else ca.MX(0, 1)
    values = [
        measure(X[i * nx : (i + 1) * nx], u[i * nu : (i + 1) * nu], p, theta, t + float(time))
        for i, time in enumerate(times)
    ]
    return ca.Function("outputs", [V, x0, theta, p, U, t], [ca.vertcat(*values)])


def _state_at(w: Window) -> ca.Function:
    """state(place, V, x0, U) -> x at the window's sample instant `place`; its end as one product, another one by its index."""
    nx, L = len(w.split.A), w.samples
    Ph, Ps, Xi = w.at(np.arange(L + 1) * w.sample_time)
    place, V, x0, U = ca.MX.sym("place"), ca.MX.sym("V", Ps.shape[1]), ca.MX.sym("x0", nx), ca.MX.sym("U", Xi.shape[1])

    def states(rows: slice) -> Any:
        return ca.DM(Ph[rows]) @ x0 + ca.DM(Ps[rows]) @ V + ca.DM(Xi[rows]) @ U

    arguments = [place, V, x0, U]
    end = ca.Function("end", arguments, [states(slice(L * nx, None))])
    chosen = ca.reshape(states(slice(0, None)), nx, L + 1) @ (ca.DM(range(L + 1)) == place)
    somewhere = ca.Function("somewhere", arguments, [chosen])
    return ca.Function("state", arguments, [ca.Function.if_else("at", end, somewhere)(place == L, *arguments)])


def _node0(problem: gauss_newton.LeastSquares, model: Model) -> ca.Function:
    """node0(V, x0, theta, p, t_start, U) -> the largest residual of (16) at node 0, in units of the states' nominal values."""
    w, rates = problem.window, problem.rates
    R0, RV = w.node0
    at = w.inputs_at(np.zeros(1))
    nu = w.split.B.shape[1]
    V, x0, t = ca.SX.sym("V", problem.n_rates), ca.SX.sym("x0", problem.nx), ca.SX.sym("t")
    theta, p = ca.SX.sym("theta", problem.n_theta), ca.SX.sym("p", problem.n_parameters)
    U = ca.SX.sym("U", at.shape[1] * nu)
    u = ca.mtimes(ca.DM(np.kron(at, np.eye(nu))), U)
    phi = rates.value(x0[w.split.states] if w.split.states else ca.SX(0, 1), rates.known(t, u, p), p, theta)[0]
    residual = ca.mtimes(ca.DM(R0), x0) + ca.mtimes(ca.DM(RV), V) - w.length / 2 * ca.mtimes(ca.DM(w.split.E), phi)
    largest = ca.mmax(ca.fabs(residual / ca.DM(problem.scale[: problem.nx])))
    return ca.Function("node0", [V, x0, theta, p, t, U], [largest])


def _ports(model: Model) -> SimpleNamespace:
    """Inputs, parameters and outputs of the observer, and `unpack(p)` that names the parts of the parameter vector."""
    estimated = (*model.states, *model.unknown_parameters)

    def like(prefix: str, v: Variable, text: str, variability: str, bounded: bool = False) -> Port:
        bounds = {"min": v.min, "max": v.max} if bounded else {}
        return Port(
            f"{prefix}.{v.name}",
            f"{text} {v.description or v.name}",
            v.unit,
            v.start,
            v.nominal,
            **bounds,
            variability=variability,
        )

    inputs = tuple(
        Port(v.name, f"{text} {v.description or v.name}", v.unit, v.start, v.nominal)
        for text, group in (("measured", model.outputs), ("known input:", model.inputs))
        for v in group
    )
    guesses = tuple(like("guess", v, "first guess of the", "fixed", bounded=True) for v in estimated)
    models = tuple(like("model", v, "", "tunable", bounded=True) for v in model.parameters)
    tuning = (
        Port(
            "tuning.tolerance",
            "scaled step below which Gauss-Newton stops; large: one iteration a sample",
            start=1e-5,
            min=1e-14,
            variability="tunable",
        ),
        Port(
            "tuning.iteration_limit",
            "iterations a sample after which a solve has failed",
            start=MOST_ITERATIONS,
            min=1,
            max=MOST_ITERATIONS,
            kind="Integer",
            variability="tunable",
        ),
        Port(
            "tuning.regularisation",
            "damping of the step, relative to nominal values; it does not bias the solution",
            start=1e-14,
            min=0.0,
            variability="tunable",
        ),
        Port(
            "tuning.cost_threshold",
            "cost of the prediction below which no solve is done",
            min=0.0,
            variability="tunable",
        ),
        Port(
            "tuning.conditioning_limit",
            "conditioning at or below which the window does not determine the state",
            start=1e-7,
            min=0.0,
            max=1.0,
            variability="tunable",
        ),
        Port(
            "tuning.residual_limit",
            "rms output residual above which the status is inconsistent",
            start=1e30,
            min=0.0,
            variability="tunable",
        ),
    )
    innovations = (
        [f"diagnostics.innovation[{i}]" for i in range(1, len(model.outputs) + 1)]
        if len(model.outputs) > 1
        else ["diagnostics.innovation"]
    )
    outputs = (
        *(like("estimate", v, "estimated current", "continuous") for v in estimated),
        *(like("filtered", v, "estimate at the last sample instant of the", "discrete") for v in estimated),
        Port(
            "diagnostics.status",
            "can the estimate be trusted?",
            start=1,
            kind="Enumeration",
            enumeration=STATUS,
            variability="discrete",
        ),
        Port("diagnostics.cost", "integral of the squared output residual over the window", variability="discrete"),
        Port(
            "diagnostics.iterations",
            "Gauss-Newton iterations at the last sample",
            kind="Integer",
            variability="discrete",
        ),
        *(
            Port(
                name,
                f"measured minus predicted {v.description or v.name}",
                v.unit,
                nominal=v.nominal,
                variability="discrete",
            )
            for name, v in zip(innovations, model.outputs, strict=True)
        ),
        Port(
            "diagnostics.conditioning",
            "smallest over largest pivot of the normal matrix; near 0: not determined",
            variability="discrete",
        ),
        Port(
            "diagnostics.node0_residual", "collocation residual at the dropped node 0, scaled", variability="discrete"
        ),
        Port("diagnostics.rejected_samples", "samples rejected so far", kind="Integer", variability="discrete"),
        Port("diagnostics.solver_failures", "solves that failed so far", kind="Integer", variability="discrete"),
    )

    def unpack(p: Any) -> SimpleNamespace:
        g, m = len(guesses), len(models)
        values = {port.name.split(".")[1]: p[g + m + i] for i, port in enumerate(tuning)}
        return SimpleNamespace(guess=p[:g], model=p[g : g + m], **values)

    return SimpleNamespace(inputs=inputs, parameters=(*guesses, *models, *tuning), outputs=outputs, unpack=unpack)


def _documentation(model: Model, N: int, L: int, sample_time: float, cost: str) -> str:
    where = "at the sample instants" if cost == "samples" else "through a cubic spline at the nodes, as in the paper"
    return (
        f"<p>At every sample instant the trajectory of the model {model.name} that fits the last {L + 1} samples best ({where}) is computed as a "
        f"polynomial of order {N} on Legendre-Gauss-Lobatto nodes (Gong, Ross and Kang, DCDS-B 8 (3), 2007). Its end is the estimate, which follows "
        f"the model until the next sample. Connect the measurements and the known inputs, and step with at most the sample time, {sample_time:g} s.</p>"
        "<p><code>diagnostics.status</code> says whether the estimate can be trusted; <code>estimate.*</code> is of the current time, "
        "<code>filtered.*</code> of the last sample instant.</p>"
    )
