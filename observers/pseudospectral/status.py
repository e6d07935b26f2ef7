"""How good the estimate of a sample is, and what its FMU says of it: `diagnostics.status` and the numbers behind."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers.numerics.finite import HUGE, kept
from observers.pseudospectral import innovation_test
from observers.pseudospectral.covariance import standard_deviations
from observers.pseudospectral.estimate import Estimate
from observers.pseudospectral.method import Method
from observers.pseudospectral.problem_2 import VIOLATED, Reference, Solution
from observers.pseudospectral.sample import Instant, Window
from observers.pseudospectral.window import trajectory
from observers.status import CODE, worst


@dataclass(frozen=True)
class Quality:
    """`status`, one of CODE; `covariance` (ns^2) of the estimate; `deviation` of its least certain entry and `node0`, the largest residual
    of (16) at a dropped node 0, in units of nominal values; `changed`, for how many samples yet the window holds some from before a change
    of a model parameter; `heavy`, whether the fit's residual is too large, and `fit_factor`, what it usually is.
    """

    status: Any
    covariance: Any
    deviation: Any
    node0: Any
    changed: Any
    heavy: Any
    fit_factor: Any


def quality(
    method: Method, now: Instant, window: Window, ref: Reference, solution: Solution, estimate: Estimate
) -> Quality:
    """What the estimate of this sample is worth."""
    s, q, problem, model = now.s, now.q, method.problem, method.model
    ny, Ts = problem.ny, problem.segment.sample_time
    V, Z, unknown, noise = solution.trajectory
    theta = estimate.theta
    if problem.noisy_parameters:
        theta = ca.vertcat(*problem.thetas(unknown[problem.nx :], window.noise_std * noise))
    node0, regularity = trajectory.node0(problem)(
        V,
        Z,
        estimate.x0,
        theta,
        q.model,
        window.start,
        window.driven(problem, noise),
        *([window.active] if problem.count > 1 else []),
    )
    changed = _changed(method, now)
    # Without a fit the estimate is the prediction, and so is its covariance.
    fitted = ca.logic_and(solution.accepted, ca.sumsqr(solution.covariance) < HUGE)
    covariance = ca.if_else(fitted, solution.covariance, s.covariance)
    tested = window.tested
    learned = SimpleNamespace(**tested.state)
    unit = innovation_test.unit(method, learned)
    deviation = ca.norm_inf(standard_deviations(unit * covariance, problem.scale))
    rms = ca.sqrt(solution.cost / ca.fmax(ca.sum1(ref.point_weight), Ts))
    residual = (solution.cost_after, solution.accepted)
    heavy, fit_factor = innovation_test.fit_tested(method, now, window.W, *residual, tested.inconsistent)
    length = q.window_length if q.window_length.numel() else method.samples
    status = worst(
        (s.k < length, CODE.settling),
        (ca.logic_or(tested.settling, innovation_test.unknown_noise(method, learned)), CODE.settling),
        (tested.outlier, CODE.outlier),
        (ca.logic_or(tested.inconsistent, heavy), CODE.inconsistent),
        (solution.kept, CODE.prediction_kept),
        (ca.sum1(window.valid) < ny, CODE.sample_rejected),
        (node0 > q.collocation_limit, CODE.coarse_collocation),
        (changed > method.samples - length, CODE.parameter_changed),
        (deviation > q.deviation_limit, CODE.uncertain),
        (rms > q.residual_limit, CODE.inconsistent),
        (solution.slack > VIOLATED, CODE.inconsistent),
        (solution.undetermined, CODE.undetermined),
        (solution.failed, CODE.solver_failed),
        (regularity < q.regularity_limit if model.algebraic else 0, CODE.singular),
        (ca.logic_not(ref.enough), CODE.propagated_guess),
    )
    return Quality(status, covariance, deviation, kept(node0, s.node0_residual), changed, heavy, fit_factor)


def _changed(method: Method, now: Instant) -> Any:
    """L at a change of a model parameter, then one less a sample."""
    s, q = now.s, now.q
    changes = ca.logic_and(s.k > 0, ca.sumsqr(q.model - s.model) > 0) if method.model.parameters else 0
    return ca.if_else(changes, method.samples, ca.fmax(s.changed - 1, 0))
