"""Process noise inside the window, piecewise constant: a Gauss-Newton step whose cost grows with the number of segments, not with its cube.

On segment j the rates of some states get a constant w_j, and after it some unknown parameters a jump eta_j, which the cost penalises by
their variances: q^2 / length and q^2 length for an intensity q, so that over a segment a variance grows by q^2 length. They are held in
units of their standard deviations, nu_j = [w_j; eta_j] / std, so that an intensity of zero is one like any other. With
v_j = [1; ds_j; dnu_j], ds_j the step in the segment's first state and parameters, the linearised problem is a chain,

    minimise   sum_j v_j' N_j v_j + |nu_j + dnu_j|^2     subject to   [1; ds_j+1] = T_j v_j

(and the arrival cost of s_0), solved by dynamic programming (Rao, Rawlings & Mayne, IEEE Trans. Automat. Contr. 48 (2), 2003; the recursion
is Rauch, Tung & Striebel's in its information form). From the last segment to the first the cost to go C_j of ds_j follows by eliminating
dnu_j, whose block has a unit matrix in it (times Ts, as the cost is an integral) and never lacks a pivot:

    F = N_j + T_j' C_j+1 T_j + penalty,   dnu_j = K_j [1; ds_j],   K_j = -F_nn^-1 F_n.,   C_j = F_.. + F_.n K_j

C_0 is what is solved for s_0 as without noise; then the steps follow forwards, and so does the covariance: given the samples,
dnu_j = K_j [1; ds_j] + an error of covariance F_nn^-1 that is independent of ds_j, so that only positive terms are ever added.

Bounds are rows of N_j with a large weight where the trajectory is outside them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from observers.numerics import linear, tiles
from observers.pseudospectral.window import condense, groups
from observers.pseudospectral.window.gauss_newton import Constraints, Solve, conditioning_of, free_step, prior, square
from observers.pseudospectral.window.problem import LeastSquares

FIRM = 1e6  # weight of a bound that is exceeded, against the sum of the samples', both in nominal units
SMALL = 16  # unknowns of a segment up to which its matrices are written out
FELT = 1e-5  # by how much one may be exceeded, in nominal units, before it counts as giving way


@dataclass(frozen=True)
class _Stage:
    """A segment of the chain: T, of N what the samples (`N`) and the bounds (`firm`) give, `sol` = d V / d [1; s; noise], the
    noise's `std`, `outside` by how much bounds are exceeded.
    """

    T: Any
    N: Any
    firm: Any
    sol: Any
    std: Any
    outside: Any


def newton_step(solve: Solve) -> ca.Function:
    """As `gauss_newton.newton_step`, of a problem with noise; `at` has `trajectory.sample_rows` of such a problem."""
    problem = solve.problem
    ns, nw, count, scale = len(problem.scale), problem.n_noise, problem.count, tuple(problem.scale)
    V, Z, s, noise, *_ = condense.symbols(problem, ca.MX)
    g = {name: ca.MX.sym(name, size) for name, size in solve.given.items()}
    length = ca.MX.sym("length")
    active = [g["active"][j] for j in range(count)] if count > 1 else [ca.MX(1)]
    nus = problem.chop(noise, nw)
    stages, Z_new = _stages(solve, V, Z, s, noise, g, active)

    gains: list[Any] = []
    inverses: list[Any] = []
    to_go = ca.MX(ca.DM.zeros(1 + ns, 1 + ns))
    eliminate = _when(
        _eliminate(ns, nw, problem.segment.sample_time), {0: 4}, {2: ca.DM.eye(nw) / problem.segment.sample_time}
    )
    for j in reversed(range(count)):
        stage = stages[j]
        to_go, gain, inverse = eliminate(active[j], stage.N + stage.firm, stage.T, stage.std, nus[j], to_go)
        gains.insert(0, gain)
        inverses.insert(0, inverse)
    samples = to_go
    if solve.arrival:
        to_go = to_go + prior(ns)(s, g["prior_mean"], g["prior_information"])
    determined = [g["determined"]] if solve.waits else []
    step, conditioning, _, inverse = free_step(scale, solve.waits)(to_go, g["lam"], *determined)
    if solve.arrival:
        conditioning = conditioning_of(scale)(samples, g["lam"])

    follow = _when(_follow(ns, nw, problem.n_rates), {0: 0, 1: 1}, {})
    ds, shortened, cost, rates, noises = step, length * step, ca.MX(0), [], []
    for j, stage in enumerate(stages):
        ds, shortened, dnu, dV, part = follow(
            active[j], ds, shortened, gains[j], stage.T, stage.sol, stage.N, stage.std, length
        )
        rates.append(dV)
        noises.append(dnu)
        cost = cost + part
    dV, dnu = ca.vertcat(*rates), ca.vertcat(*noises)
    weights = np.tile(1 / problem.rate_scale, problem.segment.order * count) if problem.n_rates else np.zeros(0)
    size = ca.sumsqr(step / problem.scale) + ca.sumsqr(dnu) + (ca.sumsqr(dV * weights) if problem.n_rates else 0)
    covariance = _covariance(problem, g, active, stages, gains, inverses, inverse)
    slack = ca.mmax(ca.vertcat(0, *[stage.outside - FELT for stage in stages])) if solve.constraints.any else 0
    moved = [V + dV, Z_new, s + length * step, noise + length * dnu]
    results = [*moved, size, ca.fmax(cost, 0), conditioning, ca.vec(covariance), slack]
    return ca.Function("newton", [V, Z, s, noise, length, *g.values()], results)


def _stages(
    solve: Solve, V: Any, Z: Any, s: Any, noise: Any, g: Mapping[str, Any], active: list[Any]
) -> tuple[list[_Stage], Any]:
    """The chain at (V, Z, s, noise), and the algebraic variables at the nodes."""
    problem, ns = solve.problem, len(solve.problem.scale)
    n, nx = 1 + ns + problem.n_noise, problem.nx
    start = ca.MX(ca.DM(np.eye(nx, n, 1)))
    stds = problem.chop(g["noise_std"], problem.n_noise)
    thetas = problem.thetas(s[nx:], noise * g["noise_std"])
    functions = [condense.segment(problem, j, ca.MX) for j in range(min(problem.count, 2))]
    functions = [_when(f, {0: 0, 4: 3}, {}) for f in functions]
    transition = _transition(problem)
    bounds = _bounds(problem, solve.constraints) if solve.constraints.any else None
    firm_weight = FIRM * ca.sum1(g["w"])
    stages, found_z, xs = [], [], s[:nx]
    for j, (v, z) in enumerate(condense.segments(problem, V, Z)):
        physical = stds[j] * noise[j * problem.n_noise : (j + 1) * problem.n_noise]
        data = g["data"][problem.data_of(j)] + ca.MX(ca.DM(problem.noise_terms(j))) @ physical
        place = problem.measured(j)
        arguments = [xs, start, v, z, thetas[j], data, g["p"], g["y"][place], g["w"][place]]
        if problem.sees_jumps:
            arguments.append(physical[len(problem.noisy_states) :])
        x_end, R_end, N, sol, z_new, _, _, X, G, P, Q = functions[min(j, 1)](active[j], *arguments)
        T = transition(R_end, stds[j])
        firm, outside = ca.MX(ca.DM.zeros(n, n)), ca.MX(0)
        if bounds is not None:
            firm, outside = bounds[min(j, 1)](active[j], xs, thetas[j], X, G, P, Q, firm_weight)
        stages.append(_Stage(T, N, firm, sol, stds[j], outside))
        found_z.append(z_new)
        xs = x_end
    return stages, ca.vertcat(*found_z)


def _covariance(
    problem: LeastSquares,
    g: Mapping[str, Any],
    active: list[Any],
    stages: list[_Stage],
    gains: list[Any],
    inverses: list[Any],
    inverse: Any,
) -> Any:
    """That of the state at the sample `at` and of theta there, for samples of variance 1 / w; `inverse` in units of the nominal values."""
    ns = len(problem.scale)
    S = ca.diag(ca.DM(problem.scale))
    P = S @ inverse @ S
    there = ca.MX(ca.DM.zeros(ns, ns))
    joint, reach = _joint(ns, problem.n_noise), _reach(problem)
    spread = _when(_spread(ns, problem.n_noise), {0: 0}, {})
    chosen = _when(_spread(ns, problem.n_noise), {}, {})
    for j, stage in enumerate(stages):
        both = joint(P, gains[j], inverses[j])
        last = active[j] if j + 1 == len(stages) else active[j] - active[j + 1]
        there = there + chosen(last, P, both, reach(g["at"], stage.sol, stage.std))
        P = spread(active[j], P, both, stage.T[1:, 1:])
    return there


def _when(function: ca.Function, passed: Mapping[int, int], otherwise: Mapping[int, Any]) -> ca.Function:
    """(condition, *arguments): `function` where the condition holds; else result i is the argument passed[i], otherwise[i], or 0."""
    arguments = [ca.MX.sym(function.name_in(i), function.sparsity_in(i)) for i in range(function.n_in())]
    results = [
        arguments[passed[i]] if i in passed else ca.MX(otherwise.get(i, ca.DM.zeros(*function.size_out(i))))
        for i in range(function.n_out())
    ]
    skip = ca.Function(f"{function.name()}_skipped", arguments, results)
    return ca.Function.if_else(f"maybe_{function.name()}", function, skip)


def _transition(problem: LeastSquares) -> ca.Function:
    """(d x_end / d [1; s; w; eta], std) -> T: [1; ds] of the next segment by v; theta jumps at the segment's end."""
    ns, nx, nw = len(problem.scale), problem.nx, problem.n_noise
    n = 1 + ns + nw
    R, std = ca.SX.sym("R", nx, n), ca.SX.sym("std", nw)
    full = ca.vertcat(ca.SX(ca.DM.eye(n)[:1, :]), R, ca.SX(ca.DM(_theta_rows(problem))))
    units = ca.diag(ca.vertcat(ca.SX.ones(1 + ns), std))
    return ca.Function("transition", [R, std], [ca.densify(ca.mtimes(full, units))])


