"""The result of step 3 of the main algorithm of Gong, Ross & Kang 2007, section 3.1: the estimate of t_k."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

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
    V, Z, unknown, noise = solution.trajectory
    fitted = Layout(x0=problem.nx, theta=problem.n_theta).unpack(unknown)
    driven = window.driven(problem, noise)
    x_fitted, z_near = trajectory.state_at(problem)(window.place, V, Z, fitted.x0, driven)
    theta_fitted = fitted.theta
    if problem.n_noise:
        x_fitted, theta_fitted = _with_noise(method, window, x_fitted, fitted.theta, window.noise_std * noise)
    x = ca.if_else(accepted, x_fitted, s.x)
    theta = ca.if_else(accepted, theta_fitted, s.theta)
    near = ca.if_else(accepted, z_near, s.z) if problem.n_algebraic else s.z
    z = algebraic.motion(method.equations)(x, now.known, now.q.model, theta, now.t, near)[1]
    return Estimate(x, kept(z, s.z), theta, fitted.x0)


def _with_noise(method: Method, window: Window, x: Any, theta: Any, noise: Any) -> tuple[Any, Any]:
    """The state within its bounds, which process noise makes soft, and theta after the jumps so far."""
    problem, c = method.problem, method.constraints
    m = problem.segment.samples
    if problem.noisy_parameters:
        for j in range(problem.count):
            theta = theta + (window.place >= (j + 1) * m) * problem.jumps(noise, j)
    lower, upper = (np.clip(bound, -1e300, 1e300) for bound in (c.lower, c.upper))
    low, high = list(problem.bounded), slice(problem.nx, None)
    node_lower, node_upper = np.full(problem.nx, -1e300), np.full(problem.nx, 1e300)
    node_lower[low], node_upper[low] = np.clip(c.node_lower, -1e300, None), np.clip(c.node_upper, None, 1e300)
    within_x = ca.fmin(ca.fmax(x, ca.DM(node_lower)), ca.DM(node_upper))
    return within_x, ca.fmin(ca.fmax(theta, ca.DM(lower[high])), ca.DM(upper[high]))
