"""The Gauss-Newton iteration of one sample, with an early exit, as one function without loops that CasADi can generate."""

from __future__ import annotations

from typing import Any

import casadi as ca

from observers.numerics import layout as lay
from observers.numerics.finite import HUGE
from observers.pseudospectral.window import gauss_newton
from observers.pseudospectral.window.gauss_newton import Solve

FIRST_STEPS = 3  # most samples need one or two: what comes later is jumped over as a whole
WHOLE_STEPS = 15
WHOLE_STEPS_AIMED = 8  # of Problem 3, whose steps then get shorter and shorter
MOST_ITERATIONS = 40
DAMPING = 0.5  # of later steps: where noise makes the residual's curvature turn whole steps into a cycle


def iterate(solve: Solve) -> ca.Function:
    """Function solve(go, V, Z, s, tol, limit, *given) -> (V, Z, s, size, cost, conditioning, spread, slack, iterations).

    Full Gauss-Newton steps, damped ones after WHOLE_STEPS. Iterates while the scaled step exceeds `tol`, stays finite, and fewer than
    `limit` steps are done; the last step is applied, so that an error of tol before it is one of about tol^2 after. A line search on a
    merit function solved fewer cold starts.
    """
    newton = gauss_newton.newton_step(solve)
    V, Z, s, _, *fixed = (ca.MX.sym(newton.name_in(i), newton.numel_in(i)) for i in range(newton.n_in()))
    whole_steps = WHOLE_STEPS_AIMED if solve.aim else WHOLE_STEPS
    go, tolerance, limit = ca.MX.sym("go"), ca.MX.sym("tolerance"), ca.MX.sym("limit")
    results = dict.fromkeys(("size", "cost", "conditioning", "spread", "slack", "iterations"), 1)
    state = lay.Layout(V=V.numel(), Z=Z.numel(), s=s.numel(), **results)
    now = ca.MX.sym("now", state.total)
    stay = ca.Function("stay", [now, *fixed], [now])

    def step(name: str, damped: bool) -> ca.Function:
        parts = state.unpack(now)
        length: Any = 1.0
        if damped:
            length = DAMPING ** (parts.iterations - whole_steps + 1) if solve.aim else DAMPING
        values = newton(parts.V, parts.Z, parts.s, length, *fixed)
        after = dict(zip(state.sizes, values, strict=False))
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

    whole, damped = step("step", False), step("damped_step", True)
    later = chain(chain(now, whole_steps - FIRST_STEPS, whole), MOST_ITERATIONS - whole_steps, damped)
    tail = ca.Function("tail", [now, *fixed, tolerance, limit], [later])
    no_tail = ca.Function("no_tail", [now, *fixed, tolerance, limit], [now])
    start = {"V": V, "Z": Z, "s": s} | dict.fromkeys(results, 0) | {"size": ca.if_else(go, HUGE / 2, 0)}
    value = chain(state.pack(start), FIRST_STEPS, whole)
    part = state.unpack(
        ca.Function.if_else("maybe_tail", tail, no_tail)(unfinished(value), value, *fixed, tolerance, limit)
    )
    return ca.Function("solve", [go, V, Z, s, tolerance, limit, *fixed], [getattr(part, name) for name in state.sizes])
