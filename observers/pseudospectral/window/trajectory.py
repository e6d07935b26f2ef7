"""A window's trajectory: where it starts from, how it moves on with the window, and what is read from it.

It is held by V, the rates at the nodes, Z, the algebraic variables there, segment by segment, and the window's first state x0. U is what
drives it, `LeastSquares.driven`: the window's inputs, and process noise on the rates where there is some.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from observers.numerics import algebraic, tiles
from observers.numerics.equations import Equations
from observers.numerics.runge_kutta import CLASSICAL_4, runge_kutta
from observers.pseudospectral.window.problem import LeastSquares


class Trajectory(NamedTuple):
    """V, Z and s = [x0; theta] of a whole window: x0 its first state, theta the unknown parameters; and the segments' process noise
    (none without), in units of its standard deviation. With noise on theta it is that of the first segment."""

    V: Any
    Z: Any
    s: Any
    noise: Any


def flat(problem: LeastSquares) -> ca.Function:
    """flat(x, z, u) -> (V, Z, x0): rates under which the states with nonlinear equations stay at x over the window."""
    parts, each = problem.segment.split, problem.segment.order * problem.count
    x, u = ca.SX.sym("x", problem.nx), ca.SX.sym("u", problem.nu)
    z = ca.SX.sym("z", problem.rates.n_algebraic)
    rate = -ca.mtimes(ca.DM(parts.E.T), ca.mtimes(ca.DM(parts.A), x) + ca.mtimes(ca.DM(parts.B), u))
    V = ca.repmat(rate, each, 1) if problem.n_rates else ca.SX(0, 1)
    return ca.Function("flat", [x, z, u], [V, ca.repmat(z, each, 1) if problem.n_algebraic else z, x])


def segment_starts(problem: LeastSquares) -> ca.Function:
    """starts(V, x0, U) -> the states at the segments' starts and at the window's end, side by side (nx x (count + 1))."""
    s = problem.segment
    V, x0, U = _symbols(problem, ca.MX)
    if problem.count == 1:
        return ca.Function("starts", [V, x0, U], [ca.horzcat(x0, _at(problem, ca.MX, np.array([s.length]))(x0, V, U))])
    move = _segment_function(problem, "to_end", np.array([s.length]))
    states = [x0]
    for j, v in enumerate(problem.chop(V, problem.n_rates)):
        states.append(move(states[-1], v, _inputs(problem, U, j)))
    return ca.Function("starts", [V, x0, U], [ca.horzcat(*states)])


def shift(problem: LeastSquares, eq: Equations) -> ca.Function:
    """shift(V, Z, x0, U_old, x_last, x_now, z_now, theta, p, data, u, t) -> (V, Z, x0) of the window moved on by one sample.

    Inside the old window its polynomials are evaluated at the new nodes; beyond its end a Runge-Kutta chain from the last estimate runs
    from node to node, and the last node is the prediction. `data` and `theta` (with noise on theta: of all segments) belong to the new
    window; `u` is the input over the last interval.
    """
    kind, s, count = problem.kind, problem.segment, problem.count
    V, x0, U = _symbols(problem, kind)
    Z = kind.sym("Z", count * problem.n_algebraic)
    several = count if problem.noisy_parameters else 1
    x_last, x_now = kind.sym("x_last", problem.nx), kind.sym("x_now", problem.nx)
    z_now, u, t = kind.sym("z_now", problem.rates.n_algebraic), kind.sym("u", problem.nu), kind.sym("t")
    theta, p = kind.sym("theta", problem.n_theta * several), kind.sym("p", problem.n_parameters)
    data = kind.sym("data", problem.n_data)
    thetas = _each(problem, theta)
    first = _at(problem, kind, np.array([s.sample_time]))(
        x0, problem.chop(V, problem.n_rates)[0], _inputs(problem, U, 0)
    )
    starts = [x0] if count == 1 else ca.horzsplit(segment_starts(problem)(V, x0, U))
    old = list(zip(starts, *_chopped(problem, V, Z), [_inputs(problem, U, j) for j in range(count)], strict=False))
    known = [problem.data(j).unpack(data[problem.data_of(j)]).known for j in range(count)]
    V_new, Z_new = [], []
    middle = _shifted_into_next(problem) if count > 1 else None
    for j in range(count - 1):
        assert middle is not None
        v, z = middle(*old[j], *old[j + 1], thetas[j], p, known[j])
        V_new.append(v)
        Z_new.append(z)
    last = _shifted_beyond(problem, eq)
    v, z = last(*old[-1], x_last, x_now, z_now, thetas[-1], p, known[-1], u, t)
    arguments = [V, Z, x0, U, x_last, x_now, z_now, theta, p, data, u, t]
    return ca.Function("shift", arguments, [ca.vertcat(*V_new, v), ca.vertcat(*Z_new, z), first])


def _shifted_into_next(problem: LeastSquares) -> ca.Function:
    """(xs, V, Z, U of a segment, the same of the next one, theta, p, known) -> (V, Z) a sample later."""
    s = problem.segment
    kind: Any = ca.SX if problem.segment_is_small else ca.MX
    here, there = _segment_symbols(problem, kind), _segment_symbols(problem, kind)
    times = s.node_times[1:] + s.sample_time
    inside = times <= s.length * (1 + 1e-12)
    xq = ca.vertcat(
        _at(problem, kind, times[inside], s.split.states)(here[0], here[1], here[3]),
        _at(problem, kind, times[~inside] - s.length, s.split.states)(there[0], there[1], there[3]),
    )
    z = ca.vertcat(
        _algebraic(problem, kind, times[inside], here[2]),
        _algebraic(problem, kind, times[~inside] - s.length, there[2]),
    )
    theta, p, known = _known_symbols(problem, kind)
    V, Z = _rates(problem, xq, z, theta, p, known)
    return ca.Function("into_next", [*here, *there, theta, p, known], [V, Z])


def _shifted_beyond(problem: LeastSquares, eq: Equations) -> ca.Function:
    """(xs, V, Z, U of the last segment, x_last, x_now, z_now, theta, p, known, u, t) -> (V, Z) a sample later."""
    s = problem.segment
    kind: Any = ca.SX if problem.segment_is_small else ca.MX
    here = _segment_symbols(problem, kind)
    x_last, x_now, u = kind.sym("x_last", problem.nx), kind.sym("x_now", problem.nx), kind.sym("u", problem.nu)
    z_now, t = kind.sym("z_now", problem.rates.n_algebraic), kind.sym("t")
    theta, p, known = _known_symbols(problem, kind)
    rhs = algebraic.motion(eq)
    times = s.node_times[1:] + s.sample_time
    inside = times <= s.length * (1 + 1e-12)
    states = [_at(problem, kind, times[inside], s.split.states)(here[0], here[1], here[3])]
    z_known = z_now if problem.rates.n_algebraic else kind.zeros(eq.z.numel())
    x, since = x_last, 0.0
    for time in times[~inside][:-1]:
        ahead = float(time) - s.length
        x = runge_kutta(
            lambda a, b: rhs(a, u, p, theta, b, z_known)[0], x, t - s.sample_time + since, ahead - since, CLASSICAL_4
        )
        states.append(x[s.split.states] if s.split.states else kind(0, 1))
        since = ahead
    states.append(x_now[s.split.states] if s.split.states else kind(0, 1))
    z = [_algebraic(problem, kind, times[inside], here[2])]
    if problem.n_algebraic:
        z += [z_now] * int((~inside).sum())
    V, Z = _rates(problem, ca.vertcat(*states), ca.vertcat(*z), theta, p, known)
    return ca.Function("beyond", [*here, x_last, x_now, z_now, theta, p, known, u, t], [V, Z])


def _rates(problem: LeastSquares, xq: Any, z: Any, theta: Any, p: Any, known: Any) -> tuple[Any, Any]:
    """(phi, z) at the nodes, stacked."""
    rates, kind = problem.rates, type(xq)
    nq, ne, nz = rates.n_states, rates.n_known, rates.n_algebraic
    if rates.n == 0:
        return kind(0, 1), kind(0, 1)
    V, Z = [], []
    for j in range(problem.segment.order):
        at = [xq[j * nq : (j + 1) * nq], known[j * ne : (j + 1) * ne], p, theta, z[j * nz : (j + 1) * nz]]
        V.append(rates.value(*at)[0])
        Z.append(rates.solved(*at)[0])
    return ca.vertcat(*V), ca.vertcat(*Z)


def outputs_at_samples(problem: LeastSquares, measure: ca.Function) -> ca.Function:
    """outputs(V, Z, x0, theta, p, U, t_start) -> h along the trajectory of a window of one segment at its sample instants, stacked.

    They stand in for rejected samples, where a spline needs all of them.
    """
    s, nx, nu, nz = problem.segment, problem.nx, problem.nu, problem.rates.n_algebraic
    times = np.arange(s.samples + 1) * s.sample_time
    V, x0, U = _symbols(problem, ca.MX)
    Z, t = ca.MX.sym("Z", problem.n_algebraic), ca.MX.sym("t")
    theta, p = ca.MX.sym("theta", measure.numel_in(3)), ca.MX.sym("p", measure.numel_in(2))
    X = _at(problem, ca.MX, times)(x0, V, U)
    u = ca.DM(np.kron(s.inputs_at(times), np.eye(nu))) @ U if nu else ca.MX(0, 1)
    z = _algebraic(problem, ca.MX, times, Z)
    values = [
        measure(
            X[i * nx : (i + 1) * nx], u[i * nu : (i + 1) * nu], p, theta, t + float(time), z[i * nz : (i + 1) * nz]
        )[0]
        for i, time in enumerate(times)
    ]
    return ca.Function("outputs", [V, Z, x0, theta, p, U, t], [ca.vertcat(*values)])


def state_at(problem: LeastSquares) -> ca.Function:
    """state(place, V, Z, x0, U) -> (x, z) at the window's sample instant `place`; its end as one product, another one by its index."""
    s, nx, nz, count, L = problem.segment, problem.nx, problem.rates.n_algebraic, problem.count, problem.segment.samples
    V, x0, U = _symbols(problem, ca.MX)
    place, Z = ca.MX.sym("place"), ca.MX.sym("Z", count * problem.n_algebraic)
    arguments: list[Any] = [place, V, Z, x0, U]
    starts = segment_starts(problem)(V, x0, U)
    last_z = Z[-nz:] if nz else ca.MX(0, 1)
    at_end = ca.Function("at_end", arguments, [starts[:, count], last_z])
    times = np.arange(1, L + 1) * s.sample_time
    inside = _segment_function(problem, "inside", times)
    states, algebraics = [x0], [_algebraic(problem, ca.MX, np.zeros(1), problem.chop(Z, problem.n_algebraic)[0])]
    for j, (v, z) in enumerate(zip(*_chopped(problem, V, Z), strict=True)):
        states.append(ca.reshape(inside(starts[:, j], v, _inputs(problem, U, j)), nx, L))
        algebraics.append(ca.reshape(_algebraic(problem, ca.MX, times, z), nz, L))
    chosen = ca.DM(range(count * L + 1)) == place
    z_there = ca.horzcat(*algebraics) @ chosen if nz else ca.MX(0, 1)
    somewhere = ca.Function("somewhere", arguments, [ca.horzcat(*states) @ chosen, z_there])
    chosen_function = ca.Function.if_else("at", at_end, somewhere)
    return ca.Function("state", arguments, list(chosen_function(place == count * L, *arguments)))


