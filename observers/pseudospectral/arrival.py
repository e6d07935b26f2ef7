"""The arrival cost: what samples that have left the window still say about its first state.

A quadratic |s - sbar|^2_{P^-1} of s = [x0; theta] at the window's first sample, before that sample's own measurement. When the window
moves on, the sample that it leaves behind corrects (sbar, P) as in an extended Kalman filter linearised at the window's own solution s*,

    s+ = sbar + G (y0 - h(s*) - M0 (sbar - s*))        P+ = (I - G M0) P (I - G M0)' + G R G'

and both move on by one sample along the window's trajectory: s' = [x1 + S1 (s+ - s*); theta+], P' = A P+ A' + Qd, A = [S1; 0 I]
(Rao, Rawlings & Mayne, IEEE Trans. Automat. Contr. 48 (2), 2003). On a linear model without process noise the estimate then equals the
Kalman filter's, whatever the window's length; with it where each sample has a segment of its own (`window.process_noise`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from observers import ports
from observers.component import Port
from observers.model import Model, ModelError
from observers.numerics import algebraic, linear, tiles
from observers.numerics.finite import HUGE
from observers.pseudospectral.method import Method
from observers.pseudospectral.sample import Instant, Window
from observers.pseudospectral.window.condense import first_sample
from observers.pseudospectral.window.quadratic_program import quadratic_program
from observers.pseudospectral.window.trajectory import Trajectory

LEAST_WEIGHT = 1e-30  # of an outlier
SMALLEST = 1e-9  # standard deviation, relative to the nominal value: a weight is one over its square


@dataclass(frozen=True)
class Given:
    """What is said of noise: whether there is an arrival cost, whether the samples have weights of their own, and deviations by name."""

    arrival: bool
    weighted: bool
    process_noise: Mapping[str, float] | None
    measurement_noise: Mapping[str, float] | None
    initial_std: Mapping[str, float] | None

    @property
    def driven(self) -> bool:
        return self.arrival or self.process_noise is not None


def ports_of(model: Model, given: Given) -> tuple[Port, ...]:
    """The tuning parameters of the noises and of the arrival cost.

    Raises:
        ModelError: a deviation of the guess without an arrival cost, or one of something that is not estimated or measured.
    """
    if given.initial_std is not None and not given.arrival:
        raise ModelError("pseudospectral: initial_std belongs to an arrival cost: give arrival_cost=True")
    estimated = (*model.states, *model.unknown_parameters)
    owner = "pseudospectral"
    process = ports.deviations(owner, "process_noise", ports.PROCESS_NOISE, estimated, given.process_noise, 0.0)
    measured = ports.deviations(
        owner,
        "measurement_noise",
        ports.MEASUREMENT_NOISE,
        model.outputs,
        given.measurement_noise,
        0.1,
        smallest=SMALLEST,
    )
    first = ports.deviations(
        owner, "initial_std", ports.INITIAL_STD, estimated, given.initial_std, 1.0, "fixed", smallest=SMALLEST
    )
    return (
        *(process if given.driven else ()),
        *(measured if given.weighted else ()),
        *(first if given.arrival else ()),
    )


def settings(model: Model, given: Given) -> dict[str, int]:
    """Sizes of the tuning parameters, in the order of `ports_of`."""
    ns = len(model.states) + len(model.unknown_parameters)
    return {
        "process_noise": ns if given.driven else 0,
        "measurement_noise": len(model.outputs) if given.weighted else 0,
        "initial_std": ns if given.arrival else 0,
    }


def state(model: Model, wanted: bool) -> dict[str, int]:
    """Sizes of what is kept from sample to sample."""
    ns = len(model.states) + len(model.unknown_parameters) if wanted else 0
    return {"prior_mean": ns, "prior_covariance": ns * ns}


def start(q: SimpleNamespace, wanted: bool) -> dict[str, Any]:
    """The guess and its covariance."""
    if not wanted:
        return {}
    covariance = ca.vec(ca.densify(ca.diag(q.initial_std**2)))
    return {"prior_mean": ca.vertcat(q.guess_x, q.guess_theta), "prior_covariance": covariance}


def given(wanted: bool, s: SimpleNamespace, scale: np.ndarray, weight: float) -> dict[str, Any]:
    """What a solve needs of it: mean and information, weighted as a sample is."""
    if not wanted:
        return {}
    ns = len(scale)
    P, S = tiles.kind(ns).sym("P", ns * ns), ca.diag(ca.DM(scale))
    scaled = ca.vec(ca.solve(S, ca.solve(S, _information(scale)(P)).T))
    return {
        "prior_mean": s.prior_mean,
        "prior_information": weight * ca.Function("information", [P], [scaled])(s.prior_covariance),
    }


def _information(scale: np.ndarray) -> ca.Function:
    """P (ns^2) -> P^-1 (ns x ns), in units of `scale`; a direction without uncertainty gets a large weight, not an infinite one."""
    ns, kind = len(scale), tiles.kind(len(scale))
    P, S = kind.sym("P", ns * ns), ca.diag(ca.DM(scale))
    inside = ca.solve(S, ca.solve(S, ca.reshape(P, ns, ns)).T) + SMALLEST**2 * kind.eye(ns)
    information = linear.inverse(inside) if kind is ca.SX else tiles.solve(inside, kind.eye(ns))[0]
    return ca.Function("scaled_information", [P], [(information + information.T) / 2])


def advance(method: Method, now: Instant, window: Window, at: Trajectory, solved: Any) -> dict[str, Any]:
    """Mean and covariance for the next window; `at` is this window's trajectory, which corrects them unless its solve failed: `solved`.

    While the samples contradict the estimate they are forgotten: the mean is that trajectory's own, with the guess's covariance.
    """
    s, q, problem = now.s, now.q, method.problem
    ny, nu = problem.ny, problem.nu
    V, Z, unknown, nu_noise = at
    noise = window.noise_std * nu_noise
    x1, S1 = first_sample(problem)(V, Z, unknown, noise, window.data, q.model, window.U)
    z_start = Z[: problem.rates.n_algebraic] if problem.n_algebraic else s.z
    first_input = window.at_points[:nu] if nu else ca.MX(0, 1)
    held = noise[: len(problem.noisy_states)] if problem.noisy_states else ca.MX(0, 1)
    weight = window.W[:ny]
    there = ca.logic_and(weight > 0, solved)
    sensor = q.measurement_noise / ca.sqrt(ca.fmax(weight, LEAST_WEIGHT))
    first = [window.Y[:ny], there, first_input, q.model, window.start, z_start]
    moved = [unknown, s.prior_mean, s.prior_covariance, x1, ca.vec(S1), held]
    mean_next, P_next = _moved_on(method)(*moved, *first, sensor, q.process_noise)
    # The prior of a window that does not move yet stays; one that is lost starts again around the trajectory, as a forgotten one does.
    moves = s.k >= method.samples
    own = ca.vertcat(x1, unknown[problem.nx :]) if problem.n_theta else x1
    lost = ca.logic_not(ca.sumsqr(ca.vertcat(mean_next, P_next)) < HUGE)
    forgotten = ca.logic_or(window.tested.forgets, lost)
    mean = ca.if_else(forgotten, ca.if_else(ca.sumsqr(own) < HUGE, own, unknown), mean_next)
    P = ca.if_else(forgotten, ca.vec(ca.diag(q.initial_std**2)), P_next)
    return {
        "prior_mean": ca.if_else(moves, _within(method, mean, P), s.prior_mean),
        "prior_covariance": ca.if_else(moves, P, s.prior_covariance),
    }


def _within(method: Method, mean: Any, P: Any) -> Any:
    """The likeliest mean within the bounds of the states and unknown parameters, by the covariance P (ns^2).

    What is correlated with an entry that is brought to its bound moves with it: a cut of that entry alone would contradict every sample.
    """
    c, scale = method.constraints, method.problem.scale
    if not (np.isfinite(c.lower).any() or np.isfinite(c.upper).any()):
        return mean
    ns, unit = len(scale), ca.DM(scale)
    m, Q = ca.MX.sym("mean", ns), ca.MX.sym("P", ns * ns)
    lower, upper = ((ca.DM(bound) - m) / unit for bound in (c.lower, c.upper))
    no_rows = [ca.DM.zeros(1, ns), ca.DM.zeros(1), ca.DM.zeros(1)]
    off, _, _, ok = quadratic_program(ns, 1)(_information(scale)(Q), ca.DM.zeros(ns), *no_rows, lower, upper, 1)
    moved = ca.Function("moved", [m, Q], [ca.if_else(ok, m + unit * off, m)])
    stays = ca.Function("stays", [m, Q], [m])
    outside = ca.sum1(ca.logic_or(mean < ca.DM(c.lower), mean > ca.DM(c.upper))) > 0
    return ca.Function.if_else("maybe_moved", moved, stays)(outside, mean, P)


def _moved_on(method: Method) -> ca.Function:
    """(s*, sbar, P, x1, S1, w*, y0, whether each of y0 is there, u0, p, t, z0, R's and Qd's deviations) -> (sbar, P) a sample later.

    The two formulas of the module's docstring: the correction by the sample that is left behind, and the motion. The prior knows nothing of
    the noise w* that the window found on the rates, which is taken out of x1 again; its part of S1 carries that of the prior.
    """
    problem = method.problem
    nx, ns, ny, nu = problem.nx, len(problem.scale), problem.ny, problem.nu
    sizes = (ns, ns, ns * ns, nx, nx * (ns + problem.n_noise), len(problem.noisy_states))
    kind = tiles.kind(ns)
    parts = [kind.sym(name, size) for name, size in zip(("s", "mean", "P", "x1", "S1", "held"), sizes, strict=True)]
    around, mean, P, x1, S1, held = parts
    S1 = ca.reshape(S1, nx, ns + problem.n_noise)
    Gamma = S1[:, ns : ns + len(problem.noisy_states)]
    P = ca.reshape(P, ns, ns)
    theta = around[nx:] if ns > nx else kind(0, 1)  # an empty slice would be 1 x 0
    y0, there, u0 = kind.sym("y0", ny), kind.sym("valid", ny), kind.sym("u0", nu)
    p, t, z0 = kind.sym("p", problem.n_parameters), kind.sym("t"), kind.sym("z0", len(method.model.algebraic))
    noise, intensity = kind.sym("noise", ny), kind.sym("drift", ns)
    drift = kind(intensity)
    expected, slope = _seen(method)(around, u0, p, t, z0)
    M = ca.diag(there) @ slope
    innovation = ca.if_else(there, y0 - expected - ca.mtimes(M, mean - around), 0)
    PM, R = ca.mtimes(P, M.T), ca.diag(noise**2)
    G = _gain(ny, ns)(ca.mtimes(M, PM) + R, PM)
    corrected = mean + ca.mtimes(G, innovation)
    left = kind.eye(ns) - ca.mtimes(G, M)
    after = ca.mtimes([left, P, left.T]) + ca.mtimes([G, R, G.T])
    A = ca.vertcat(S1[:, :ns], ca.horzcat(kind(ns - nx, nx), kind.eye(ns - nx)))
    new_mean = ca.vertcat(x1, theta) + ca.mtimes(A, corrected - around)
    new_P = ca.mtimes([A, after, A.T])
    Ts, noisy = problem.segment.sample_time, list(problem.noisy_states)
    if noisy:
        new_mean -= ca.vertcat(ca.mtimes(Gamma, held), kind(ns - nx, 1))
        spread = ca.mtimes([Gamma, ca.diag(drift[noisy] ** 2), Gamma.T]) / Ts
        new_P += ca.diagcat(spread, kind(ns - nx, ns - nx))
        drift[noisy] = 0
    new_P += ca.diag(drift**2 * Ts)
    new_P = ca.vec((new_P + new_P.T) / 2)
    arguments = [*parts, y0, there, u0, p, t, z0, noise, intensity]
    return ca.Function("advance_prior", arguments, [new_mean, new_P], {"cse": True})


def _seen(method: Method) -> ca.Function:
    """(s, u, p, t, z0) -> the outputs, and their derivative by s = [x; theta]."""
    measure, nx = algebraic.measurement(method.equations), method.problem.nx
    s = ca.SX.sym("s", len(method.problem.scale))
    u, p, t, z0 = (ca.SX.sym(name, measure.numel_in(i)) for name, i in (("u", 1), ("p", 2), ("t", 4), ("z0", 5)))
    theta = s[nx:] if s.numel() > nx else ca.SX(0, 1)
    expected, _ = measure(s[:nx], u, p, theta, t, z0)
    return ca.Function("seen", [s, u, p, t, z0], [expected, ca.densify(ca.jacobian(expected, s))])


def _gain(ny: int, ns: int) -> ca.Function:
    """(S, P M') -> P M' S^-1."""
    S, PM = ca.SX.sym("S", ny, ny), ca.SX.sym("PM", ns, ny)
    return ca.Function("gain", [S, PM], [linear.qr_solve(S, PM.T).T])
