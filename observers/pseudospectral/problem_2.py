"""Steps 2 and 3 of the main algorithm of Gong, Ross & Kang 2007, section 3.1: the reference, and Problem 2."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from observers.numerics.finite import HUGE, kept
from observers.pseudospectral import arrival, bounded_noise
from observers.pseudospectral.method import Method
from observers.pseudospectral.sample import Instant, Window
from observers.pseudospectral.warm_start import Start
from observers.pseudospectral.window import lgl, trajectory
from observers.pseudospectral.window.condense import output_residual
from observers.pseudospectral.window.gauss_newton import Solve
from observers.pseudospectral.window.iteration import iterate
from observers.pseudospectral.window.spline import spline_matrix
from observers.pseudospectral.window.trajectory import Trajectory

NEAR = 1.0  # step, in nominal values, up to which a growing window of many unknowns is taken to determine them
VIOLATED = 1e-6  # slack beyond which the constraints contradict each other, in nominal units


@dataclass(frozen=True)
class Reference:
    """What the outputs are compared with in (19): `y` (ny m) at the measured points, and its weights.

    `point_weight` (ny m) [s] the share of each point in the integral, `weight` that over the squared unit of the output; `enough`, whether
    there are samples enough for a solve.
    """

    y: Any
    point_weight: Any
    weight: Any
    enough: Any


@dataclass(frozen=True)
class Solution:
    """What became of Problem 2 at this sample: its trajectory where it `goes_on`, else the one that it started from.

    `kept`: the prediction was good enough, without a solve. `failed`: the solve did not converge. `undetermined`: it did, but the window
    does not determine the state. `goes_on`: the next solve starts from its trajectory. `cost` of `trajectory`, `cost_after` of the
    solve; `conditioning`, `slack` and `iterations` as `iterate` returns them, `covariance` (ns^2) of [x; theta] at t_k, of which
    `fit_noise` is a factor.
    `bounds`: what `bounded_noise` keeps, empty without a tube.
    """

    trajectory: Trajectory
    accepted: Any
    kept: Any
    failed: Any
    undetermined: Any
    goes_on: Any
    cost: Any
    cost_after: Any
    conditioning: Any
    covariance: Any
    fit_noise: Any
    slack: Any
    iterations: Any
    bounds: Mapping[str, Any]


def reference(method: Method, now: Instant, window: Window, start: Start) -> Reference:
    """Step 2: the samples themselves, or the paper's spline through them at the nodes."""
    problem, q = method.problem, now.q
    if method.spline:
        y, point_weight, enough = _spline(method, now, window, start)
    else:
        y, point_weight = window.Y, problem.segment.sample_time * window.W
        enough = ca.sum1(window.W) >= (1 if method.arrival else len(problem.scale))
    if method.weighted:
        weight = ca.repmat(1 / q.measurement_noise**2, problem.n_measured, 1) * point_weight
    else:
        weight = ca.DM(np.tile(1 / problem.output_scale**2, problem.n_measured)) * point_weight
    return Reference(y, point_weight, weight, enough)


def _spline(method: Method, now: Instant, window: Window, start: Start) -> tuple[Any, Any, Any]:
    """y^s at the nodes, the LGL weights, and whether there are samples enough.

    The trajectory stands in for rejected samples, but a flat first guess is no data.
    """
    s, problem, ny, L = now.s, method.problem, method.problem.ny, method.samples
    segment = problem.segment
    matrix = spline_matrix(L, segment.node_times / segment.sample_time)
    V, Z, unknown, _ = start.trajectory
    outputs = trajectory.outputs_at_samples(problem, method.measure)
    along = outputs(V, Z, unknown[: problem.nx], s.theta, now.q.model, window.U, window.start)
    y = ca.MX(ca.DM(np.kron(matrix, np.eye(ny)))) @ ca.if_else(window.W, window.Y, along)
    point_weight = ca.MX(ca.DM(np.repeat(lgl.weights(segment.order) * segment.length / 2, ny)))
    all_there = ca.sum1(window.W) == ny * (L + 1)
    return y, point_weight, ca.logic_and(s.k >= L, ca.logic_or(all_there, start.warm))


