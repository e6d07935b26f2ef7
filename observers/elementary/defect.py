"""What a model does over one sample interval, from the states at its two ends: the mean rate, by Hermite's two-point rule."""

from __future__ import annotations

import casadi as ca

from observers.numerics.equations import Equations


def mean_rate(eq: Equations) -> ca.Function:
    """mean_rate(x0, x1, u0, u1, w, p, t, s) -> (n x 1) the mean of f over [t, t + s].

    With f' along the model at either end, (f0 + f1) / 2 + s (f'0 - f'1) / 12: exact for cubics in time, error s^4 f'''' / 720. The inputs
    move linearly from u0 to u1 and the disturbances w are constant, so that jumps between intervals do no harm.
    """
    x0, x1 = ca.SX.sym("x0", eq.x.numel()), ca.SX.sym("x1", eq.x.numel())
    u0, u1, w, p = (
        ca.SX.sym(name, column.numel()) for name, column in (("u0", eq.u), ("u1", eq.u), ("w", eq.w), ("p", eq.p))
    )
    t, s = ca.SX.sym("t"), ca.SX.sym("s")
    slope = (u1 - u0) / s
    along = (
        ca.jtimes(eq.ode, eq.x, eq.ode)
        + ca.jacobian(eq.ode, eq.t)
        + (ca.jtimes(eq.ode, eq.u, slope) if eq.u.numel() else 0)
    )
    ends = ca.Function("ends", [eq.x, eq.u, eq.w, eq.p, eq.t, u0, u1, s], [eq.ode, ca.densify(along)])
    f0, d0 = ends(x0, u0, w, p, t, u0, u1, s)
    f1, d1 = ends(x1, u1, w, p, t + s, u0, u1, s)
    return ca.Function("mean_rate", [x0, x1, u0, u1, w, p, t, s], [ca.densify((f0 + f1) / 2 + s / 12 * (d0 - d1))])
