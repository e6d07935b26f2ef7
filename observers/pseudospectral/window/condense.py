"""The windowed least-squares problem linearised along a trajectory, condensed to the unknowns s = [x0; theta], segment by segment.

For the rates V and first state xs of a segment, with RG = d xs / d [1; s], and X_Q = PhQ xs + PsQ V + CQ the states that phi depends on:

    (I - blk(phi_x) PsQ) sol = [phi - V, 0, phi_theta] + blk(phi_x) PhQ RG      dV = sol [1; ds]      (`rates`)
    RG+ = PhE RG + PsE sol                                                       of the next segment
    M = d h / d [1; s] at the measured points                                    r = h - y

and the sum over the segments of [r + M_0, M_s]' W [r + M_0, M_s] holds normal matrix, gradient and cost.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from observers.numerics import tiles
from observers.pseudospectral.window import groups
from observers.pseudospectral.window.along import Along, affine, measured, path, sensitivity
from observers.pseudospectral.window.problem import LeastSquares
from observers.pseudospectral.window.rates import solved_rates


@dataclass(frozen=True)
class Linearised:
    """The problem linearised at (V, Z, s), over the whole window.

    `normal` (1 + ns, 1 + ns); `sol` the segments' d V / d [1; s]; `Z` the algebraic variables at the nodes; `residual` (h - y) and
    `sensitivity` its derivative by [1; s] at all measured points; `nodes` and `node_sensitivity` those of the bounded states at the nodes;
    `path` and `path_sensitivity` those of the path constraints at their points;
    `reached` (nx, 1 + ns) that of the state at the sample that `given["at"]` is of (none without it).
    """

    normal: Any
    sol: list[Any]
    Z: Any
    residual: Any
    sensitivity: Any
    nodes: Any
    node_sensitivity: Any
    path: Any
    path_sensitivity: Any
    reached: Any


def output_residual(problem: LeastSquares) -> ca.Function:
    """Function residual(V, Z, s, noise, data, p, y) -> h(points) - y, stacked (ny m)."""
    kind = problem.kind
    V, Z, s, noise, data, p, y = symbols(problem, kind)
    xs, thetas = s[: problem.nx], problem.thetas(s[problem.nx :], noise)
    rows = []
    functions = [_residual(problem, j, kind) for j in range(min(problem.count, 2))]
    move = end(problem)
    for j, (v, z) in enumerate(segments(problem, V, Z)):
        known = _with_noise(problem, j, data[problem.data_of(j)], noise)
        jump = [problem.jumps(noise, j)] if problem.sees_jumps else []
        rows.append(functions[min(j, 1)](xs, v, z, thetas[j], known, p, y[problem.measured(j)], *jump))
        if j + 1 < problem.count:
            xs = move(xs, v, problem.data(j).unpack(known).forced_end)
    return ca.Function("residual", [V, Z, s, noise, data, p, y], [ca.vertcat(*rows)])


def _with_noise(problem: LeastSquares, j: int, data: Any, noise: Any) -> Any:
    """A segment's data with what its noise adds; `noise` is that of the whole window."""
    if not problem.n_noise:
        return data
    own = noise[j * problem.n_noise : (j + 1) * problem.n_noise]
    return data + ca.mtimes(type(data)(ca.DM(problem.noise_terms(j))), own)


def end(problem: LeastSquares) -> ca.Function:
    """end(xs, V, forced_end) -> the state at the segment's end."""
    Ph, Ps = problem.segment.at(np.array([problem.segment.length]))
    kind = tiles.kind(len(problem.scale))
    arguments = [kind.sym("xs", problem.nx), kind.sym("V", problem.n_rates), kind.sym("c", problem.nx)]
    return ca.Function("end", arguments, [affine(kind, Ph, arguments[0], Ps, arguments[1], arguments[2])])


def symbols(problem: LeastSquares, kind: Any) -> tuple[Any, ...]:
    """V, Z, s, noise, data, p, y of the whole window, SX or MX."""
    counts = (
        problem.count * problem.n_rates,
        problem.count * problem.n_algebraic,
        problem.nx + problem.n_theta,
        problem.count * problem.n_noise,
        problem.n_data,
        problem.n_parameters,
        problem.ny * problem.n_measured,
    )
    names = ("V", "Z", "s", "noise", "data", "p", "y")
    return tuple(kind.sym(name, count) for name, count in zip(names, counts, strict=True))