def _theta_rows(problem: LeastSquares) -> np.ndarray:
    """d theta / d [1; s; w; eta] after the jump."""
    nx, nt, nwx = problem.nx, problem.n_theta, len(problem.noisy_states)
    rows = np.zeros((nt, 1 + nx + nt + problem.n_noise))
    rows[:, 1 + nx : 1 + nx + nt] = np.eye(nt)
    for k, i in enumerate(problem.noisy_parameters):
        rows[i, 1 + nx + nt + nwx + k] = 1
    return rows


def _kind(ns: int, nw: int) -> Any:
    """Straight-line functions while they are short, products in loops beyond."""
    return ca.SX if ns + nw <= SMALL else ca.MX


def _eliminate(ns: int, nw: int, unit: float) -> ca.Function:
    """(N, T, std, nu, cost to go) -> (cost to go of the segment before, K, F_nn^-1); N in physical units, the rest in v.

    `unit` is the weight of |nu|^2.
    """
    m, n, kind = 1 + ns, 1 + ns + nw, _kind(ns, nw)
    N, T, C = kind.sym("N", n, n), kind.sym("T", m, n), kind.sym("C", m, m)
    std, nu = kind.sym("std", nw), kind.sym("nu", nw)
    units = ca.vertcat(kind(ca.DM.ones(m)), std)
    F = N * ca.mtimes(units, units.T) + ca.mtimes([T.T, C, T])
    corner = F[m:, m:] + unit * ca.DM.eye(nw)
    side = F[m:, :m] + unit * ca.horzcat(nu, ca.DM.zeros(nw, ns))
    right = ca.horzcat(-side, kind(ca.DM.eye(nw)))
    solved = linear.solver(nw, m + nw)(corner, right) if nw <= SMALL else tiles.solve(corner, right)[0]
    K, inverse = solved[:, :m], solved[:, m:]
    rest = F[:m, :m] + ca.mtimes(side.T, K)
    rest[0, 0] += unit * ca.dot(nu, nu)
    rest = (rest + rest.T) / 2
    return ca.Function("eliminate", [N, T, std, nu, C], [ca.densify(rest), ca.densify(K), ca.densify(inverse)])


