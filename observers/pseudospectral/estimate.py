"""The result of step 3 of the main algorithm of Gong, Ross & Kang 2007, section 3.1: the estimate of t_k."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from observers.numerics import algebraic
from observers.numerics.finite import kept
from observers.numerics.layout import Layout
from observers.pseudospectral.method import Method
from observers.pseudospectral.problem_2 import Solution
from observers.pseudospectral.sample import Instant, Window
from observers.pseudospectral.window import trajectory


@dataclass(frozen=True)
class Estimate:
    """The states x (nx), algebraic variables z (nz) and unknown parameters theta (nt) at t_k, and the window's first state x0 (nx)."""

    x: Any
    z: Any
    theta: Any
    x0: Any


def estimate(method: Method, now: Instant, window: Window, solution: Solution) -> Estimate:
    """The end of the trajectory where Problem 2's solution was accepted, else the prediction."""
    s, problem, accepted = now.s, method.problem, solution.accepted
    V, Z, unknown = solution.trajectory
    fitted = Layout(x0=problem.nx, theta=problem.n_theta).unpack(unknown)
    x_fitted, z_near = trajectory.state_at(problem)(window.place, V, Z, fitted.x0, window.U)
    x = ca.if_else(accepted, x_fitted, s.x)
    theta = ca.if_else(accepted, fitted.theta, s.theta)
    near = ca.if_else(accepted, z_near, s.z) if problem.n_algebraic else s.z
    z = algebraic.motion(method.equations)(x, now.known, now.q.model, theta, now.t, near)[1]
    return Estimate(x, kept(z, s.z), theta, fitted.x0)
