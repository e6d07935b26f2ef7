"""Bounded measurement noise: section 3.4 of Gong, Ross & Kang 2007, (36) to (40) and Problem 3.

With |d_i| <= b the clean output lies in the tube sigma1 <= h(z(t_i)) <= sigma2 (38). For a new sample the tube is y +- b (39), cut with
what the past data leave possible (40): y_pre +- sqrt(J*), where J* of Problem 3 is how far a trajectory through the tube of the older
samples can be from the predicted output at the new one.

What deviates, and why: Problem 3 is solved on the window that ends with the new sample, so that the oldest sample has left it (a bound
that is slightly wider, and still a bound). It is solved for the largest and for the smallest output, each only locally: the bound gets a
margin (`tuning.bound_margin`), and where one of the two does not converge y +- b stays, which is counted. Bounds that have gone wrong all
the same mostly leave the window unnoticed; where they contradict the samples, all of the window's start again from y +- b.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers.component import Port
from observers.model import Model, ModelError
from observers.numerics.finite import HUGE
from observers.pseudospectral.method import Method
from observers.pseudospectral.sample import Instant, Window
from observers.pseudospectral.warm_start import Start
from observers.pseudospectral.window.condense import output_residual
from observers.pseudospectral.window.gauss_newton import Constraints, Solve
from observers.pseudospectral.window.iteration import iterate
from observers.pseudospectral.window.sliding import insert_sample
from observers.pseudospectral.window.trajectory import Trajectory

MET = 1e-6  # slack up to which Problem 3's solution lies in the tube, in nominal units


@dataclass(frozen=True)
class BoundPorts:
    """`tuning` parameters and `diagnostics` outputs."""

    tuning: tuple[Port, ...] = ()
    diagnostics: tuple[Port, ...] = ()


def ports_of(model: Model, noise_bound: float | Mapping[str, float] | None) -> BoundPorts:
    """The ports of a tube; none without a noise bound.

    Raises:
        ModelError: a bound of something that is no output, an output without one, or one that is not positive.
    """
    if noise_bound is None:
        return BoundPorts()
    given = dict(noise_bound) if isinstance(noise_bound, Mapping) else {v.name: noise_bound for v in model.outputs}
    names = [v.name for v in model.outputs]
    for name in {*given} ^ {*names}:
        raise ModelError(f"pseudospectral: noise_bound of '{name}'; the outputs are {', '.join(names)}")
    several = len(names) > 1
    tuning: list[Port] = []
    lower: list[Port] = []
    upper: list[Port] = []
    for i, v in enumerate(model.outputs, start=1):
        if not given[v.name] > 0:
            raise ModelError(f"pseudospectral: noise_bound of '{v.name}' = {given[v.name]:g} must be positive")
        index, what = f"[{i}]" if several else "", v.description or v.name
        text = f"bound of the measurement noise of {what}"
        tuning.append(
            Port(f"tuning.noise_bound{index}", text, v.unit, given[v.name], v.nominal, min=0.0, variability="tunable")
        )
        for which, ports, text in (("lower", lower, "sigma1, lower"), ("upper", upper, "sigma2, upper")):
            text = f"{text} bound of the clean {what} at the last sample"
            ports.append(Port(f"diagnostics.{which}{index}", text, v.unit, nominal=v.nominal, variability="discrete"))
    margin = Port(
        "tuning.bound_margin",
        "widening of Problem 3's bound, in units of the outputs' nominal values; large: y +- b alone",
        start=5e-3,
        min=0.0,
        variability="tunable",
    )
    counts = (
        Port(
            "diagnostics.refined_bounds",
            "outputs' samples so far whose bound Problem 3 gave",
            kind="Integer",
            variability="discrete",
        ),
        Port(
            "diagnostics.bound_fallbacks",
            "outputs' samples so far for which Problem 3 failed: y +- b",
            kind="Integer",
            variability="discrete",
        ),
    )
    return BoundPorts((*tuning, margin), (*lower, *upper, *counts))


def state(model: Model, constraints: Constraints, L: int) -> dict[str, int]:
    """Sizes of what is kept from sample to sample: the window's bounds, and the values of the diagnostics."""
    ny = len(model.outputs) if constraints.tube else 0
    return {"lower": ny * (L + 1), "upper": ny * (L + 1), "bounds": 2 * ny + 2 if constraints.tube else 0}


