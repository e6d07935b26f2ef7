"""One Gauss-Newton step of the windowed least-squares problem, and what it is subject to.

With the linearisation of `condense`, the step in s = [x0; theta] minimises

    |r + M_0 + M ds|^2_W + |s + ds - sbar|^2_Pinv + lam |ds|^2                   (the arrival cost where there is one)

subject to bounds on theta and x0 (a box), on the states at the nodes, on the outputs at the measured points, and to path constraints
(rows with one common slack). Where the free step satisfies them all it is the solution.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from observers.numerics import linear, tiles
from observers.pseudospectral.window import condense, trajectory
from observers.pseudospectral.window.problem import LeastSquares
from observers.pseudospectral.window.quadratic_program import quadratic_program

SLACK_WEIGHT = 1e3  # of a violated row, against the mean square of the residuals in nominal units
FEW_UNKNOWNS = 4  # beyond, samples come and go before they determine all
DAMPED = 1e-4  # of the largest diagonal entry: what holds a step where the samples do not determine it
FAR = 1e-2  # weight of the step in Problem 3, which has no curvature of its own


@dataclass(frozen=True)
class Constraints:
    """What the solution is subject to: `lower`, `upper` (ns) bounds of s, `node_lower`, `node_upper` those of the problem's bounded
    states, `tube` whether the outputs are bounded too, `path` whether the problem has path constraints; infinite entries bound nothing.
    """

    lower: np.ndarray
    upper: np.ndarray
    node_lower: np.ndarray
    node_upper: np.ndarray
    tube: bool = False
    path: bool = False

    @property
    def any(self) -> bool:
        bounds = np.concatenate([self.lower, self.upper, self.node_lower, self.node_upper])
        return self.tube or self.path or bool(np.isfinite(bounds).any())


@dataclass(frozen=True)
class Solve:
    """A problem, what it is subject to, and whether an arrival cost belongs to it.

    `aim`: Problem 3 instead, in which the weights w (ny m) hold the direction in which the outputs are to go as far as they can.
    """

    problem: LeastSquares
    constraints: Constraints
    arrival: bool = False
    aim: bool = False

    @property
    def waits(self) -> bool:
        """Whether steps are damped while the samples do not determine them: there are many unknowns, and no past that decides."""
        return len(self.problem.scale) > FEW_UNKNOWNS and not (self.arrival or self.aim)

    @property
    def given(self) -> dict[str, int]:
        """Names and lengths of what is fixed within a solve."""
        problem, ns = self.problem, len(self.problem.scale)
        measured = problem.ny * problem.n_measured
        sizes = {"data": problem.n_data, "p": problem.n_parameters, "y": measured, "w": measured, "lam": 1}
        if problem.count > 1:
            sizes["active"] = problem.count
        if not self.aim:
            sizes["at"] = trajectory.sample_rows(problem).numel_out()
        if problem.n_noise:
            sizes["noise_std"] = problem.count * problem.n_noise
        if self.waits:
            sizes["determined"] = 2
        if self.arrival:
            sizes |= {"prior_mean": ns, "prior_information": ns * ns}
        if self.constraints.tube:
            sizes |= {"lower": measured, "upper": measured, "mask": measured}
        return sizes


def newton_step(solve: Solve) -> ca.Function:
    """Function newton(V, Z, s, noise, length, *given) -> (V+, Z+, s+, noise+, size, cost, conditioning, covariance, slack).

    The correction of V for its collocation residual is always whole; `length` is the part taken of the step in s, and of V's with it.
    `size` is |scaled step|^2 (NaN or infinite if the step failed), `cost` the samples' weighted sum of squares that the linearisation
    predicts after the whole step, `conditioning` in [0, 1] the smallest pivot of their scaled normal matrix over the largest, `covariance`
    (ns^2, none of Problem 3) that of the state at the sample `at` and of theta for samples of variance 1 / w, constraints left aside,
    `slack` by how much the rows had to be relaxed, in nominal units.
    """
    problem = solve.problem
    kind = ca.MX if solve.constraints.any else problem.kind
    V, Z, s, noise, *_ = condense.symbols(problem, kind)
    g = {name: kind.sym(name, size) for name, size in solve.given.items()}
    whole = kind.sym("length")
    length: Any = whole
    at = condense.linearise(problem, V, Z, s, g)
    normal = at.normal
    if solve.arrival:
        normal = normal + prior(len(problem.scale))(s, g["prior_mean"], g["prior_information"])
    if solve.aim:
        normal = _aim(tuple(problem.scale), at.sensitivity.shape[0])(at.sensitivity, g["w"])
    determined = [g["determined"]] if solve.waits else []
    step, conditioning, cost, inverse = free_step(tuple(problem.scale), solve.waits)(normal, g["lam"], *determined)
    covariance = kind(0, 1) if solve.aim else _covariance(tuple(problem.scale))(inverse, at.reached[:, 1:])
    if solve.arrival:
        conditioning = conditioning_of(tuple(problem.scale))(at.normal, g["lam"])
    slack: Any = 0
    if solve.constraints.any:
        # A linear objective goes to and fro between two corners where the edge between them is curved: then the step is kept short.
        reach = ca.if_else(length < 1, length, np.inf) if solve.aim else np.inf
        step, slack, ok = _constrained(solve, s, at, normal, g, reach)
        step = ca.if_else(ok, step, np.inf)
        length = 1 if solve.aim else length
    if not solve.aim and (solve.arrival or solve.constraints.any):
        # The samples' alone, at the step that is taken.
        cost = ca.fmax(square(len(problem.scale) + 1)(at.normal, ca.vertcat(1, step)), 0)
    full = ca.vertcat(1, length * step)
    dV = (
        ca.vertcat(*[tiles.product(block.shape[0], full.shape[0])(block, full) for block in at.sol])
        if problem.n_rates
        else kind(0, 1)
    )
    weights = np.tile(1 / problem.rate_scale, problem.segment.order * problem.count) if problem.n_rates else np.zeros(0)
    size = ca.sumsqr(step / problem.scale) + (ca.sumsqr(dV * weights) if problem.n_rates else 0)
    results = [V + dV, at.Z, s + length * step, noise, size, cost, conditioning, covariance, slack]
    return ca.Function("newton", [V, Z, s, noise, whole, *g.values()], results)


def prior(ns: int) -> ca.Function:
    """|s + ds - mean|^2_information as a symmetric matrix in [1; ds]."""
    kind = tiles.kind(ns)
    s, mean, information = kind.sym("s", ns), kind.sym("mean", ns), kind.sym("information", ns * ns)
    P = ca.reshape(information, ns, ns)
    right = ca.mtimes(P, s - mean)
    full = ca.vertcat(ca.horzcat(ca.dot(s - mean, right), right.T), ca.horzcat(right, P))
    return ca.Function("prior", [s, mean, information], [full])


def square(n: int) -> ca.Function:
    """v' H v."""
    kind = tiles.kind(n - 1)
    H, v = kind.sym("H", n, n), kind.sym("v", n)
    return ca.Function("square", [H, v], [ca.dot(v, ca.mtimes(H, v))])