def linearise(problem: LeastSquares, V: Any, Z: Any, s: Any, given: Mapping[str, Any]) -> Linearised:
    """The problem at (V, Z, s), with what `gauss_newton.Solve.given` names: data, p, y and the weights w of the measured points.

    Of several segments, those with `active` 0 stay as they are and weigh nothing. `at` is `trajectory.sample_rows`, of the last active one.
    """
    data, p, y, w = (given[name] for name in ("data", "p", "y", "w"))
    kind, n = type(V), 1 + problem.nx + problem.n_theta
    xs, theta = s[: problem.nx], s[problem.nx :]
    RG = _at_start(problem, kind)
    normal = kind(ca.DM.zeros(n, n))
    parts: dict[str, list[Any]] = {name: [] for name in ("sol", "Z", "r", "M", "X", "G", "P", "Q")}
    first = segment(problem, 0, kind)
    later = _if_active(segment(problem, 1, kind)) if problem.count > 1 else None
    reached = kind(ca.DM.zeros(problem.nx, n))
    for j, (v, z) in enumerate(segments(problem, V, Z)):
        before = RG
        arguments = [xs, RG, v, z, theta, data[problem.data_of(j)], p, y[problem.measured(j)], w[problem.measured(j)]]
        found = first(*arguments) if later is None or j == 0 else later(given["active"][j], *arguments)
        xs, RG = found[0], found[1]
        normal = normal + found[2]
        for name, value in zip(parts, found[3:], strict=True):
            parts[name].append(value)
        if "at" in given:
            last = None if problem.count == 1 else _is_last(given["active"], j)
            reached = _reached(problem, kind, last)(given["at"], before, found[3], reached)
    stacked = {name: ca.vertcat(*values) for name, values in parts.items() if name != "sol"}
    return Linearised(
        normal,
        parts["sol"],
        stacked["Z"],
        residual=stacked["r"],
        sensitivity=stacked["M"],
        nodes=stacked["X"],
        node_sensitivity=stacked["G"],
        path=stacked["P"],
        path_sensitivity=stacked["Q"],
        reached=reached,
    )


def _is_last(active: Any, j: int) -> Any:
    """Whether segment j is the last active one."""
    return active[j] - active[j + 1] if j + 1 < active.numel() else active[j]


def _reached(problem: LeastSquares, kind: Any, last: Any) -> Callable[..., Any]:
    """(at, RG, sol, before) -> d x / d [1; s] at the sample `at` of a segment; `before` unless the segment is the `last` one."""

    def of(at: Any, RG: Any, sol: Any, before: Any) -> Any:
        nx = problem.nx
        rows, n = nx + problem.n_rates, RG.shape[1]
        shapes = (("at", nx * rows, 1), ("RG", nx, n), ("sol", problem.n_rates, n), ("before", nx, n))
        names = [kind.sym(*shape) for shape in shapes]
        matrix = ca.reshape(names[0], nx, rows)
        there = ca.mtimes(matrix[:, :nx], names[1])
        if problem.n_rates:
            there = there + ca.mtimes(matrix[:, nx:], names[2])
        reached = ca.Function("reached", names, [there])
        if last is None:
            return reached(at, RG, sol, before)
        skipped = ca.Function("reached_skipped", names, [names[3]])
        return ca.Function.if_else("maybe_reached", reached, skipped)(last, at, RG, sol, before)

    return of


def first_sample(problem: LeastSquares) -> ca.Function:
    """first_sample(V, Z, s, noise, data, p, U) -> (x, S): the state one sample after the window's start, and d x / d [s; noise]."""
    kind = problem.kind
    V, Z, s, noise, data, p, _ = symbols(problem, kind)
    U = kind.sym("U", problem.inputs(problem.count - 1).stop)
    v, z = segments(problem, V, Z)[0]
    xs, theta, RG = s[: problem.nx], s[problem.nx :], _at_start(problem, kind)
    known = problem.data(0).unpack(_with_noise(problem, 0, data[problem.data_of(0)], noise))
    sol, _ = solved_rates(problem, kind, Along(xs, v, z, theta, known, p), RG)
    times = np.array([problem.segment.sample_time])
    Ph, Ps = problem.segment.at(times)
    Xi = problem.segment.forced(times)
    forced = ca.mtimes(kind(ca.DM(Xi)), U[problem.inputs(0)]) if Xi.any() else kind(ca.DM.zeros(problem.nx))
    held = problem.segment.held(times)
    if problem.noisy_states:
        forced = forced + ca.mtimes(kind(ca.DM(held)), noise[: len(problem.noisy_states)])
    x = affine(kind, Ph, xs, Ps, v, forced)
    S = sensitivity(kind, Ph, Ps, RG, sol, problem.direct(held))[:, 1:]
    return ca.Function("first_sample", [V, Z, s, noise, data, p, U], [x, S])


def _at_start(problem: LeastSquares, kind: Any) -> Any:
    """RG at the window's start: [0 I 0]."""
    width = len(problem.scale) + problem.n_noise
    return kind(ca.DM(np.hstack([np.zeros((problem.nx, 1)), np.eye(problem.nx, width)])))


