"""The iterations of Calvillo-Corona & Alamir, Figure 1: all elementary problems, independent of each other, then processing (10).

The window's trajectories are columns: states X (n x N) at the samples, disturbances W (k x N - 1) constant on the intervals between.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers.elementary.columns import repeated
from observers.elementary.defect import mean_rate
from observers.elementary.hamilton_jacobi import hamilton_jacobi
from observers.elementary.output_problem import at_samples, left_over, output_problems, solution
from observers.elementary.problems import GRID, Elementary, disturbed, scalar_problem
from observers.elementary.scalar_gauss_newton import gauss_newton
from observers.model import Model
from observers.numerics.finite import HUGE
from observers.numerics.layout import Layout

SMALLEST_CHANGE = 1e-300  # so that no ratio divides by zero
BLOCK = 10  # calls in one function of a chain


def symbols(model: Model, N: int, settings: int) -> SimpleNamespace:
    """The arguments of an iteration: X, W, measurements Y and their weights V (ny x N, 0 = rejected), inputs, clock, parameters, tuning.

    `u0`, `u1` (nu x N - 1): inputs at an interval's two ends; `u` (nu x N): at the samples; `active` (1 x N - 1): 0 before the first
    sample; `t`: time of the last node [s]; `s`: sample time [s]; `p`: model parameters; `tuning`: see `Tuning`.
    """
    n, ny, nu, k = len(model.states), len(model.outputs), len(model.inputs), len(model.unknown_disturbances)
    return SimpleNamespace(
        X=ca.MX.sym("X", n, N),
        W=ca.MX.sym("W", k, N - 1),
        Y=ca.MX.sym("Y", ny, N),
        V=ca.MX.sym("V", ny, N),
        u0=ca.MX.sym("u0", nu, N - 1),
        u1=ca.MX.sym("u1", nu, N - 1),
        u=ca.MX.sym("u", nu, N),
        active=ca.MX.sym("active", 1, N - 1),
        t=ca.MX.sym("t"),
        s=ca.MX.sym("s"),
        p=ca.MX.sym("p", len(model.parameters)),
        tuning=ca.MX.sym("tuning", settings),
    )


def mean_rates(model: Model, v: Any) -> Any:
    """The mean of f over each interval along X, W; (n x N - 1)."""
    N = v.X.shape[1]
    times = v.t + v.s * ca.DM(range(1 - N, 1)).T
    rate = mean_rate(model.equations).map(N - 1)
    return rate(v.X[:, :-1], v.X[:, 1:], v.u0, v.u1, v.W, repeated(v.p, N - 1), times[:-1], repeated(v.s, N - 1))


def measure(model: Model) -> ca.Function:
    """(x, w, u, p, t) -> y (ny x 1)."""
    eq = model.equations
    return ca.Function("measure", [eq.x, eq.w, eq.u, eq.p, eq.t], [ca.densify(eq.output)])


def elementary_solution(model: Model, problem: Elementary, N: int, nodes: int) -> ca.Function:
    """ep(X, W, Y, V, u0, u1, u, active, t, s, p, tuning(q, r (m)), rate) -> (xi (1 x N), nu (m x N - 1)): one elementary
    problem, solved. V in [0, 1] is the part of its weight with which an output that has disturbances is followed.
    """
    v, i = symbols(model, N, 1 + problem.n_controls), problem.index
    rate = ca.MX.sym("rate", 1, N - 1)
    scalar = scalar_problem(model, problem, nodes)
    times = v.t + v.s * ca.DM(range(1 - N, 1)).T
    u_middle = (v.u0 + v.u1) / 2
    middle = (v.X[:, :-1] + v.X[:, 1:]) / 2
    nu = ca.vertcat(*[middle[j, :] for j in problem.states], *[v.W[k, :] for k in problem.disturbances])
    if not problem.n_controls:
        nu = ca.MX(0, N - 1)
    # A rejected measurement: what the last iterate makes of it, which does not pull.
    expected = measure(model).map(N)(v.X, at_samples(v.W), v.u, repeated(v.p, N), times)
    seen = ca.if_else(v.V, v.Y, expected)
    parts = [v.V[m, :] for m in disturbed(model, problem)]
    w = [at_samples(v.W)] if parts else []
    target = ca.vertcat(*[seen[m, :] for m in problem.outputs], *parts, v.X, *w, v.u, times)
    known = ca.vertcat(u_middle, times[:-1] + v.s / 2)
    solve = (hamilton_jacobi if problem.level == GRID else gauss_newton)(scalar, N)
    xi, delta = solve(v.X[i, :], nu, rate, known, target, v.active, v.s, v.p, v.tuning[0], v.tuning[1:])
    return ca.Function(f"elementary_{scalar.name}", [*vars(v).values(), rate], [xi, nu + delta])


def at_nodes(intervals: Any, active: Any) -> Any:
    """Values at the N nodes (m x N) from those of N - 1 intervals: the mean of the neighbours that are active."""
    row = ca.repmat(active, intervals.shape[0], 1)
    none = ca.MX.zeros(intervals.shape[0], 1)
    neighbours = ca.fmax(ca.horzcat(none, row) + ca.horzcat(row, none), 1)
    return (ca.horzcat(none, row * intervals) + ca.horzcat(row * intervals, none)) / neighbours


def active_nodes(active: Any, rows: int) -> Any:
    """`rows` x N: 1 at the samples of an active interval, 0 elsewhere."""
    return ca.repmat(ca.fmax(ca.horzcat(0, active), ca.horzcat(active, 0)), rows, 1)


def acting(model: Model, active: Any) -> Any:
    """ny x N: 1 where a sample says something: at an active interval's end, and at its begin if the output has no disturbance."""
    rows, ends = active_nodes(active, len(model.outputs)), ca.horzcat(0, active)
    for problem in output_problems(model):
        rows = ca.vertcat(rows[: problem.index, :], ends, rows[problem.index + 1 :, :])
    return rows