def _aim(scale: tuple[float, ...], m: int) -> ca.Function:
    """-2 w' M ds + FAR |ds / scale|^2 as a symmetric matrix in [1; ds]."""
    kind = tiles.kind(len(scale))
    M, w = kind.sym("M", m, 1 + len(scale)), kind.sym("w", m)
    slope = -ca.mtimes(M[:, 1:].T, w)
    curvature = kind(ca.diag(ca.DM(FAR / np.array(scale) ** 2)))
    full = ca.vertcat(ca.horzcat(0, slope.T), ca.horzcat(slope, curvature))
    return ca.Function("aim", [M, w], [ca.densify(full)])


def free_step(scale: tuple[float, ...], waits: bool = False) -> ca.Function:
    """(step, conditioning, cost after the step, inverse in units of `scale`) from the matrix of squares and the regularisation.

    With `waits` a last argument is the conditioning up to which the step is damped (Levenberg's), and the longest that is not, the root
    of its mean square in units of `scale`: a damped step moves what the samples determine, and leaves the rest near where it is. Its
    conditioning is not above the limit.
    """
    ns, kind = len(scale), tiles.kind(len(scale))
    solve = linear.ldl_solve if kind is ca.SX else tiles.solve

    def body(full: Any, lam: Any, determined: Any = None) -> tuple[Any, ...]:
        S = ca.diag(ca.DM(scale))
        H, g = ca.mtimes([S, full[1:, 1:], S]), ca.mtimes(S, full[1:, 0])
        H_solved, conditioning = H + lam * ca.DM.eye(ns), None
        if determined is not None:
            step, pivots = solve(H_solved, -g)
            conditioning = (ca.mmin(pivots) - lam) / ca.mmax(pivots)
            free = ca.logic_and(conditioning > determined[0], ca.sumsqr(step) < ns * determined[1] ** 2)
            H_solved = H_solved + ca.if_else(free, 0, DAMPED * ca.mmax(ca.diag(H))) * ca.DM.eye(ns)
            conditioning = ca.if_else(free, conditioning, ca.fmin(conditioning, determined[0]))
        solved, pivots = solve(H_solved, ca.horzcat(-g, ca.DM.eye(ns)))
        step, inverse = solved[:, 0], solved[:, 1:]
        cost = full[0, 0] + 2 * ca.dot(g, step) + ca.dot(step, ca.mtimes(H, step))
        if conditioning is None:
            conditioning = (ca.mmin(pivots) - lam) / ca.mmax(pivots)
        return ca.mtimes(S, step), conditioning, ca.fmax(cost, 0), inverse

    return tiles.function("reduced", (ns + 1, ns + 1), (1, 1), *[(2, 1)] * waits, kind=kind)(body)