def bounds(
    method: Method, now: Instant, window: Window, start: Start, given: Mapping[str, Any], residual: Any
) -> dict[str, Any]:
    """The window's bounds `lower`, `upper` with those of the new sample, and the diagnostics' values.

    `given` is what is fixed within a solve of Problem 2, `residual` h - y along the warm start.
    """
    s, q, problem, ny = now.s, now.q, method.problem, method.problem.ny
    y, W = window.y, window.W
    refined, fallbacks = s.bounds[2 * ny], s.bounds[2 * ny + 1]
    b, scale = q.noise_bound, ca.DM(problem.output_scale)
    insert = insert_sample(ny, method.samples + 1)
    older = [insert(column, ca.DM.zeros(ny), s.k) for column in (s.lower, s.upper)]
    places = ca.DM(range(ny * problem.n_measured))
    known = {**given, "lower": older[0], "upper": older[1], "mask": W * (places < window.place * ny)}
    reach = _reach(method, q, start.trajectory, known)
    warm = start.warm
    lower, upper = [], []
    for i in range(ny):
        mine = places == window.place * ny + i
        predicted = ca.dot(mine, residual) + y[i]
        wanted = ca.logic_and(ca.logic_and(warm, ca.sum1(W) > len(problem.scale)), window.valid[i])
        furthest, met = reach(wanted, mine, predicted)
        radius = furthest + q.bound_margin * scale[i]
        sigma1, sigma2 = ca.fmax(y[i] - b[i], predicted - radius), ca.fmin(y[i] + b[i], predicted + radius)
        ok = ca.logic_and(met, sigma1 < sigma2)
        lower.append(ca.if_else(ok, sigma1, y[i] - b[i]))
        upper.append(ca.if_else(ok, sigma2, y[i] + b[i]))
        refined, fallbacks = refined + ok, fallbacks + ca.logic_and(wanted, ca.logic_not(ok))
    newest = [ca.vertcat(*lower), ca.vertcat(*upper)]
    return {
        "lower": insert(s.lower, newest[0], s.k),
        "upper": insert(s.upper, newest[1], s.k),
        "bounds": ca.vertcat(*newest, refined, fallbacks),
    }


def _reach(
    method: Method, q: SimpleNamespace, at: Trajectory, known: Mapping[str, Any]
) -> Callable[[Any, Any, Any], tuple[Any, Any]]:
    """Problem 3: (wanted, which output, its prediction) -> (how far from it the tube lets that output be, whether both ways were found).

    Each way from the prediction first, then from where the other way ended: a local solution is not always the furthest.
    """
    problem_3 = Solve(method.problem, method.constraints, aim=True)
    solve, residual = iterate(problem_3), output_residual(method.problem)

    def reach(wanted: Any, mine: Any, predicted: Any) -> tuple[Any, Any]:
        starts: list[tuple[Any, ...]] = [at, at]
        furthest, found = ca.MX(0), wanted
        for turn in range(2):
            ends = []
            for sign, start in ((1.0, starts[1]), (-1.0, starts[0])):
                own = {**known, "w": sign * mine}
                arguments = [q.tolerance, q.iteration_limit, *[own[name] for name in problem_3.given]]
                V, Z, unknown, noise, size, _, _, _, slack, _ = solve(wanted, *start, *arguments)
                along = residual(V, Z, unknown, noise, known["data"], known["p"], known["y"])
                value = ca.dot(mine, along + known["y"])
                met = ca.logic_and(ca.logic_and(size < q.tolerance**2, slack < MET), ca.fabs(value) < HUGE)
                furthest = ca.fmax(furthest, ca.if_else(met, sign * (value - predicted), 0))
                found = ca.logic_and(found, met) if turn == 0 else found
                ends.append(tuple(ca.if_else(met, b, a) for a, b in zip(at, (V, Z, unknown, noise), strict=True)))
            starts = ends
        return furthest, found

    return reach


def released(
    method: Method, now: Instant, window: Window, made: Mapping[str, Any], contradiction: Any
) -> dict[str, Any]:
    """`bounds`' result `made` with y +- b for the whole window where `contradiction`, counted as a fallback."""
    ny, noise_bound = method.problem.ny, now.q.noise_bound
    b = ca.repmat(noise_bound, method.problem.n_measured, 1)
    lower, upper = (
        ca.if_else(contradiction, window.Y + sign * b, made[name]) for name, sign in (("lower", -1), ("upper", 1))
    )
    newest = ca.vertcat(window.y - noise_bound, window.y + noise_bound)
    counts = made["bounds"][2 * ny :] + ca.vertcat(0, contradiction)
    shown = ca.if_else(contradiction, newest, made["bounds"][: 2 * ny])
    return {"lower": lower, "upper": upper, "bounds": ca.vertcat(shown, counts)}
