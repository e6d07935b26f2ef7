"""Steps 5 and 6 of the main algorithm of Gong, Ross & Kang 2007, section 3.1: Z_initial, where the solve of Problem 2 starts from.

The paper takes them at the end of the last sample. They come at the beginning of the next one, when the inputs of the interval between
are known. The window's last trajectory moves on by one sample, and ends in the prediction of step 4. A solve that failed is followed by one
from a flat trajectory at the prediction, a second failure by one at the guess.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers.numerics.finite import HUGE
from observers.pseudospectral.method import Method
from observers.pseudospectral.sample import Instant, Window
from observers.pseudospectral.window import trajectory
from observers.pseudospectral.window.trajectory import Trajectory

WARM, AT_PREDICTION, AT_GUESS = 0, 1, 2  # where a solve starts from


@dataclass(frozen=True)
class Start:
    """Z_initial, and where it is from: WARM, AT_PREDICTION or AT_GUESS."""

    trajectory: Trajectory
    origin: Any

    @property
    def warm(self) -> Any:
        """Whether it continues the last trajectory."""
        return self.origin == WARM


def warm_start(method: Method, now: Instant, window: Window) -> Start:
    """Steps 5, 6: the last trajectory moved on by one sample, or a flat one where there is none to go on from."""
    s, problem = now.s, method.problem
    z_now = s.z[: problem.rates.n_algebraic]
    shifted = _shifted(method, now, window, z_now)
    whole = ca.sumsqr(ca.vertcat(s.V, s.x0, *shifted)) < HUGE
    origin = ca.fmax(s.fresh, AT_PREDICTION * ca.logic_not(whole))
    V, Z, x0 = (
        ca.if_else(origin > WARM, flat, ca.if_else(window.moving, moved, old))
        for flat, moved, old in zip(_flat(method, now, window), shifted, (s.V, s.Z, s.x0), strict=True)
    )
    if problem.count > 1:
        # A segment without a sample yet waits, flat at the prediction.
        ahead = trajectory.flat(problem)(s.x, z_now, now.known)
        V = _where_active(window.active, problem.n_rates, V, ahead[0])
        Z = _where_active(window.active, problem.n_algebraic, Z, ahead[1])
    from_guess = ca.logic_or(s.fresh == AT_GUESS, ca.logic_and(origin > WARM, ca.logic_not(window.moving)))
    theta = ca.if_else(from_guess, now.q.guess_theta, s.theta)
    noise = ca.MX(0, 1)
    if problem.n_noise:
        noise = ca.if_else(origin > WARM, 0, ca.if_else(window.moving, _shifted_noise(method, s.noise), s.noise))
    if problem.noisy_parameters:
        first = ca.if_else(window.moving, _first_theta(method, window, s), s.theta_first)
        theta = ca.if_else(origin > WARM, theta, first)
    return Start(Trajectory(V, Z, ca.vertcat(x0, theta), noise), origin)


def next_origin(now: Instant, start: Start, goes_on: Any, failed: Any) -> Any:
    """Where the next sample's solve starts from."""
    after_failure = ca.if_else(now.s.fresh == AT_PREDICTION, AT_GUESS, AT_PREDICTION)
    return ca.if_else(goes_on, WARM, ca.if_else(failed, after_failure, start.origin))


def _shifted_noise(method: Method, noise: Any) -> Any:
    """The segments' noise a sample later, of which the newest has none yet."""
    problem = method.problem
    part = 1 / problem.segment.samples
    return (1 - part) * noise + part * ca.vertcat(noise, ca.DM.zeros(problem.n_noise))[problem.n_noise :]


def _first_theta(method: Method, window: Window, s: SimpleNamespace) -> Any:
    """theta in the first segment a sample later."""
    problem = method.problem
    return s.theta_first + problem.jumps(window.noise_std * s.noise, 0) / problem.segment.samples


def _shifted(method: Method, now: Instant, window: Window, z_now: Any) -> tuple[Any, Any, Any]:
    """(V, Z, x0) of the last trajectory, moved on by one sample."""
    s, problem = now.s, method.problem
    last_input = window.U[window.U.numel() - problem.nu :] if problem.nu else now.known
    last = (s.V, s.Z, s.x0, problem.driven(s.u, window.noise_std * s.noise), s.x_filtered)
    theta = s.theta
    if problem.noisy_parameters:
        jumps = window.noise_std * _shifted_noise(method, s.noise)
        theta = ca.vertcat(*problem.thetas(_first_theta(method, window, s), jumps))
    shift = trajectory.shift(problem, method.equations)
    return tuple(shift(*last, s.x, z_now, theta, now.q.model, window.data, last_input, now.t))


def _flat(method: Method, now: Instant, window: Window) -> tuple[Any, Any, Any]:
    """(V, Z, x0) of a trajectory that stays at the prediction, or at the guess."""
    s, q, problem = now.s, now.q, method.problem
    at_prediction = ca.logic_and(window.moving, s.fresh < AT_GUESS)
    x = ca.if_else(at_prediction, s.x, q.guess_x)
    z = ca.if_else(at_prediction, s.z, q.guess_z)[: problem.rates.n_algebraic]
    return tuple(trajectory.flat(problem)(x, z, now.known))


def _where_active(active: Any, each: int, now: Any, flat: Any) -> Any:
    if each == 0:
        return now
    mask = ca.vec(ca.repmat(active.T, each, 1))
    return ca.if_else(mask, now, flat)