def _covariance(scale: tuple[float, ...]) -> Callable[[Any, Any], Any]:
    """(inverse, d x / d s at some time) -> the covariance of [x; theta] there, stacked; `inverse` is that of s in units of `scale`."""

    def of(inverse: Any, reached: Any) -> Any:
        nx, ns = reached.shape
        kind = tiles.kind(ns)
        inv, R = kind.sym("inverse", ns, ns), kind.sym("reached", nx, ns)
        T = ca.mtimes(ca.vertcat(R, ca.horzcat(kind(ns - nx, nx), kind.eye(ns - nx))), ca.diag(ca.DM(scale)))
        whole = ca.densify(ca.mtimes([T, inv, T.T]))
        return ca.Function("covariance", [inv, R], [ca.vec(whole)])(inverse, reached)

    return of


def conditioning_of(scale: tuple[float, ...]) -> ca.Function:
    """That of `free_step` alone."""
    ns, kind = len(scale), tiles.kind(len(scale))
    full, lam = kind.sym("full", ns + 1, ns + 1), kind.sym("lam")
    if kind is ca.SX:
        return ca.Function("conditioning", [full, lam], [free_step(scale)(full, lam)[1]])
    S = ca.diag(ca.DM(scale))
    _, pivots = tiles.solve(ca.mtimes([S, full[1:, 1:], S]) + lam * ca.DM.eye(ns), ca.DM.zeros(ns, 1))
    return ca.Function("conditioning", [full, lam], [(ca.mmin(pivots) - lam) / ca.mmax(pivots)])


def _active(g: Mapping[str, Any], rows: list[int]) -> Any:
    """Whether each of a segment's `rows` counts: of a segment without a sample yet nothing is known."""
    if "active" not in g:
        return 1
    return ca.vertcat(*[ca.repmat(g["active"][j], count, 1) for j, count in enumerate(rows)])


def _constrained(
    solve: Solve, s: Any, at: condense.Linearised, normal: Any, g: dict[str, Any], reach: Any
) -> tuple[Any, Any, Any]:
    """(step, slack, ok): the step under the constraints, as a small quadratic program in units of the nominal values; none of its entries
    beyond `reach`."""
    problem, c = solve.problem, solve.constraints
    ns, scale = len(problem.scale), ca.DM(problem.scale)
    A, b, mask = [], [], []

    def rows(slope: Any, room: Any, there: Any) -> None:
        A.append(slope)
        b.append(room)
        mask.append(there)

    if c.tube:
        unit = ca.DM(np.tile(1 / problem.output_scale, problem.n_measured))
        predicted, M = at.residual + at.sensitivity[:, 0] + g["y"], at.sensitivity[:, 1:] * ca.repmat(unit, 1, ns)
        rows(M, unit * (g["upper"] - predicted), g["mask"])
        rows(-M, unit * (predicted - g["lower"]), g["mask"])
    if problem.bounded:
        repeat = problem.segment.order * problem.count
        unit = ca.DM(np.tile(1 / problem.scale[list(problem.bounded)], repeat))
        predicted, G = at.nodes + at.node_sensitivity[:, 0], at.node_sensitivity[:, 1:]
        for sign, bound in ((1.0, c.node_upper), (-1.0, c.node_lower)):
            there = np.isfinite(bound)
            room = sign * (ca.DM(np.tile(np.where(there, bound, 0.0), repeat)) - predicted)
            here = ca.DM(np.tile(there.astype(float), repeat)) * _active(
                g, [len(bound) * problem.segment.order] * problem.count
            )
            rows(sign * G * ca.repmat(unit, 1, ns), unit * room, here)
    if problem.path is not None:
        path = problem.path
        each = [path.ny * len(path.points_of(j)) for j in range(path.count)]
        unit = ca.DM(np.tile(1 / path.output_scale, path.n_measured))
        predicted, Q = at.path + at.path_sensitivity[:, 0], at.path_sensitivity[:, 1:]
        rows(Q * ca.repmat(unit, 1, ns), -unit * predicted, _active(g, each) * ca.DM.ones(sum(each)))
    if not A:
        rows(ca.DM.zeros(1, ns), ca.DM.zeros(1), ca.DM.zeros(1))
    # The program is in the mean square of the residuals: the slack's weight is then one number for every window.
    unit = 1 / ca.fmax(ca.sum1(g["w"]), 1e-300) if not solve.aim else ca.DM(1)
    S = ca.diag(scale)
    H = unit * (S @ normal[1:, 1:] @ S) + (0 if solve.aim else unit * g["lam"]) * ca.DM.eye(ns)
    stacked = ca.vertcat(*A) @ S
    lower, upper = ((ca.DM(bound) - s) / scale for bound in (c.lower, c.upper))
    box = [ca.fmax(lower, -reach), ca.fmin(upper, reach)]
    arguments = [H, unit * (S @ normal[1:, 0]), stacked, ca.vertcat(*b), ca.vertcat(*mask), *box, SLACK_WEIGHT]
    q, slack, _, ok = quadratic_program(ns, stacked.shape[0])(*arguments)
    return scale * q, slack, ok
