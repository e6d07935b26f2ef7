"""One sample interval of the canonical DAE observer: by Runge-Kutta, or by the paper's backward differentiation (section 4).

Both advance (x, mu) of the relaxed DAE (see `dae`) from t_(k-1) to t_k, where the measurement is y_k.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import casadi as ca

from observers.canonical_dae.bdf import growing
from observers.canonical_dae.dae import Dae
from observers.canonical_dae.gain import Gain
from observers.canonical_dae.half_explicit import half_explicit
from observers.canonical_dae.interpolation import interpolated
from observers.numerics.linear import backward, forward, lu_factor

ITERATIONS = 5  # of Newton's method

Step = Callable[..., tuple[Any, Any, Any]]


def consistent(dae: Dae) -> ca.Function:
    """consistent(w, y, x, mu, u, p, t) -> (x, mu, change) of x - G(x) mu = w, h(x) = y (2.11): explicit for linear outputs.

    Else by Newton's method from the x, mu given; `change` is its last relative correction, which tells whether it converged. mu is the
    multiplier of the projection of w onto h(x) = y.
    """
    w, y, mu = ca.SX.sym("w", dae.n), ca.SX.sym("y", dae.n_outputs), ca.SX.sym("mu", dae.n_outputs)
    arguments = [w, y, dae.x, mu, *_at(dae)]
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
    for _ in range(ITERATIONS):
        before, both = both, newton(w, y, both[: dae.n], both[dae.n :], *_at(dae))
    x = _with_measured_states(dae, both[: dae.n], y)
    return ca.Function("consistent", arguments, [x, both[dae.n :], _change(before, both)])


def integrated(dae: Dae, gain: Gain, degree: int) -> Step:
    """The step over a sample interval, from t - Ts to t: Runge-Kutta on w for linear outputs, half-explicit Runge-Kutta otherwise.

    step(x, mu, samples, k, u_begin, u_end, p, t, Ts, tuning) -> (x, mu, change) at t. `samples`: y_k, y_(k-1), ... newest first, whose
    polynomial of `degree` gives y within the interval: only past samples, so it is causal.
    """
    return w_step(dae, gain, degree) if dae.linear_outputs else moving_step(dae, gain, degree)


def w_step(dae: Dae, gain: Gain, degree: int) -> Step:
    """w = x - G mu of linear outputs: w' = f + Gamma_bar mu (errata to (2.10)), G constant; classical Runge-Kutta."""
    mu, tuning = ca.SX.sym("mu", dae.n_outputs), _tuning(gain)
    rate = ca.Function(
        "rate", [dae.x, mu, *_at(dae), tuning], [ca.densify(_forced(dae, gain, mu, tuning))], {"cse": True}
    )
    project = consistent(dae)
    G = ca.Function("G", [dae.p], [ca.densify(dae.G)])

    def step(
        x: Any, mu: Any, samples: list[Any], k: Any, u_begin: Any, u_end: Any, p: Any, t: Any, Ts: Any, tuning: Any
    ) -> tuple[Any, Any, Any]:
        begin = x - ca.mtimes(G(p), mu)
        total, w, slope = 0, begin, None
        for at, weight in ((-1, 1), (Fraction(-1, 2), 2), (Fraction(-1, 2), 2), (0, 1)):
            time = t + float(at) * Ts
            u = u_end if at == 0 else u_begin if at == -1 else (u_begin + u_end) / 2
            if slope is not None:
                w = begin + Ts * (0.5 if at else 1.0) * slope
                x, mu, _ = project(w, interpolated(samples, k, Fraction(at), degree), x, mu, u, p, time)
            slope = rate(x, mu, u, p, time, tuning)
            total = total + weight * slope
        return project(begin + Ts * total / 6, samples[0], x, mu, u_end, p, t)

    return step


