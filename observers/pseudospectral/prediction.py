"""Step 4 of the main algorithm of Gong, Ross & Kang 2007, section 3.1: the estimate is propagated by the model until the next sample."""

from __future__ import annotations

import casadi as ca

from observers.numerics import algebraic, tiles
from observers.numerics.finite import HUGE
from observers.numerics.runge_kutta import runge_kutta
from observers.pseudospectral import covariance, memory
from observers.pseudospectral.method import Method
from observers.pseudospectral.warm_start import AT_GUESS
from observers.status import CODE


def flow(method: Method) -> ca.Function:
    """flow(z, u, p, t, h) -> z: the prediction h further (Dormand-Prince, order 8), inputs held.

    One that is no longer finite, or loses its algebraic variables, starts again from the guess and is counted as a failure.
    """
    model, layout = method.model, memory.layout(method)
    eq, ny, nu = model.equations, len(model.outputs), len(model.inputs)
    kind = tiles.kind(len(method.problem.scale))
    z, u = kind.sym("z", layout.total), kind.sym("u", 2 * ny + nu)
    p, t, h = kind.sym("p", method.settings.total), kind.sym("t"), kind.sym("h")
    s, q = layout.unpack(z), method.settings.unpack(p)
    known = u[ny : ny + nu] if nu else kind(0, 1)
    motion = algebraic.motion(eq)
    moved = runge_kutta(lambda x, time: motion(x, known, q.model, s.theta, time, s.z)[0], s.x, t, h)
    drift = q.process_noise if q.process_noise.numel() else kind.zeros(len(method.problem.scale))
    followed = algebraic.followed(eq, [v.nominal for v in model.algebraic])
    moved_z, lost = followed(moved, s.z, known, q.model, s.theta, t + h)
    sound = ca.logic_and(ca.sumsqr(ca.vertcat(moved, moved_z)) < HUGE, ca.logic_not(lost))
    spread = covariance.moved(method)(
        s.covariance, (s.x + moved) / 2, s.z, known, q.model, s.theta, t + h / 2, h, drift
    )
    after = {
        "x": ca.if_else(sound, moved, q.guess_x),
        "z": ca.if_else(sound, moved_z, q.guess_z),
        "theta": ca.if_else(sound, s.theta, q.guess_theta),
        "covariance": ca.if_else(sound, spread, covariance.initial(method, q)),
        "input_integral": s.input_integral + h * method.lift(known, q.model),
        "fresh": ca.if_else(sound, s.fresh, AT_GUESS),
        "status": ca.if_else(sound, s.status, ca.if_else(lost, CODE.singular, CODE.solver_failed)),
        "failures": s.failures + ca.logic_not(sound),
    }
    return ca.Function("flow", [z, u, p, t, h], [layout.replace(z, **after)])