def contributors(model: Model, problems: tuple[Elementary, ...]) -> list[tuple[int, ...]]:
    """For each state, then each disturbance: the problems in which it is the state or a control, that is those which (10) averages.

    A state's problem goes by the state's index, that of the j-th disturbed output by the number of states + j.
    """
    n = len(model.states)
    states = [tuple(p.index for p in problems if j == p.index or j in p.states) for j in range(n)]
    seen = output_problems(model)
    return states + [
        tuple(p.index for p in problems if k in p.disturbances)
        + tuple(n + j for j, p in enumerate(seen) if k in p.disturbances)
        for k in range(len(model.unknown_disturbances))
    ]


def tuning_layout(model: Model, problems: tuple[Elementary, ...]) -> Layout:
    """The tuning as one column: q of each problem, r of each problem's controls, the weights of (10) for each variable.

    The problems of the states come first, then those of the outputs.
    """
    seen, n = output_problems(model), len(problems)
    return Layout(
        q=n + len(seen),
        **{f"r{p.index}": p.n_controls for p in problems},
        **{f"r{n + j}": len(p.disturbances) for j, p in enumerate(seen)},
        **{f"weight{j}": len(of) for j, of in enumerate(contributors(model, problems))},
    )


def iteration(model: Model, problems: tuple[Elementary, ...], N: int, nodes: int) -> ca.Function:
    """iterate(X, W, Y, V, u0, u1, u, active, t, s, p, tuning) -> (X, W, change) after one iteration.

    `change`: the largest of any state at any sample, in units of its nominal value: what the paper compares with epsilon.
    """
    layout = tuning_layout(model, problems)
    v = symbols(model, N, layout.total)
    tuning = layout.unpack(v.tuning)
    rates = mean_rates(model, v)
    states: list[list[Any]] = [[] for _ in model.states]
    disturbances: list[list[Any]] = [[] for _ in model.unknown_disturbances]
    arguments = [*(vars(v) | {"V": _followed(model, v, tuning, len(problems))}).values()][:-1]
    for problem in problems:
        settings = ca.vertcat(tuning.q[problem.index], getattr(tuning, f"r{problem.index}"))
        xi, nu = elementary_solution(model, problem, N, nodes)(*arguments, settings, rates[problem.index, :])
        middle = (v.X[:, :-1] + v.X[:, 1:]) / 2
        for j in sorted((problem.index, *problem.states)):
            if j == problem.index:
                states[j].append(xi)
            else:
                states[j].append(v.X[j, :] + at_nodes(nu[problem.states.index(j), :] - middle[j, :], v.active))
        for row, k in enumerate(problem.disturbances, start=len(problem.states)):
            disturbances[k].append(nu[row, :])

    def average(found: list[Any], weight: Any) -> Any:
        return ca.mtimes(weight.T, ca.vertcat(*found)) / ca.sum1(weight)

    n = len(model.states)
    X = ca.vertcat(*[average(found, getattr(tuning, f"weight{j}")) for j, found in enumerate(states)])
    # The outputs' problems begin where the states' end: both would take the same residual off.
    for k, nu in _of_outputs(model, v, X, tuning, len(problems)):
        disturbances[k].append(nu)
    W = ca.vertcat(
        *[
            average(found, getattr(tuning, f"weight{n + k}")) if found else v.W[k, :]
            for k, found in enumerate(disturbances)
        ]
    )
    if not disturbances:
        W = ca.MX(0, N - 1)
    nominal = ca.repmat(ca.DM([s.nominal for s in model.states]), 1, N)
    change = ca.norm_inf(ca.vec(active_nodes(v.active, n) * (X - v.X) / nominal))
    return ca.Function("iterate", list(vars(v).values()), [X, W, change])