def solve(method: Method, now: Instant, window: Window, start: Start, ref: Reference) -> Solution:
    """Step 3: Problem 2 from Z_initial. No solve without samples enough, nor where the prediction's cost is below `cost_threshold`."""
    problem, q = method.problem, now.q
    V, Z, unknown, noise = start.trajectory
    residual = output_residual(problem)(V, Z, unknown, window.noise_std * noise, window.data, q.model, ref.y)
    before = ca.dot(ref.weight, residual**2)
    waits = Solve(problem, method.constraints, method.arrival).waits
    wanted = ca.logic_and(ref.enough if not waits else 1, ca.sum1(window.valid) > 0)
    below = ca.logic_and(before < q.cost_threshold, start.warm)
    due = ca.logic_and(wanted, ca.logic_not(below))
    given = _given(method, now, window, ref)
    found, bounds = _solved(method, now, window, start, due, given, residual)
    *new, size, cost_after, conditioning, spread, slack, iterations = found
    converged, determined = _acceptable(method, now, new, size, due, conditioning > _conditioning_limit(now, ref))
    accepted = ca.logic_and(converged, determined)
    # A window that still grows and does not determine the state yet has not failed: it waits for more samples. One of many unknowns
    # follows the samples meanwhile, in steps that are damped.
    short = 0 if method.arrival else conditioning <= _conditioning_limit(now, ref)
    follows = ca.logic_and(ca.logic_and(due, short), size < len(problem.scale) * NEAR**2) if waits else 0
    waiting = ca.logic_and(short, ca.logic_or(ca.logic_not(window.moving), follows))
    waiting = ca.logic_and(ca.logic_and(due, ca.logic_not(converged)), waiting)
    goes_on = ca.logic_or(accepted, follows)
    pairs = zip(new, start.trajectory, strict=True)
    fit_noise = _noise(method, window, cost_after)
    return Solution(
        trajectory=Trajectory(*(ca.if_else(goes_on, after, old) for after, old in pairs)),
        accepted=accepted,
        kept=ca.logic_and(wanted, ca.logic_not(due)),
        failed=ca.logic_and(due, ca.logic_not(ca.logic_or(converged, waiting))),
        undetermined=ca.logic_or(ca.logic_and(converged, ca.logic_not(determined)), waiting),
        goes_on=goes_on,
        # Where the start lies outside the domain of the model's functions, so do they: nothing is lost by showing the last cost.
        cost=kept(ca.if_else(accepted, cost_after, ca.if_else(ref.enough, before, 0)), now.s.cost),
        cost_after=cost_after,
        conditioning=kept(conditioning, 0),
        covariance=spread * fit_noise,
        fit_noise=fit_noise,
        slack=kept(slack, 0),
        iterations=iterations,
        bounds=bounds,
    )


def _noise(method: Method, window: Window, cost: Any) -> Any:
    """The factor from the inverse of the weights' normal matrix to a covariance.

    Where tuning does not say what the measurement noise is, it is what the fit leaves: `cost`, whose degrees of freedom are the samples
    beyond the unknowns. The estimate's distribution is then Student's, whose variance has two degrees of freedom less.
    """
    if method.weighted:
        return method.problem.segment.sample_time
    return cost / ca.fmax(ca.sum1(window.W) - len(method.problem.scale) - 2, 1)


def _acceptable(method: Method, now: Instant, new: list[Any], size: Any, due: Any, determined: Any) -> tuple[Any, Any]:
    """Whether the solve converged, to numbers, and whether the samples determine the state; else the prediction is kept.

    With an arrival cost the past decides what the window leaves open.
    """
    sound = ca.sumsqr(ca.vertcat(*new)) < HUGE
    converged = ca.logic_and(ca.logic_and(due, sound), size < now.q.tolerance**2)
    return converged, 1 if method.arrival else determined


def _conditioning_limit(now: Instant, ref: Reference) -> Any:
    """The conditioning up to which the window does not determine the state; of fewer samples than unknowns none is enough."""
    return ca.if_else(ref.enough, now.q.conditioning_limit, 1)


def _given(method: Method, now: Instant, window: Window, ref: Reference) -> dict[str, Any]:
    """What stays fixed within a solve: the names of `Solve.given`, the tube aside."""
    q, Ts = now.q, method.problem.segment.sample_time
    given = {"data": window.data, "p": q.model, "y": ref.y, "w": ref.weight, "lam": q.regularisation}
    at = trajectory.sample_rows(method.problem)(window.place)
    return {
        **given,
        "at": at,
        "noise_std": window.noise_std,
        "active": window.active,
        "determined": ca.vertcat(_conditioning_limit(now, ref), ca.if_else(window.moving, HUGE, NEAR)),
        **arrival.given(method.arrival, now.s, method.problem.scale, Ts),
    }


def _solved(
    method: Method, now: Instant, window: Window, start: Start, due: Any, given: Mapping[str, Any], residual: Any
) -> tuple[Any, Mapping[str, Any]]:
    """`iterate`'s results where `due`, and section 3.4's bounds where there is a tube."""
    problem_2 = Solve(method.problem, method.constraints, method.arrival)
    iteration, limits = iterate(problem_2), [now.q.tolerance, now.q.iteration_limit]

    def run(go: Any, values: Mapping[str, Any]) -> Any:
        return iteration(go, *start.trajectory, *limits, *[values[name] for name in problem_2.given])

    if not method.constraints.tube:
        return run(due, given), {}
    bounds = bounded_noise.bounds(method, now, window, start, given, residual)
    tube = {"lower": bounds["lower"], "upper": bounds["upper"], "mask": window.W}
    found = run(due, {**given, **tube})
    # Bounds that contradict each other have gone wrong somewhere: all of them start again from y +- b.
    *_, slack, _ = found
    contradiction = ca.logic_and(due, ca.logic_not(slack <= VIOLATED))
    bounds = bounded_noise.released(method, now, window, bounds, contradiction)
    tube |= {"lower": bounds["lower"], "upper": bounds["upper"]}
    again = run(contradiction, {**given, **tube})
    return [ca.if_else(contradiction, b, a) for a, b in zip(found, again, strict=True)], bounds
