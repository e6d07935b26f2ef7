"""The Gauss-Newton iteration of one sample, with an early exit, as one function without loops that CasADi can generate."""

from __future__ import annotations

from typing import Any

import casadi as ca

from observers.numerics import gauss_newton
from observers.numerics import layout as lay
from observers.numerics.least_squares import LeastSquares

MOST_ITERATIONS = 40
HUGE = 1e150  # beyond: not finite; its square still is a number


def solve(problem: LeastSquares) -> ca.Function:
    """Function solve(go, V, s, data, p, y, w, lam, tol, limit) -> (V, s, size, cost, conditioning, iterations): full Gauss-Newton steps.

    Iterates while the scaled step exceeds `tol`, stays finite, and fewer than `limit` steps are done; the last step is applied, so that an
    error of tol before it is one of about tol^2 after. A line search on a merit function solved fewer cold starts.
    """
    newton = gauss_newton.newton_step(problem)
    V, s, data, p, y, w, lam = (ca.MX.sym(newton.name_in(i), newton.numel_in(i)) for i in range(newton.n_in()))
    go, tolerance, limit = ca.MX.sym("go"), ca.MX.sym("tolerance"), ca.MX.sym("limit")
    state = lay.Layout(V=V.numel(), s=s.numel(), size=1, cost=1, conditioning=1, iterations=1)
    fixed = [data, p, y, w, lam]
    now = ca.MX.sym("now", state.total)
    parts = state.unpack(now)
    V_next, s_next, size, cost, conditioning = newton(parts.V, parts.s, *fixed)
    after = {
        "V": V_next,
        "s": s_next,
        "size": size,
        "cost": cost,
        "conditioning": conditioning,
        "iterations": parts.iterations + 1,
    }
    once = ca.Function("iterate", [now, *fixed], [state.pack(after)])
    stay = ca.Function("stay", [now, *fixed], [now])
    maybe = ca.Function.if_else("maybe_iterate", once, stay)

    def chain(value: Any, count: int) -> Any:
        for _ in range(count):
            part = state.unpack(value)
            # NaN fails every comparison, which ends the loop.
            unfinished = (part.size >= tolerance**2) * (part.size < HUGE) * (part.iterations < limit)
            value = maybe(unfinished, value, *fixed)
        return value

    # Most samples need one or two steps: the long tail of the chain is jumped over as a whole.
    short = 3
    tail = ca.Function("tail", [now, *fixed, tolerance, limit], [chain(now, MOST_ITERATIONS - short)])
    no_tail = ca.Function("no_tail", [now, *fixed, tolerance, limit], [now])
    first = {"V": V, "s": s, "size": ca.if_else(go, HUGE / 2, 0), "cost": 0, "conditioning": 0, "iterations": 0}
    value = chain(state.pack(first), short)
    part = state.unpack(value)
    unfinished = (part.size >= tolerance**2) * (part.size < HUGE) * (part.iterations < limit)
    value = ca.Function.if_else("maybe_tail", tail, no_tail)(unfinished, value, *fixed, tolerance, limit)
    part = state.unpack(value)
    return ca.Function(
        "solve",
        [go, V, s, *fixed, tolerance, limit],
        [part.V, part.s, part.size, part.cost, part.conditioning, part.iterations],
    )
