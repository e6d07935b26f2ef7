"""A window's trajectory: where it starts from, how it moves on with the window, and what is read from it."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from observers.numerics.collocation import Window
from observers.numerics.least_squares import LeastSquares
from observers.numerics.runge_kutta import CLASSICAL_4, runge_kutta


def flat(w: Window, nv: int) -> ca.Function:
    """flat(x, u) -> (V, x0): rates under which the states with nonlinear equations stay at x over the window."""
    parts = w.split
    x, u = ca.SX.sym("x", len(parts.A)), ca.SX.sym("u", parts.B.shape[1])
    rate = -ca.mtimes(ca.DM(parts.E.T), ca.mtimes(ca.DM(parts.A), x) + ca.mtimes(ca.DM(parts.B), u))
    return ca.Function("flat", [x, u], [ca.repmat(rate, w.order, 1) if nv else ca.SX(0, 1), x])


def shift(problem: LeastSquares, rhs: ca.Function) -> ca.Function:
    """shift(V, x0, U_old, x_last, x_now, theta, p, data, u, t) -> (V, x0) of the window moved on by one sample.

    Inside the old window its polynomial is evaluated at the new nodes; beyond its end a Runge-Kutta chain from the last estimate runs from
    node to node, and the last node is the prediction. `data` belongs to the new window; `u` is the input over the last interval.
    """
    w, rates = problem.window, problem.rates
    nx, nq, ne, N = problem.nx, rates.n_states, rates.n_known, w.order
    kind: Any = ca.SX if problem.is_small else ca.MX
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
        kind.sym("data", sum(problem.lengths)),
    )
    u, t = kind.sym("u", w.split.B.shape[1]), kind.sym("t")

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
    e = data[problem.lengths[0] : sum(problem.lengths[:2])]
    V_new = (
        [rates.value(xq[j * nq : (j + 1) * nq], e[j * ne : (j + 1) * ne], p, theta)[0] for j in range(N)]
        if rates.n
        else []
    )
    arguments = [V, x0, U, x_last, x_now, theta, p, data, u, t]
    return ca.Function(
        "shift", arguments, [ca.vertcat(*V_new) if V_new else kind(0, 1), old_window(np.array([w.sample_time]), None)]
    )


def outputs_at_samples(w: Window, measure: ca.Function) -> ca.Function:
    """outputs(V, x0, theta, p, U, t_start) -> h along the window's trajectory at its sample instants, stacked.

    They stand in for rejected samples, where a spline needs all of them.
    """
    times = np.arange(w.samples + 1) * w.sample_time
    Ph, Ps, Xi = w.at(times)
    at = w.inputs_at(times)
    nx, nu = len(w.split.A), w.split.B.shape[1]
    V, x0, U = ca.MX.sym("V", Ps.shape[1]), ca.MX.sym("x0", nx), ca.MX.sym("U", at.shape[1] * nu)
    t = ca.MX.sym("t")
    theta, p = ca.MX.sym("theta", measure.numel_in(3)), ca.MX.sym("p", measure.numel_in(2))
    X = ca.DM(Ph) @ x0 + ca.DM(Ps) @ V + ca.DM(Xi) @ U
    u = ca.DM(np.kron(at, np.eye(nu))) @ U if nu else ca.MX(0, 1)
    values = [
        measure(X[i * nx : (i + 1) * nx], u[i * nu : (i + 1) * nu], p, theta, t + float(time))
        for i, time in enumerate(times)
    ]
    return ca.Function("outputs", [V, x0, theta, p, U, t], [ca.vertcat(*values)])


def state_at(w: Window) -> ca.Function:
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


def node0(problem: LeastSquares) -> ca.Function:
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