def _follow(ns: int, nw: int, n_rates: int) -> ca.Function:
    """(ds, the same shortened, K, T, sol, N, std, length) -> (both at the next segment, dnu, dV, the samples' cost)."""
    n = 1 + ns + nw
    ds, short, K, T = ca.MX.sym("ds", ns), ca.MX.sym("short", ns), ca.MX.sym("K", nw, 1 + ns), ca.MX.sym("T", 1 + ns, n)
    sol, N, std = ca.MX.sym("sol", n_rates, n), ca.MX.sym("N", n, n), ca.MX.sym("std", nw)
    length = ca.MX.sym("length")
    dnu = K @ ca.vertcat(1, ds)
    whole, part = ca.vertcat(1, ds, dnu), ca.vertcat(1, short, length * dnu)
    dV = sol @ ca.vertcat(1, short, length * std * dnu) if n_rates else ca.MX(0, 1)
    cost = square(n)(N, ca.vertcat(1, ds, std * dnu))
    results = [(T @ whole)[1:], (T @ part)[1:], dnu, dV, cost]
    return ca.Function("follow", [ds, short, K, T, sol, N, std, length], results)


def _joint(ns: int, nw: int) -> ca.Function:
    """(P, K, F_nn^-1) -> the covariance of [ds; dnu]."""
    kind = _kind(ns, nw)
    P, K, inverse = kind.sym("P", ns, ns), kind.sym("K", nw, 1 + ns), kind.sym("inverse", nw, nw)
    PK = ca.mtimes(P, K[:, 1:].T)
    both = ca.vertcat(ca.horzcat(P, PK), ca.horzcat(PK.T, ca.mtimes(K[:, 1:], PK) + inverse))
    return ca.Function("joint", [P, K, inverse], [ca.densify(both)])