def _followed(model: Model, v: SimpleNamespace, tuning: SimpleNamespace, first: int) -> Any:
    """V, and of an output with disturbances the part of its weight with which the states follow it; `first`: number of its problem."""
    N, rows = v.X.shape[1], v.V
    times = v.t + v.s * ca.DM(range(1 - N, 1)).T
    for j, output in enumerate(output_problems(model), start=first):
        weights = (repeated(tuning.q[j], N), repeated(getattr(tuning, f"r{j}"), N))
        left = left_over(model, output).map(N)(v.X, at_samples(v.W), v.u, repeated(v.p, N), times, *weights)
        left = left * ca.horzcat(0, v.active) * v.V[output.index, :]
        rows = ca.vertcat(rows[: output.index, :], left, rows[output.index + 1 :, :])
    return rows


def _of_outputs(
    model: Model, v: SimpleNamespace, X: Any, tuning: SimpleNamespace, first: int
) -> Iterator[tuple[int, Any]]:
    """(k, its values on the intervals) for each disturbance of each output, by the outputs' problems at the states X."""
    N, at = X.shape[1], slice(1, None)
    times = v.t + v.s * ca.DM(range(1 - N, 1)).T
    for j, output in enumerate(output_problems(model), start=first):
        m, weights = output.index, (repeated(tuning.q[j], N - 1), repeated(getattr(tuning, f"r{j}"), N - 1))
        samples = (v.Y[m, at], v.V[m, at] * v.active, v.u[:, at], repeated(v.p, N - 1), times[at])
        nu = solution(model, output).map(N - 1)(X[:, at], v.W, *samples, *weights)
        for row, k in enumerate(output.disturbances):
            yield k, nu[row, :]


def iterations(model: Model, problems: tuple[Elementary, ...], N: int, K: int, nodes: int) -> ca.Function:
    """(go, X, W, <the window>, tuning, epsilon, limit) -> (X, W, change, contraction, iterations): up to K of them, none unless `go`.

    They end when `change` is at most epsilon, or when `limit` of them are done. `contraction` is the ratio of the last two changes (0
    after a single one).
    """
    once = iteration(model, problems, N, nodes)
    v = symbols(model, N, once.numel_in(once.n_in() - 1))
    go, epsilon, limit = ca.MX.sym("go"), ca.MX.sym("epsilon"), ca.MX.sym("limit")
    fixed = [*list(vars(v).values())[2:], go, epsilon, limit]
    now = [v.X, v.W, *(ca.MX.sym(name) for name in ("change", "contraction", "count"))]
    X, W, change = once(v.X, v.W, *fixed[:-3])
    ratio = ca.if_else(now[4] > 0, change / ca.fmax(now[2], SMALLEST_CHANGE), 0)
    step = ca.Function("step", [*now, *fixed], [X, W, change, ratio, now[4] + 1])
    stay = ca.Function("stay", [*now, *fixed], now)
    # NaN fails the comparison, which ends the iterations.
    unfinished = ca.logic_and(ca.logic_and(go, now[2] > epsilon), now[4] < limit)
    maybe = ca.Function.if_else("maybe", step, stay)
    repeated_step = _chain(ca.Function("next", [*now, *fixed], list(maybe(unfinished, *now, *fixed))), K, len(now))
    X, W, change, contraction, count = repeated_step(v.X, v.W, HUGE, 0, 0, *fixed)
    arguments = [go, v.X, v.W, *fixed[:-3], epsilon, limit]
    return ca.Function("iterations", arguments, [X, W, ca.if_else(go, change, 0), contraction, count])


def _chain(function: ca.Function, times: int, n_state: int) -> ca.Function:
    """`function`, whose first `n_state` arguments are its results too, `times` in a row; nested: little C code however many."""
    arguments = function.mx_in()
    state, fixed = arguments[:n_state], arguments[n_state:]
    blocks, rest = divmod(times, BLOCK) if times > BLOCK else (0, times)
    if blocks:
        state = list(_chain(_chain(function, BLOCK, n_state), blocks, n_state)(*state, *fixed))
    for _ in range(rest):
        state = list(function(*state, *fixed))
    return ca.Function(f"{function.name()}_{times}", arguments, state)