def segments(problem: LeastSquares, V: Any, Z: Any) -> list[tuple[Any, Any]]:
    return list(zip(problem.chop(V, problem.n_rates), problem.chop(Z, problem.n_algebraic), strict=True))


def _if_active(function: ca.Function) -> ca.Function:
    """`function` where its first argument is not 0; else xs and RG pass, Z stays, all else is 0."""
    arguments = [ca.MX.sym(function.name_in(i), function.sparsity_in(i)) for i in range(function.n_in())]
    stays = {0: arguments[0], 1: arguments[1], 4: arguments[3]}
    results = [stays.get(i, ca.MX(ca.DM.zeros(*function.size_out(i)))) for i in range(function.n_out())]
    skip = ca.Function(f"{function.name()}_skipped", arguments, results)
    return ca.Function.if_else(f"maybe_{function.name()}", function, skip)


def _residual(problem: LeastSquares, j: int, kind: Any) -> ca.Function:
    """residual(xs, V, Z, theta, data, p, y) -> r at the points of a first (j = 0) or later segment; with `Along.jump` where it counts."""
    xs, _, V, Z, theta, data, p, y, _, *jump = _segment_symbols(problem, j, kind)
    rows = measured(problem, j, Along(xs, V, Z, theta, problem.data(j).unpack(data), p, *jump), y)
    return ca.Function(f"residual_{j}", [xs, V, Z, theta, data, p, y, *jump], [ca.vertcat(*[r for r, _ in rows])])


def segment(problem: LeastSquares, j: int, kind: Any) -> ca.Function:
    """Function of (xs, RG, V, Z, theta, data, p, y, w) of a first (j = 0) or later segment, with `Along.jump` where it counts.

    Returns (xs+, RG+, normal, sol, Z+, r, M, X, G, P, Q): X the bounded states at the nodes, G their derivative by [1; s], or
    [1; s; noise], as all derivatives here; P and Q the same of the path constraints.
    """
    kind = ca.SX if problem.segment_is_small else kind
    arguments = _segment_symbols(problem, j, kind)
    xs, RG, V, Z, theta, data, p, y, w, *jump = arguments
    known = problem.data(j).unpack(data)
    s, n = problem.segment, RG.shape[1]
    at = Along(xs, V, Z, theta, known, p, *jump)
    sol, Z_new = solved_rates(problem, kind, at, RG)
    normal, start = kind(ca.DM.zeros(n, n)), 0
    rows = measured(problem, j, at, y, (RG, sol))
    for r, M in rows:
        normal = normal + groups.normal(M.shape[0], n)(r, M, w[start : start + M.shape[0]])
        start += M.shape[0]
    if problem.has_ends:
        end_time = np.array([s.length])
        Ph, Ps = s.at(end_time)
        xs_end = affine(kind, Ph, xs, Ps, V, known.forced_end)
        RG_end = sensitivity(kind, Ph, Ps, RG, sol, problem.direct(s.held(end_time)))
    else:
        xs_end, RG_end = xs, RG
    X, G = kind(0, 1), kind(0, n)
    if problem.bounded:
        Ph, Ps = s.at(s.node_times[1:], list(problem.bounded))
        X = affine(kind, Ph, xs, Ps, V, known.forced_bounded)
        G = sensitivity(kind, Ph, Ps, RG, sol, problem.direct(s.held(s.node_times[1:], list(problem.bounded))))
    whole = ca.vertcat(*sol) if sol else kind(0, n)
    r, M = (ca.vertcat(*column) for column in zip(*rows, strict=True))
    P, Q = path(problem, j, at, (RG, sol))
    results = [xs_end, RG_end, normal, whole, Z_new, r, M, X, G, P, Q]
    return ca.Function(f"segment_{j}", arguments, [ca.densify(result) for result in results])


def _segment_symbols(problem: LeastSquares, j: int, kind: Any) -> list[Any]:
    kind = ca.SX if problem.segment_is_small else kind
    n, m = 1 + problem.nx + problem.n_theta + problem.n_noise, problem.ny * len(problem.points_of(j))
    shapes = {
        "xs": (problem.nx, 1),
        "RG": (problem.nx, n),
        "V": (problem.n_rates, 1),
        "Z": (problem.n_algebraic, 1),
        "theta": (problem.n_theta, 1),
        "data": (problem.data(j).total, 1),
        "p": (problem.n_parameters, 1),
        "y": (m, 1),
        "w": (m, 1),
    }
    if problem.sees_jumps:
        shapes["jump"] = (problem.n_theta, 1)
    return [kind.sym(name, *shape) for name, shape in shapes.items()]