def sample_rows(problem: LeastSquares) -> ca.Function:
    """rows(place) -> [Ph, Ps] (nx x (nx + n_rates), stacked) with x = Ph xs + Ps V at the window's sample instant `place`, in its segment.

    A sample between two segments is the end of the first. With process noise the columns of `Segment.held` follow, and a last entry says
    whether the place is a segment's end.
    """
    s, count, m = problem.segment, problem.count, problem.segment.samples
    place = ca.MX.sym("place")
    times = [np.array([i * s.sample_time]) for i in range(m + 1)]
    tables = [np.hstack([*s.at(time), s.held(time)]).ravel(order="F") for time in times]
    if problem.n_noise:
        tables = [np.append(table, float(i == m)) for i, table in enumerate(tables)]
    at_end = ca.Function("rows_at_end", [place], [ca.DM(tables[m])])
    inside = place - m * ca.floor((place - 1) / m)  # 1 .. m; the window's start, 0, gives m
    chosen = ca.if_else(place > 0, inside, 0)
    somewhere = ca.Function("rows_somewhere", [place], [ca.DM(np.array(tables).T) @ (ca.DM(range(m + 1)) == chosen)])
    rows = ca.Function.if_else("rows", at_end, somewhere)
    return ca.Function("sample_rows", [place], [rows(place == count * m, place)])