def moving_step(dae: Dae, gain: Gain, degree: int) -> Step:
    """What the w-form becomes where h_x moves: half-explicit Runge-Kutta on (2.10) itself, h(x) = y by Newton's method at each stage.

    w' would hold (d/dt h_x)' lambda and with it y'; no variable instead of w is free of y' unless the outputs' gradients commute.
    Here h_x is not differentiated; for a constant h_x the step is Runge-Kutta on w.
    """
    mu, y, nu = (ca.SX.sym(name, dae.n_outputs) for name in ("mu", "y", "nu"))
    base, G, tuning = ca.SX.sym("base", dae.n), ca.SX.sym("G", dae.n, dae.n_outputs), _tuning(gain)
    terms = ca.Function(
        "terms",
        [dae.x, mu, *_at(dae), tuning],
        [ca.densify(_forced(dae, gain, mu, tuning)), ca.densify(dae.G)],
        {"cse": True},
    )
    projected = base + ca.mtimes(G, nu)
    gap, slope = (ca.substitute(expression, dae.x, projected) for expression in (dae.h - y, dae.C))
    newton = ca.Function(
        "newton", [nu, base, G, y, *_at(dae)], [ca.densify(nu - _solved(ca.mtimes(slope, G), gap))], {"cse": True}
    )

    def step(
        x: Any, mu: Any, samples: list[Any], k: Any, u_begin: Any, u_end: Any, p: Any, t: Any, Ts: Any, tuning: Any
    ) -> tuple[Any, Any, Any]:
        changes = []

        def at(c: float) -> tuple[Any, Any, Any]:
            return u_begin + c * (u_end - u_begin), p, t + (c - 1) * Ts

        def constrain(moved: Any, G: Any, c: float) -> Any:
            y = interpolated(samples, k, Fraction(c) - 1, degree)
            nu = before = ca.MX.zeros(dae.n_outputs)
            for _ in range(ITERATIONS):
                before, nu = nu, newton(nu, moved, G, y, *at(c))
            changes.append(_change(moved + ca.mtimes(G, before), moved + ca.mtimes(G, nu)))
            return nu

        x, mu = half_explicit(lambda x, mu, c: terms(x, mu, *at(c), tuning), constrain, x, mu, Ts)
        return _with_measured_states(dae, x, samples[0]), mu, ca.mmax(ca.vertcat(*changes))

    return step


def bdf_step(dae: Dae, gain: Gain, order: int) -> Callable[..., tuple[Any, Any, Any, Any]]:
    """step(x, mu, y, past, k, u, p, t, Ts, tuning) -> (x, mu, change, mu') at t: (4.3) by BDF of `order`, Newton's method from (x, mu).

    The derivative of an iterated gain is left out of Newton's matrix: its code would be five times the gain's own.
    `past`: the columns (x, mu) at t - Ts, t - 2 Ts, ..., as many as `order`; the order grows with the `k` of them that are there.
    """
    mu, y, tuning = ca.SX.sym("mu", dae.n_outputs), ca.SX.sym("y", dae.n_outputs), _tuning(gain)
    both = ca.vertcat(dae.x, mu)
    a_0, older, Ts = ca.SX.sym("a_0"), ca.SX.sym("older", both.numel()), ca.SX.sym("Ts")
    moved = a_0 * both + older  # Ts (x', mu')
    Gamma = gain.gamma(*dae.arguments, _lambda(dae, mu), tuning)[0]

    def residual(Gamma: ca.SX) -> ca.SX:
        forced = dae.f + ca.mtimes(Gamma, _lambda(dae, mu))
        return ca.vertcat(moved[: dae.n] - ca.mtimes(dae.G, moved[dae.n :]) - Ts * forced, dae.h - y)

    slope = ca.jacobian(residual(Gamma), both)  # (4.4) with -Gamma, (4.5)
    if gain.iterated:
        held = ca.SX.sym("Gamma", *Gamma.shape)
        slope = ca.substitute(ca.jacobian(residual(held), both), held, Gamma)
    arguments = [both, y, a_0, older, *_at(dae), Ts, tuning]
    correction = _solved(slope, residual(Gamma))
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


def _at(dae: Dae) -> list[ca.SX]:
    return [dae.u, dae.p, dae.t]


def _forced(dae: Dae, gain: Gain, mu: ca.SX, tuning: ca.SX) -> ca.SX:
    """f + Gamma_bar mu (n x 1)."""
    Gamma = gain.gamma(*dae.arguments, _lambda(dae, mu), tuning)[0]
    return dae.f + ca.mtimes(Gamma, _lambda(dae, mu))


def _lambda(dae: Dae, mu: ca.SX) -> ca.SX:
    """The relaxations of mu (p - q x 1); an empty slice would be 1 x 0."""
    return mu[dae.n_disturbances :] if dae.n_lambda else ca.SX(0, 1)


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
