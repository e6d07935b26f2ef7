"""Disturbances in an output, y = h(x, delta, t) of (1): the elementary problem of that output, at each sample by itself.

    min over nu of q (y - h(x, nu))^2 + sum_j r_j (nu_j - nu_ref_j)^2,   lower <= nu <= upper

It is (8) without a state: h is what is to be tracked, x the last iterate, nu the disturbances of the output, nu_ref their last iterate. A
disturbance is constant on an interval; a sample sees that of the interval which ends there.

In the problem of a state that the output sees, its disturbances are controls too. Their part of (8) is minimised at once: what is left is
the output's residual with the weight q / (1 + q_y sum_j b_j^2 / r_j), b = dh/dnu, in which a disturbance at a bound takes no part.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from observers.model import Model

PASSES = (
    4  # Newton's steps for the costate: two are exact for one disturbance that the output is affine in, bounds or not
)


LITTLE = 1e-9  # weight of a disturbance where it is to explain all
AT_BOUND = 1e-9  # of its nominal value: a disturbance as near to a bound is at it


@dataclass(frozen=True)
class OutputProblem:
    """The problem of an output: `index` of it, `disturbances`: indices of those that it depends on."""

    index: int
    disturbances: tuple[int, ...]


def output_problems(model: Model) -> tuple[OutputProblem, ...]:
    """One for each output in which there is a disturbance."""
    eq = model.equations
    seen = [
        tuple(k for k in range(eq.w.numel()) if ca.depends_on(eq.output[m], eq.w[k])) for m in range(eq.output.numel())
    ]
    return tuple(OutputProblem(m, disturbances) for m, disturbances in enumerate(seen) if disturbances)


def at_samples(W: ca.MX) -> ca.MX:
    """The disturbances that the N samples see (k x N), of those on the N - 1 intervals; the first sample sees the first interval's."""
    return ca.horzcat(W[:, 0], W) if W.numel() else ca.MX(0, W.shape[1] + 1)


def solution(model: Model, problem: OutputProblem) -> ca.Function:
    """solve(x, w (k), y, valid, u, p, t, q, r (m)) -> the problem's disturbances (m) at a sample; as they were where it is not valid.

    With a costate l, nu_j = clip(nu_ref_j + b_j l / r_j), l = q (y - h(x, nu)); b = dh/dnu at the reference.
    """
    eq, chosen = model.equations, list(problem.disturbances)
    variables = [model.unknown_disturbances[k] for k in chosen]
    reference, h = ca.vertcat(*[eq.w[k] for k in chosen]), eq.output[problem.index]
    low, high = ca.DM([v.min for v in variables]), ca.DM([v.max for v in variables])
    y, valid, q, r = ca.SX.sym("y"), ca.SX.sym("valid"), ca.SX.sym("q"), ca.SX.sym("r", len(chosen))
    b = _slopes(model, problem)
    costate, wanted = ca.SX(0), reference
    for _ in range(PASSES):
        nu = ca.fmin(ca.fmax(wanted, low), high)
        gap = costate - q * valid * (y - ca.substitute(h, reference, nu))
        costate = costate - gap / (1 + q * valid * ca.dot((nu == wanted) * b, b / r))
        wanted = reference + b / r * costate
    found = ca.fmin(ca.fmax(wanted, low), high)
    return ca.Function("solve", [eq.x, eq.w, y, valid, eq.u, eq.p, eq.t, q, r], [ca.densify(found)], {"cse": True})


def explained(model: Model) -> ca.Function:
    """explained(x, w, y (ny), there (ny), u, p, t) -> w (k), moved as little as makes the outputs y as far as the bounds allow."""
    eq, ny = model.equations, len(model.outputs)
    y, there, w = ca.SX.sym("y", ny), ca.SX.sym("there", ny), ca.vertsplit(eq.w) if eq.w.numel() else []
    for problem in output_problems(model):
        q = 1 / model.outputs[problem.index].nominal ** 2
        r = [LITTLE / model.unknown_disturbances[k].nominal ** 2 for k in problem.disturbances]
        sample = (y[problem.index], there[problem.index], eq.u, eq.p, eq.t)
        found = solution(model, problem)(eq.x, ca.vertcat(*w), *sample, q, r)
        for row, k in enumerate(problem.disturbances):
            w[k] = found[row]
    return ca.Function("explained", [eq.x, eq.w, y, there, eq.u, eq.p, eq.t], [ca.vertcat(*w) if w else ca.SX(0, 1)])


def left_over(model: Model, problem: OutputProblem) -> ca.Function:
    """left_over(x, w (k), u, p, t, q, r (m)) -> the part of its weight with which a state follows the output, in (0, 1]."""
    eq, q, r = model.equations, ca.SX.sym("q"), ca.SX.sym("r", len(problem.disturbances))
    variables = [(eq.w[k], model.unknown_disturbances[k]) for k in problem.disturbances]
    free = [(w > v.min + AT_BOUND * v.nominal) * (w < v.max - AT_BOUND * v.nominal) for w, v in variables]
    b = ca.vertcat(*free) * _slopes(model, problem)
    return ca.Function("left_over", [eq.x, eq.w, eq.u, eq.p, eq.t, q, r], [1 / (1 + q * ca.dot(b, b / r))])


def _slopes(model: Model, problem: OutputProblem) -> ca.SX:
    """dh/dnu (m x 1)."""
    eq = model.equations
    reference = ca.vertcat(*[eq.w[k] for k in problem.disturbances])
    return ca.densify(ca.jacobian(eq.output[problem.index], reference)).T