def node0(problem: LeastSquares) -> ca.Function:
    """node0(V, Z, x0, theta, p, t_start, U, active) -> (residual, regularity).

    The largest residual of (16) at a segment's dropped node 0, in units of the states' nominal values; and the smallest pivot of g_z there
    and at the nodes. Segments with `active` 0 don't count.
    """
    s, rates, count = problem.segment, problem.rates, problem.count
    R0, RV = s.node0
    kind = tiles.kind(len(problem.scale))
    arguments = [
        *_segment_symbols(problem, kind),
        kind.sym("theta", problem.n_theta),
        kind.sym("p", problem.n_parameters),
    ]
    xs, v, z, u_all, theta, p = arguments
    t = kind.sym("t")
    u = ca.mtimes(ca.DM(np.kron(s.inputs_at(np.zeros(1)), np.eye(problem.nu))), _known(problem, u_all))
    xq = xs[s.split.states] if s.split.states else kind(0, 1)
    at = [xq, rates.known(t, u, p), p, theta, _algebraic(problem, kind, np.zeros(1), z)]
    phi, regular = rates.value(*at)[0], _regularity(problem, xs, v, z, u_all, theta, p, t)
    residual = ca.mtimes(ca.DM(R0), xs) + ca.mtimes(ca.DM(RV), v) - s.length / 2 * ca.mtimes(ca.DM(s.split.E), phi)
    largest = ca.mmax(ca.fabs(residual / ca.DM(problem.scale[: problem.nx])))
    if count == 1:
        return ca.Function("node0", [v, z, xs, theta, p, t, u_all], [largest, regular])
    one = ca.Function("start", [*arguments, t], [largest, regular])
    V, x0, U = _symbols(problem, ca.MX)
    Z, time = ca.MX.sym("Z", count * problem.n_algebraic), ca.MX.sym("t")
    active = ca.MX.sym("active", count)
    several = count if problem.noisy_parameters else 1
    theta, p = ca.MX.sym("theta", problem.n_theta * several), ca.MX.sym("p", problem.n_parameters)
    thetas = _each(problem, theta)
    starts = segment_starts(problem)(V, x0, U)
    worst, least = ca.MX(0), ca.MX(np.inf)
    for j, (v, z) in enumerate(zip(*_chopped(problem, V, Z), strict=True)):
        a, b = one(starts[:, j], v, z, _inputs(problem, U, j), thetas[j], p, time + j * s.length)
        worst, least = ca.fmax(worst, ca.if_else(active[j], a, 0)), ca.fmin(least, ca.if_else(active[j], b, np.inf))
    return ca.Function("node0", [V, Z, x0, theta, p, time, U, active], [worst, least])


