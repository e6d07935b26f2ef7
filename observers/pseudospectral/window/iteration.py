"""The Gauss-Newton iteration of one sample, with an early exit, as one function without loops that CasADi can generate."""

from __future__ import annotations

from typing import Any

import casadi as ca

from observers.numerics import layout as lay
from observers.numerics.finite import HUGE
from observers.pseudospectral.window import gauss_newton, process_noise
from observers.pseudospectral.window.gauss_newton import Solve

FIRST_STEPS = 3  # most samples need one or two: what comes later is jumped over as a whole
WHOLE_STEPS = 15
WHOLE_STEPS_AIMED = 8  # of Problem 3, whose steps then get shorter and shorter
MOST_ITERATIONS = 40
SHORTENED = 0.25  # of a step: what a rescue begins with
WAITING_STEPS = 8  # of a window that does not determine the state: where the next sample's solve starts from
DAMPING = 0.5  # of later steps: where noise makes the residual's curvature turn whole steps into a cycle


def iterate(solve: Solve) -> ca.Function:
    """Function solve(go, V, Z, s, noise, tol, limit, *given) -> (V, Z, s, noise, size, cost, conditioning, covariance, slack, iterations).

    Full Gauss-Newton steps, damped ones after WHOLE_STEPS. Iterates while the scaled step exceeds `tol`, stays finite, and fewer than
    `limit` steps are done; the last step is applied, so that an error of tol before it is one of about tol^2 after. A line search on a
    merit function solved fewer cold starts. Where an iterate leaves the domain of the model's functions, `rescued` starts again.
    """
    newton = (process_noise if solve.problem.n_noise else gauss_newton).newton_step(solve)
    V, Z, s, noise, _, *fixed = (ca.MX.sym(newton.name_in(i), newton.numel_in(i)) for i in range(newton.n_in()))
    whole_steps = WHOLE_STEPS_AIMED if solve.aim else WHOLE_STEPS
    go, tolerance, limit = ca.MX.sym("go"), ca.MX.sym("tolerance"), ca.MX.sym("limit")
    results = dict.fromkeys(("size", "cost", "conditioning", "covariance", "slack", "iterations"), 1)
    results["covariance"] = newton.numel_out(7)
    trajectory = {"V": V, "Z": Z, "s": s, "noise": noise}
    state = lay.Layout(**{name: part.numel() for name, part in trajectory.items()}, **results)
    now = ca.MX.sym("now", state.total)
    stay = ca.Function("stay", [now, *fixed], [now])

    def step(name: str, damped: bool) -> ca.Function:
        parts = state.unpack(now)
        length: Any = 1.0
        if damped:
            length = DAMPING ** (parts.iterations - whole_steps + 1) if solve.aim else DAMPING
        values = newton(parts.V, parts.Z, parts.s, parts.noise, length, *fixed)
        after = dict(zip(state.sizes, values, strict=False))
        after["iterations"] = parts.iterations + 1
        return ca.Function.if_else(f"maybe_{name}", ca.Function(name, [now, *fixed], [state.pack(after)]), stay)

    def unfinished(value: Any) -> Any:
        part = state.unpack(value)
        # NaN fails every comparison, which ends the loop.
        going = (part.size >= tolerance**2) * (part.size < HUGE) * (part.iterations < limit)
        if solve.waits:
            least = fixed[list(solve.given).index("determined")][0]
            going = going * ca.logic_or(part.iterations < WAITING_STEPS, part.conditioning > least)
        return going

    def chain(value: Any, count: int, one: ca.Function) -> Any:
        for _ in range(count):
            value = one(unfinished(value), value, *fixed)
        return value

    whole, damped = step("step", False), step("damped_step", True)
    later = chain(chain(now, whole_steps - FIRST_STEPS, whole), MOST_ITERATIONS - whole_steps, damped)
    start = ca.MX.sym("start", state.total)
    if not solve.aim:
        later = rescued(newton, state)(start, later, *fixed, tolerance, limit)
    tail = ca.Function("tail", [start, now, *fixed, tolerance, limit], [later])
    no_tail = ca.Function("no_tail", [start, now, *fixed, tolerance, limit], [now])
    nothing = {name: ca.DM.zeros(size) for name, size in results.items()}
    first = state.pack(trajectory | nothing | {"size": ca.if_else(go, HUGE / 2, 0)})
    value = chain(first, FIRST_STEPS, whole)
    done = state.unpack(value).size < tolerance**2  # false for NaN
    value = ca.Function.if_else("maybe_tail", no_tail, tail)(done, first, value, *fixed, tolerance, limit)
    part = state.unpack(value)
    return ca.Function(
        "solve", [go, *trajectory.values(), tolerance, limit, *fixed], [getattr(part, name) for name in state.sizes]
    )


