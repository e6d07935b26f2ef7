"""The Gauss-Newton iteration of one sample, with an early exit, as one function without loops that CasADi can generate."""

from __future__ import annotations

from typing import Any

import casadi as ca

from observers.numerics import gauss_newton
from observers.numerics import layout as lay
from observers.numerics.least_squares import LeastSquares

FIRST_STEPS = 3  # most samples need one or two: what comes later is jumped over as a whole
WHOLE_STEPS = 15
MOST_ITERATIONS = 40
DAMPING = 0.5  # of later steps: where noise makes the residual's curvature turn whole steps into a cycle
HUGE = 1e150  # beyond: not finite; its square still is a number


def solve(problem: LeastSquares) -> ca.Function:
    """Function solve(go, V, s, data, p, y, w, lam, tol, limit) -> (V, s, size, cost, conditioning, iterations).

    Full Gauss-Newton steps, damped ones after WHOLE_STEPS. Iterates while the scaled step exceeds `tol`, stays finite, and fewer than
    `limit` steps are done; the last step is applied, so that an error of tol before it is one of about tol^2 after. A line search on a
    merit function solved fewer cold starts.
    """
    newton = gauss_newton.newton_step(problem)
    V, s, data, p, y, w, lam, _ = (ca.MX.sym(newton.name_in(i), newton.numel_in(i)) for i in range(newton.n_in()))
    go, tolerance, limit = ca.MX.sym("go"), ca.MX.sym("tolerance"), ca.MX.sym("limit")
    state = lay.Layout(V=V.numel(), s=s.numel(), size=1, cost=1, conditioning=1, iterations=1)
    fixed = [data, p, y, w, lam]
    now = ca.MX.sym("now", state.total)
    stay = ca.Function("stay", [now, *fixed], [now])

    def step(name: str, length: float) -> ca.Function:
        parts = state.unpack(now)
        values = newton(parts.V, parts.s, *fixed, length)
        after = dict(zip(("V", "s", "size", "cost", "conditioning"), values, strict=True))
        after["iterations"] = parts.iterations + 1
        return ca.Function.if_else(f"maybe_{name}", ca.Function(name, [now, *fixed], [state.pack(after)]), stay)

    def unfinished(value: Any) -> Any:
        part = state.unpack(value)
        # NaN fails every comparison, which ends the loop.
        return (part.size >= tolerance**2) * (part.size < HUGE) * (part.iterations < limit)

    def chain(value: Any, count: int, one: ca.Function) -> Any:
        for _ in range(count):
            value = one(unfinished(value), value, *fixed)
        return value

    whole, damped = step("step", 1.0), step("damped_step", DAMPING)
    later = chain(chain(now, WHOLE_STEPS - FIRST_STEPS, whole), MOST_ITERATIONS - WHOLE_STEPS, damped)
    tail = ca.Function("tail", [now, *fixed, tolerance, limit], [later])
    no_tail = ca.Function("no_tail", [now, *fixed, tolerance, limit], [now])
    first = {"V": V, "s": s, "size": ca.if_else(go, HUGE / 2, 0), "cost": 0, "conditioning": 0, "iterations": 0}
    value = chain(state.pack(first), FIRST_STEPS, whole)
    part = state.unpack(
        ca.Function.if_else("maybe_tail", tail, no_tail)(unfinished(value), value, *fixed, tolerance, limit)
    )
    return ca.Function(
        "solve",
        [go, V, s, *fixed, tolerance, limit],
        [part.V, part.s, part.size, part.cost, part.conditioning, part.iterations],
    )
