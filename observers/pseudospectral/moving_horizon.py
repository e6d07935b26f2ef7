"""The main algorithm of Gong, Ross & Kang 2007, section 3.1, at one sample instant. Its steps, by the paper's numbers:

1. collect the new measurement                             `sample.collect`
2. the reference signal of the cost function               `problem_2.reference`
3. Problem 2 from Z_initial, and the estimate of t_k       `problem_2.solve`, `estimate.estimate`
4. the prediction of the next sample instant               `prediction.flow`, between the samples
5. the trajectory and the prediction, as one curve         `warm_start.warm_start`
6. Z_initial, that curve at the nodes of the next window   the same
7. go to step 1                                            `_next`, what is kept until then

Steps 5 and 6 come at the beginning of the next sample, between steps 1 and 2, when the inputs since the last one are known. Section 3.4's
Problem 3 comes within step 3 (`bounded_noise`). What the paper leaves out is what the estimate is worth: `status`.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from observers.pseudospectral import arrival, covariance, innovation_test, memory
from observers.pseudospectral.estimate import Estimate, estimate
from observers.pseudospectral.method import Method
from observers.pseudospectral.problem_2 import Solution, reference, solve
from observers.pseudospectral.sample import Instant, Window, collect, inputs_of
from observers.pseudospectral.status import Quality, quality
from observers.pseudospectral.warm_start import AT_GUESS, Start, next_origin, warm_start
from observers.status import CODE


def jump(method: Method) -> ca.Function:
    """jump(z, u, p, t) -> z at a sample instant; u = [measurements, known inputs, whether each measurement is valid]."""
    layout = memory.layout(method)
    z, p, t = ca.MX.sym("z", layout.total), ca.MX.sym("p", method.settings.total), ca.MX.sym("t")
    u = ca.MX.sym("u", 2 * method.problem.ny + len(method.model.inputs))
    now = _instant(method, z, u, p, t)
    window = collect(method, now)  # 1
    start = warm_start(method, now, window)  # 5, 6 of the last sample
    ref = reference(method, now, window, start)  # 2
    solution = solve(method, now, window, start, ref)  # 3
    found = estimate(method, now, window, solution)
    worth = quality(method, now, window, ref, solution, found)
    after = _next(method, now, window, start, solution, found, worth)  # 7
    return ca.Function("jump", [z, u, p, t], [layout.pack(after)])


def _instant(method: Method, z: Any, u: Any, p: Any, t: Any) -> Instant:
    ny, q = method.problem.ny, method.settings.unpack(p)
    return Instant(
        s=memory.layout(method).unpack(z),
        q=q,
        u=u,
        offered=u[u.numel() - ny :] > 0.5,
        known=method.lift(inputs_of(u, ny), q.model),
        t=t,
    )


def _next(
    method: Method,
    now: Instant,
    window: Window,
    start: Start,
    solution: Solution,
    found: Estimate,
    worth: Quality,
) -> dict[str, Any]:
    """Step 7: the parts of `memory.layout` after the sample. The prediction starts from the estimate."""
    s = now.s
    absent = {name: ca.DM(0, 1) for name, size in memory.layout(method).sizes.items() if size == 0}
    prior = (
        arrival.advance(method, now, window, solution.trajectory, ca.logic_not(solution.failed))
        if method.arrival
        else {}
    )
    tested = window.tested
    unreadable = ca.logic_and(now.offered, ca.logic_not(window.readable))
    after = {
        **absent,
        "x": found.x,
        "z": found.z,
        "theta": found.theta,
        "x_filtered": found.x,
        "z_filtered": found.z,
        "theta_filtered": found.theta,
        "y": window.Y,
        "weight": window.weight,
        "u": window.U,
        "seen": window.seen,
        "input_integral": ca.DM.zeros(method.problem.nu),
        "V": solution.trajectory.V,
        "Z": solution.trajectory.Z,
        "x0": found.x0,
        "noise": solution.trajectory.noise,
        "theta_first": solution.trajectory.s[method.problem.nx :] if method.problem.noisy_parameters else ca.DM(0, 1),
        "innovation": window.innovation,
        "model": now.q.model,
        "k": s.k + 1,
        "fresh": next_origin(now, start, solution.goes_on, ca.logic_or(solution.failed, solution.undetermined)),
        "changed": worth.changed,
        "status": worth.status,
        "cost": solution.cost,
        "iterations": solution.iterations,
        "conditioning": solution.conditioning,
        "deviation": worth.deviation,
        "covariance": worth.covariance,
        "node0_residual": worth.node0,
        "rejected": s.rejected + (ca.sum1(unreadable) > 0),
        "failures": s.failures + solution.failed,
        "restarts": s.restarts + (tested.begins if method.arrival else 0),
        **tested.state,
        "heavy": worth.heavy,
        "fit_factor": worth.fit_factor,
        "quiet": ca.fmax(tested.state["quiet"], worth.heavy * innovation_test.patience(method)),
        "fit_noise": ca.DM(0, 1) if method.weighted else ca.if_else(solution.accepted, solution.fit_noise, s.fit_noise),
        "slack": solution.slack if method.constraints.any else ca.DM(0, 1),
        "path": method.path(found.x, now.inputs, now.q.model, found.theta, now.t, found.z),
        **prior,
        **solution.bounds,
    }
    again = _again(method, now)
    return after | {name: ca.if_else(tested.restart, value, after[name]) for name, value in again.items()}


def _again(method: Method, now: Instant) -> dict[str, Any]:
    """What a restart from the guess sets: the guess, and a window without samples."""
    q, s = now.q, now.s
    return {
        "x": q.guess_x,
        "theta": q.guess_theta,
        "weight": ca.DM.zeros(s.weight.numel()),
        "k": ca.DM(0),
        "fresh": ca.DM(AT_GUESS),
        "covariance": covariance.initial(method, q),
        "tests": ca.DM.zeros(s.tests.numel()),
        "status": ca.DM(CODE.propagated_guess),
        "restarts": s.restarts + 1,
        **arrival.start(q, method.arrival),
    }