def rescued(newton: ca.Function, state: lay.Layout) -> ca.Function:
    """Function rescue(start, value, *given, tol, limit) -> value of a solve that is not finite; any other stays as it is.

    From `start` again, in steps of SHORTENED: an iterate at which the equations are not finite (a root, a logarithm of what it made
    negative) is taken back to the one before, from which the step is repeated at half its length, and after it doubled again.
    """
    fixed = [ca.MX.sym(newton.name_in(i), newton.numel_in(i)) for i in range(5, newton.n_in())]
    tolerance, limit = ca.MX.sym("tolerance"), ca.MX.sym("limit")
    point = lay.Layout(**{name: state.sizes[name] for name in ("V", "Z", "s", "noise")})
    loop = lay.Layout(value=state.total, good=point.total, length=1, at_good=1)
    now = ca.MX.sym("now", loop.total)
    at = loop.unpack(now)
    parts = state.unpack(at.value)
    values = dict(zip(state.sizes, newton(parts.V, parts.Z, parts.s, parts.noise, at.length, *fixed), strict=False))
    inside = values["size"] < HUGE  # false for NaN
    here = ca.vertcat(parts.V, parts.Z, parts.s, parts.noise)
    moved = ca.vertcat(*[ca.vec(values[name]) for name in point.sizes])
    backed = point.unpack(ca.if_else(inside, moved, at.good))
    after = {name: ca.if_else(inside, values[name], 0) for name in state.sizes if name in values}
    after |= {name: getattr(backed, name) for name in point.sizes}
    after["size"] = ca.if_else(inside, values["size"], HUGE / 2)
    after["iterations"] = parts.iterations + 1
    # Where even the start is outside there is nothing to go back to: length 0 ends it.
    shorter = ca.if_else(at.at_good, 0, at.length / 4)
    again = loop.pack(
        {
            "value": state.pack(after),
            "good": ca.if_else(inside, here, at.good),
            "length": ca.if_else(inside, ca.fmin(2 * at.length, 1), shorter),
            "at_good": ca.logic_not(inside),
        }
    )
    step = ca.Function("rescue_step", [now, *fixed], [again])
    maybe = ca.Function.if_else("maybe_rescue_step", step, ca.Function("rescue_stay", [now, *fixed], [now]))
    start, value = ca.MX.sym("start", state.total), ca.MX.sym("value", state.total)
    first = state.unpack(start)
    begun = ca.vertcat(first.V, first.Z, first.s, first.noise)
    running = loop.pack(
        {
            "value": state.replace(start, size=HUGE / 2, iterations=state.unpack(value).iterations),
            "good": begun,
            "length": SHORTENED,
            "at_good": 1,
        }
    )
    for _ in range(MOST_ITERATIONS):
        loop_now = loop.unpack(running)
        part = state.unpack(loop_now.value)
        unfinished = (part.size >= tolerance**2) * (part.iterations < limit) * (loop_now.length > 0)
        running = maybe(unfinished, running, *fixed)
    arguments = [start, value, *fixed, tolerance, limit]
    rescue = ca.Function("rescue", arguments, [loop.unpack(running).value])
    sound = ca.Function("sound", arguments, [value])
    lost = ca.logic_not(state.unpack(value).size < HUGE)
    return ca.Function("if_lost", arguments, [ca.Function.if_else("maybe_rescue", rescue, sound)(lost, *arguments)])
