"""One sample interval of the canonical DAE observer: in its w-form, or by the paper's backward differentiation (section 4).

Both advance (x, mu) of the relaxed DAE (see `dae`) from t_(k-1) to t_k, where the measurement is y_k.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import casadi as ca

from observers.dae import Dae
from observers.dae_gain import Gain
from observers.numerics.bdf import growing
from observers.numerics.interpolation import CUBIC, interpolated
from observers.numerics.linear import backward, forward, lu_factor

STAGE_ITERATIONS = 3  # of Newton's method, from the stage before
ITERATIONS = 5  # where the result stands by itself


def consistent(dae: Dae, iterations: int) -> ca.Function:
    """consistent(w, y, x, mu, p, t) -> (x, mu, change) of x - G(x) mu = w, h(x) = y (2.11): explicit for linear outputs.

    Else by Newton's method from the x, mu given; `change` is its last relative correction, which tells whether it converged. mu is the
    multiplier of the projection of w onto h(x) = y.
    """
    w, y, mu = ca.SX.sym("w", dae.n), ca.SX.sym("y", dae.n_outputs), ca.SX.sym("mu", dae.n_outputs)
    arguments = [w, y, dae.x, mu, dae.p, dae.t]
    if dae.linear_outputs:
        gap = y - ca.substitute(dae.h, dae.x, w)
        inverse = dae.N_inverse
        found = _solved(ca.mtimes(dae.C, dae.G), gap) if inverse is None else ca.mtimes(ca.DM(inverse), gap)
        x = _with_measured_states(dae, w + ca.mtimes(dae.G, found), y)
        return ca.Function("consistent", arguments, [ca.densify(x), ca.densify(found), ca.SX(0)], {"cse": True})
    residual = ca.vertcat(dae.x - ca.mtimes(dae.G, mu) - w, dae.h - y)
    unknown = ca.vertcat(dae.x, mu)
    # x - (G mu) first: near the identity, so elimination needs no pivoting; the Schur complement is then about h_x h_x'.
    step = _solved(ca.jacobian(residual, unknown), residual)
    newton = ca.Function("newton", arguments, [ca.densify(unknown - step)], {"cse": True})
    both = before = unknown
    for _ in range(iterations):
        before, both = both, newton(w, y, both[: dae.n], both[dae.n :], dae.p, dae.t)
    x = _with_measured_states(dae, both[: dae.n], y)
    return ca.Function("consistent", arguments, [x, both[dae.n :], _change(before, both)])


def w_rate(dae: Dae, gain: Gain) -> ca.Function:
    """w_rate(x, mu, y_dot, u, p, t, tuning) -> w' = f + Gamma_bar mu - G' mu, of w = x - G mu (errata to (2.10)).

    Where G moves, G' = dG/dt needs x' and hence y', (2.6), (2.7): that of the interpolated measurement, times mu.
    """
    mu, y_dot, tuning = ca.SX.sym("mu", dae.n_outputs), ca.SX.sym("y_dot", dae.n_outputs), _tuning(gain)
    Gamma = gain.gamma(*dae.arguments, tuning)[0]
    rate = dae.f + ca.mtimes(Gamma, mu[dae.n_disturbances :])
    if not dae.linear_outputs:
        h_t = ca.jacobian(dae.h, dae.t)
        mu_dot = _solved(ca.mtimes(dae.C, dae.G), y_dot - h_t - ca.mtimes(dae.C, rate))
        x_dot = rate + ca.mtimes(dae.G, mu_dot)
        moving = ca.mtimes(dae.G, mu)
        rate = rate - ca.mtimes(ca.jacobian(moving, dae.x), x_dot) - ca.jacobian(moving, dae.t)
    arguments = [dae.x, mu, y_dot, dae.u, dae.p, dae.t, tuning]
    return ca.Function("w_rate", arguments, [ca.densify(rate)], {"cse": True})


def w_step(dae: Dae, gain: Gain) -> Callable[..., tuple[Any, Any, Any]]:
    """step(x, mu, samples, k, u_begin, u_end, p, t, Ts, tuning) -> (x, mu, change) at t: classical Runge-Kutta on w.

    `samples`: y_k, y_(k-1), ... newest first, whose cubic gives y within the interval: only past samples, so it is causal.
    """
    rate, inner, last = w_rate(dae, gain), consistent(dae, STAGE_ITERATIONS), consistent(dae, ITERATIONS)

    def step(
        x: Any, mu: Any, samples: list[Any], k: Any, u_begin: Any, u_end: Any, p: Any, t: Any, Ts: Any, tuning: Any
    ) -> tuple[Any, Any, Any]:
        begin = x - ca.mtimes(G_at(x, p, t - Ts), mu)
        total, w, slope = 0, begin, None
        for at, weight in ((-1, 1), (Fraction(-1, 2), 2), (Fraction(-1, 2), 2), (0, 1)):
            time = t + float(at) * Ts
            if slope is not None:
                w = begin + Ts * (0.5 if at else 1.0) * slope
                x, mu, _ = inner(w, interpolated(samples, k, Fraction(at)), x, mu, p, time)
            y_dot = 0 if dae.linear_outputs else interpolated(samples, k, Fraction(at), derivative=True) / Ts
            u = u_end if at == 0 else u_begin if at == -1 else (u_begin + u_end) / 2
            slope = rate(x, mu, y_dot, u, p, time, tuning)
            total = total + weight * slope
        return last(begin + Ts * total / 6, samples[0], x, mu, p, t)

    G = ca.Function("G", [dae.x, dae.p, dae.t], [ca.densify(dae.G)])

    def G_at(x: Any, p: Any, t: Any) -> Any:
        return ca.DM(ca.evalf(dae.G)) if dae.G.is_constant() else G(x, p, t)

    return step


def bdf_step(dae: Dae, gain: Gain, order: int) -> Callable[..., tuple[Any, Any, Any, Any]]:
    """step(x, mu, y, past, k, u, p, t, Ts, tuning) -> (x, mu, change, mu') at t: (4.3) by BDF of `order`, Newton's method from (x, mu).

    `past`: the columns (x, mu) at t - Ts, t - 2 Ts, ..., as many as `order`; the order grows with the `k` of them that are there.
    """
    mu, y, tuning = ca.SX.sym("mu", dae.n_outputs), ca.SX.sym("y", dae.n_outputs), _tuning(gain)
    both = ca.vertcat(dae.x, mu)
    a_0, older, Ts = ca.SX.sym("a_0"), ca.SX.sym("older", both.numel()), ca.SX.sym("Ts")
    moved = a_0 * both + older  # Ts (x', mu')
    Gamma = gain.gamma(*dae.arguments, tuning)[0]
    residual = ca.vertcat(
        moved[: dae.n] - ca.mtimes(dae.G, moved[dae.n :]) - Ts * (dae.f + ca.mtimes(Gamma, mu[dae.n_disturbances :])),
        dae.h - y,
    )
    arguments = [both, y, a_0, older, dae.u, dae.p, dae.t, Ts, tuning]
    correction = _solved(ca.jacobian(residual, both), residual)  # (4.4) with -Gamma, (4.5)
    newton = ca.Function("newton", arguments, [ca.densify(both - correction)], {"cse": True})

    def step(
        x: Any, mu: Any, y: Any, past: list[Any], k: Any, u: Any, p: Any, t: Any, Ts: Any, tuning: Any
    ) -> tuple[Any, Any, Any, Any]:
        a_0, older = growing(order, past, k)
        both = before = ca.vertcat(x, mu)
        for _ in range(ITERATIONS):
            before, both = both, newton(both, y, a_0, older, u, p, t, Ts, tuning)
        moved = a_0 * both + older
        x = _with_measured_states(dae, both[: dae.n], y)
        return x, both[dae.n :], _change(before, both), moved[dae.n :] / Ts

    return step


def samples_needed() -> int:
    """Past samples that the w-form interpolates through, besides the newest."""
    return CUBIC


def _solved(A: ca.SX, b: ca.SX) -> ca.SX:
    """A^-1 b by elimination without pivoting, see `lu_factor`."""
    LU = lu_factor(A)
    return backward(LU, forward(LU, b))


def _change(before: Any, after: Any) -> Any:
    """The last correction of Newton's method, relative to 1 or the largest unknown."""
    return ca.mmax(ca.fabs(after - before)) / (1 + ca.mmax(ca.fabs(after)))


def _tuning(gain: Gain) -> ca.SX:
    return ca.SX.sym("tuning", len(gain.tuning))


def _with_measured_states(dae: Dae, x: Any, y: Any) -> Any:
    """x with the states that an output shows as they are set to that output: (2.11) to the last bit."""
    entries = list(ca.vertsplit(x))
    for i, expression in enumerate(ca.vertsplit(dae.h)):
        for j in range(dae.n):
            if ca.is_equal(expression, dae.x[j]):
                entries[j] = y[i]
    return ca.vertcat(*entries)