def _regularity(problem: LeastSquares, xs: Any, V: Any, Z: Any, U: Any, theta: Any, p: Any, t: Any) -> Any:
    """The smallest pivot of g_z at a segment's nodes 0..N; infinite without algebraic variables."""
    s, rates, nq, nz, nu = problem.segment, problem.rates, problem.rates.n_states, problem.rates.n_algebraic, problem.nu
    kind: Any = type(xs)
    if nz == 0:
        return kind(np.inf)
    times = s.node_times
    xq = _at(problem, kind, times, s.split.states)(xs, V, U)
    u = ca.mtimes(ca.DM(np.kron(s.inputs_at(times), np.eye(nu))), _known(problem, U))
    z = ca.vertcat(_algebraic(problem, kind, times[:1], Z), Z)
    found = []
    for i, time in enumerate(times):
        known = rates.known(t + float(time), u[i * nu : (i + 1) * nu], p)
        found.append(rates.solved(xq[i * nq : (i + 1) * nq], known, p, theta, z[i * nz : (i + 1) * nz])[1])
    return ca.mmin(ca.vertcat(*found))


def _symbols(problem: LeastSquares, kind: Any) -> tuple[Any, Any, Any]:
    """V, x0, U of the whole window."""
    return (
        kind.sym("V", problem.count * problem.n_rates),
        kind.sym("x0", problem.nx),
        kind.sym("U", problem.n_driven),
    )