def _spread(ns: int, nw: int) -> ca.Function:
    """(P, joint covariance, rows) -> rows joint rows'; P is what it replaces."""
    kind = _kind(ns, nw)
    P, both, rows = kind.sym("P", ns, ns), kind.sym("both", ns + nw, ns + nw), kind.sym("rows", ns, ns + nw)
    return ca.Function("spread", [P, both, rows], [ca.densify(ca.mtimes([rows, both, rows.T]))])


def _reach(problem: LeastSquares) -> ca.Function:
    """(at, sol, std) -> d [x; theta] / d [s; nu] at the sample `at` of a segment."""
    nx, ns, nw, nwx = problem.nx, len(problem.scale), problem.n_noise, len(problem.noisy_states)
    width = nx + problem.n_rates + nwx
    at, sol = ca.MX.sym("at", nx * width + 1), ca.MX.sym("sol", problem.n_rates, 1 + ns + nw)
    std = ca.MX.sym("std", nw)
    rows, ended = ca.reshape(at[: nx * width], nx, width), at[nx * width]
    x = ca.horzcat(rows[:, :nx], ca.DM.zeros(nx, ns - nx), rows[:, width - nwx :], ca.DM.zeros(nx, nw - nwx))
    if problem.n_rates:
        x = x + rows[:, nx : width - nwx] @ sol[:, 1:]
    theta = _theta_rows(problem)[:, 1:]
    before = np.where(np.arange(ns + nw) < ns, theta, 0.0)
    theta_there = ca.if_else(ended, ca.DM(theta), ca.DM(before)) if problem.n_theta else ca.MX(0, ns + nw)
    units = ca.repmat(ca.vertcat(ca.DM.ones(ns), std).T, ns, 1)
    return ca.Function("reach", [at, sol, std], [ca.densify(ca.vertcat(x, theta_there) * units)])


def _bounds(problem: LeastSquares, c: Constraints) -> list[ca.Function]:
    """(xs, theta, X, G, P, Q, weight) -> (rows of the bounds and path constraints that are exceeded, as a matrix in [1; s; noise], the
    largest excess in nominal units) of the first segment, whose first state is bounded too, and of a later one.
    """
    nx, nt, nw = problem.nx, problem.n_theta, problem.n_noise
    n, order, bounded, path = 1 + nx + nt + nw, problem.segment.order, list(problem.bounded), problem.path
    functions = []
    for first in (True, False):
        xs, theta, weight = ca.MX.sym("xs", nx), ca.MX.sym("theta", nt), ca.MX.sym("weight")
        X, G = ca.MX.sym("X", len(bounded) * order), ca.MX.sym("G", len(bounded) * order, n)
        limits = path.ny * len(path.points_of(0 if first else 1)) if path is not None else 0
        P, Q = ca.MX.sym("P", limits), ca.MX.sym("Q", limits, n)
        own = list(range(nx)) if first else []
        value = ca.vertcat(X, P, xs[own] if own else ca.MX(0, 1), theta)
        lower = np.concatenate([np.tile(c.node_lower, order), np.full(limits, -np.inf), c.lower[own], c.lower[nx:]])
        upper = np.concatenate([np.tile(c.node_upper, order), np.zeros(limits), c.upper[own], c.upper[nx:]])
        path_unit = np.tile(path.output_scale, limits // path.ny) if path is not None else np.zeros(0)
        unit = np.concatenate(
            [np.tile(problem.scale[bounded], order), path_unit, problem.scale[own], problem.scale[nx:]]
        )
        selected = np.zeros((len(own) + nt, n))
        selected[:, [1 + i for i in own] + [1 + nx + i for i in range(nt)]] = np.eye(len(own) + nt)
        beyond = ca.fmax(value - ca.DM(_finite(upper)), 0) - ca.fmax(ca.DM(_finite(lower)) - value, 0)
        weights = weight * ca.DM(1 / unit**2) * (beyond != 0)
        matrix = groups.normal(value.numel(), n)(beyond, ca.vertcat(G, Q, ca.DM(selected)), weights)
        result = [matrix, ca.norm_inf(beyond / ca.DM(unit))]
        function = ca.Function("bounds_first" if first else "bounds_later", [xs, theta, X, G, P, Q, weight], result)
        functions.append(_when(function, {}, {}))
    return functions


def _finite(bound: np.ndarray) -> np.ndarray:
    return np.clip(bound, -1e300, 1e300)
