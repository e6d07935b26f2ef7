"""One exponential Rosenbrock-Euler step: exact for x' = A x + b + c t, of order 2 otherwise, and stable however stiff it is.

Hochbruck & Ostermann, "Exponential integrators", Acta Numerica 19 (2010), section 2.4, made autonomous by t' = 1.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from observers.free_motion import FreeMotion
from observers.numerics.riccati import propagator

TINY = 1e-150


def rosenbrock(A: Any, rate: Any, rate_t: Any, W: Any, h: Any) -> tuple[Any, Any, Any]:
    """(dx, Phi, Wd) over h of x' = f(x, t), linearised where it stands.

    Args:
        A: df/dx (n x n). rate, rate_t: f and df/dt (n x 1). W: intensity of the process noise (n x n). h: step [s].

    Returns:
        x(h) - x(0) = h phi_1(h A) f + h^2 phi_2(h A) f_t, exp(A h), and the integral of exp(A s) W exp(A' s): parts of one exponential, of
        [[A, f_t, f], [0, 0, 1], [0, 0, 0]].
    """
    n = A.shape[0]
    forcing = ca.horzcat(rate_t, rate)
    # The last state's value is a matter of units; this one keeps the forcing from setting the exponential's norm.
    unit = (ca.sqrt(ca.sumsqr(forcing)) + TINY) / (ca.sqrt(ca.sumsqr(A)) + 1)
    clock = ca.MX(ca.DM([[0, 1], [0, 0]]))
    extended = ca.blockcat([[A, forcing / unit], [ca.MX(2, n), clock]])
    Phi, Wd = propagator(n + 2)(extended, ca.diagcat(W, ca.MX(2, 2)), h)
    return unit * Phi[:n, n + 1], Phi[:n, :n], Wd[:n, :n]


def along(found: FreeMotion) -> ca.Function:
    """moved(x, z, t, h) -> x: a step at a point of the motion `found`, whose z is empty."""
    n = len(found.states)
    at, when, none = ca.SX.sym("x", n), ca.SX.sym("t"), ca.SX(0, 1)
    moving = found.rate(at, none, when)[0]
    parts = ca.Function("parts", [at, when], [found.jacobian(at, none, when), moving, ca.jacobian(moving, when)])
    x, z, t, h = ca.MX.sym("x", n), ca.MX.sym("z", 0), ca.MX.sym("t"), ca.MX.sym("h")
    A, rate, rate_t = parts(x, t)
    dx, _, _ = rosenbrock(A, ca.densify(rate), ca.densify(rate_t), ca.MX(ca.DM.zeros(n, n)), h)
    return ca.Function("moved", [x, z, t, h], [x + dx])