def _segment_symbols(problem: LeastSquares, kind: Any) -> list[Any]:
    """xs, V, Z, U of one segment."""
    sizes = {
        "xs": problem.nx,
        "V": problem.n_rates,
        "Z": problem.n_algebraic,
        "U": problem.inputs(0).stop + len(problem.noisy_states),
    }
    return [kind.sym(name, size) for name, size in sizes.items()]


def _known_symbols(problem: LeastSquares, kind: Any) -> list[Any]:
    """theta, p and the rates' known terms at a segment's nodes."""
    known = problem.rates.n_known * problem.segment.order
    sizes = {"theta": problem.n_theta, "p": problem.n_parameters, "known": known}
    return [kind.sym(name, size) for name, size in sizes.items()]


def _chopped(problem: LeastSquares, V: Any, Z: Any) -> tuple[list[Any], list[Any]]:
    return problem.chop(V, problem.n_rates), problem.chop(Z, problem.n_algebraic)


def _inputs(problem: LeastSquares, U: Any, j: int) -> Any:
    """What drives segment j: its inputs, and the noise on its rates."""
    n, start = len(problem.noisy_states), problem.inputs(problem.count - 1).stop
    own = U[problem.inputs(j)] if problem.nu else type(U)(0, 1)
    return ca.vertcat(own, U[start + j * n : start + (j + 1) * n]) if n else own


def _known(problem: LeastSquares, U: Any) -> Any:
    """A segment's inputs alone."""
    return U[: problem.inputs(0).stop] if problem.nu else type(U)(0, 1)


def _each(problem: LeastSquares, theta: Any) -> list[Any]:
    """The segments' unknown parameters from a column of all of them, or of the one that they share."""
    nt = problem.n_theta
    if not problem.noisy_parameters:
        return [theta] * problem.count
    return [theta[j * nt : (j + 1) * nt] for j in range(problem.count)]


def _at(problem: LeastSquares, kind: Any, times: np.ndarray, states: list[int] | None = None) -> Any:
    """A function of (xs, V, U) of a segment: the states at `times` since its start, stacked."""
    Ph, Ps = problem.segment.at(times, states)
    Xi = np.hstack([problem.segment.forced(times, states), problem.segment.held(times, states)])

    def evaluate(xs: Any, V: Any, U: Any) -> Any:
        total = ca.mtimes(kind(ca.DM(Ph)), xs) + ca.mtimes(kind(ca.DM(Ps)), V)
        return total + ca.mtimes(kind(ca.DM(Xi)), U) if Xi.any() else total

    return evaluate


def _segment_function(problem: LeastSquares, name: str, times: np.ndarray) -> ca.Function:
    """`_at` as one Function: many segments share it."""
    xs, V, _, U = _segment_symbols(problem, ca.MX)
    return ca.Function(name, [xs, V, U], [_at(problem, ca.MX, times)(xs, V, U)])


def _algebraic(problem: LeastSquares, kind: Any, times: np.ndarray, Z: Any) -> Any:
    """The algebraic variables at `times` since a segment's start, stacked."""
    if problem.n_algebraic == 0:
        return kind(0, 1)
    weights = np.kron(problem.segment.from_nodes(times), np.eye(problem.rates.n_algebraic))
    return ca.mtimes(kind(ca.DM(weights)), Z)
