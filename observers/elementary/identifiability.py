"""What a window does not determine: the direction in states and disturbances that its outputs see least, from the window's linearisation.

With delta x+ = Phi delta x + Gamma w and delta y+ = C+ delta x+ + D+ w along the window, the disturbances adapt so that the outputs change
least. Of the samples behind the i-th they leave delta x_i' Q_i delta x_i,

    Q_i = F' Q_(i+1) F + E' E + mu K' K,   F = Phi - Gamma K,   E = C+ F - D+ K,   w = -K delta x,
    K = (Gamma' Q_(i+1) Gamma + L' L + mu)^-1 (Gamma' Q_(i+1) Phi + L' C+ Phi),   L = C+ Gamma + D+

(the Riccati equation of cheap control, mu -> 0). With P_0 = C' C + Q_0, delta x_0' P_0 delta x_0 is then the least change that the
outputs can show of delta x_0, and S delta x_0, S the product of F, what becomes of it at the window's end, the estimate. Where the smallest
eigenvalue of P_0 z = lambda S' S z vanishes, that direction and the disturbances that hide it cannot be told from the outputs; one that
dies out does not count. Where each state is measured and has a disturbance, all do, each within a sample: S is kept in range by a factor.
"""

from __future__ import annotations

import math
from typing import Any

import casadi as ca
import numpy as np

from observers.elementary.columns import repeated
from observers.elementary.iteration import acting, symbols
from observers.elementary.output_problem import at_samples, output_problems
from observers.model import Model
from observers.numerics import linear
from observers.numerics.runge_kutta import runge_kutta

MU = 1e-10  # price of a disturbance of one nominal value on an interval, against one nominal value of an output at a sample
AT_BOUND = 1e-6  # of its nominal value: a disturbance as near to a bound is held there
SWEEPS = 6  # of inverse iteration
SHIFT = 1e-13  # of the trace, so that a singular P_0 can be factored
TINY = 1e-300  # so that nothing divides by zero
SCALED = 1e-60  # a product of transitions below is scaled to 1: squared, it would leave the range of numbers
MOST_SEEN = 1e100  # the largest visibility: of a direction of which nothing is left
NAMED = 0.02  # of the largest: a variable with a smaller part in a direction is not named
VISIBLE = 1e-3  # a visibility below: not determined


def least_visible(model: Model, N: int) -> ca.Function:
    """f(X, W, Y, V, u0, u1, u, active, t, s, p) -> (visibility, direction (n + k)).

    `visibility`: the rms change of the outputs over the window, in units of their nominal values, when the state at its end moves by one
    unit of nominal values in the least visible direction. `direction`: that one at the window's end, states and disturbances in
    their units, its largest entry one nominal value. A disturbance at a bound is held there.
    """
    v = symbols(model, N, 0)
    n, k = len(model.states), len(model.unknown_disturbances)
    times = v.t + v.s * ca.DM(range(1 - N, 1)).T
    p = repeated(v.p, N)
    ny, valid = len(model.outputs), acting(model, v.active) * v.V
    C, D = _output_gradients(model).map(N)(v.X, at_samples(v.W), v.u, p, times)
    disturbed = bool(output_problems(model))
    C, D = C * ca.repmat(valid, n, 1), D * ca.repmat(valid, k, 1) if disturbed else ca.MX(0, N)
    middle = (v.X[:, :-1] + v.X[:, 1:]) / 2
    moves = _transition(model).map(N - 1)(
        middle, (v.u0 + v.u1) / 2, v.W, p[:, :-1], times[:-1] + v.s / 2, v.active, ca.repmat(v.s, 1, N - 1)
    )
    order = list(reversed(range(N - 1)))
    ends_at = [i + 1 for i in order]
    Qs, Ks = _back(n, k, ny, disturbed).mapaccum("riccati", N - 1)(0, C[:, ends_at], D[:, ends_at], moves[:, order])
    first = ca.reshape(C[:, 0], ny, n)
    P_0 = Qs[:, -1] + ca.vec(ca.mtimes(first.T, first))
    move = ca.SX.sym("move", n * (n + k))
    Phi, Gamma = ca.reshape(move[: n * n], n, n), ca.reshape(move[n * n :], n, k)
    S, logarithm, gain = ca.SX.sym("S", n * n), ca.SX.sym("logarithm"), ca.SX.sym("K", k * n)  # exp(logarithm) S
    closed = Phi - ca.mtimes(Gamma, ca.reshape(gain, k, n)) if k else Phi
    product = ca.vec(ca.mtimes(closed, ca.reshape(S, n, n)))
    size = ca.norm_inf(product)
    factor = ca.if_else(size < SCALED, ca.fmax(size, TINY), 1)
    onward = ca.Function(
        "onward", [ca.vertcat(S, logarithm), move, gain], [ca.vertcat(product / factor, logarithm + ca.log(factor))]
    )
    ends = onward.mapaccum("ends", N - 1)(ca.vertcat(ca.vec(ca.DM.eye(n)), 0), moves, Ks[:, order])
    smallest, z = _smallest(n)(P_0, ends[: n * n, -1])
    end = ca.mtimes(ca.reshape(ends[: n * n, -1], n, n), z)
    before_end = ca.mtimes(ca.reshape(ends[: n * n, N - 3], n, n), z) * ca.exp(ends[-1, N - 3] - ends[-1, -1])
    direction = ca.vertcat(end, -ca.mtimes(ca.reshape(Ks[:, 0], k, n), before_end) if k else ca.MX(0, 1))
    largest = ca.if_else(ca.mmax(direction) >= -ca.mmin(direction), ca.mmax(direction), ca.mmin(direction))
    nominal = ca.DM([variable.nominal for variable in (*model.states, *model.unknown_disturbances)])
    samples = ca.fmax(ca.sum1(ca.sum2(valid)), 1)
    left = ca.sumsqr(end) > 0
    visibility = ca.sqrt(ca.fmax(smallest, 0) / samples) * ca.exp(-ends[-1, -1])
    visibility = ca.if_else(left, ca.fmin(visibility, MOST_SEEN), MOST_SEEN)
    return ca.Function("least_visible", list(vars(v).values())[:-1], [visibility, direction / largest * nominal])


def _back(n: int, k: int, ny: int, disturbed: bool) -> ca.Function:
    """back(Q_(i+1), C, D of the sample i + 1, move of the interval) -> (Q_i, K), as columns. D counts where outputs are `disturbed`."""
    Q_, C_, D_ = ca.SX.sym("Q", n * n), ca.SX.sym("C", ny * n), ca.SX.sym("D", ny * k if disturbed else 0)
    move = ca.SX.sym("move", n * (n + k))
    Phi, Gamma = ca.reshape(move[: n * n], n, n), ca.reshape(move[n * n :], n, k)
    C, D = ca.reshape(C_, ny, n), ca.reshape(D_, ny, k) if disturbed else ca.SX(ny, k)
    P, K, F = ca.reshape(Q_, n, n) + ca.mtimes(C.T, C), ca.SX(0, n), Phi
    if k:
        shared = ca.mtimes([D.T, C, Gamma])
        inner = ca.mtimes([Gamma.T, P, Gamma]) + shared + shared.T + ca.mtimes(D.T, D)
        cross = ca.mtimes([Gamma.T, P, Phi]) + ca.mtimes([D.T, C, Phi])
        LU = linear.lu_factor(inner + MU * ca.SX.eye(k))
        K = linear.backward(LU, linear.forward(LU, cross))
        F = Phi - ca.mtimes(Gamma, K)
    DK = ca.mtimes(D, K)
    taken = ca.mtimes([F.T, C.T, DK])
    before = ca.mtimes([F.T, P, F]) - taken - taken.T + ca.mtimes(DK.T, DK) + MU * ca.mtimes(K.T, K)
    return ca.Function("back", [Q_, C_, D_, move], [ca.vec((before + before.T) / 2), ca.vec(K)])


def _output_gradients(model: Model) -> ca.Function:
    """(x, w, u, p, t) -> (dh/dx (ny n x 1), dh/dw (ny k x 1)), by columns, in units of nominal values."""
    eq = model.equations
    C, D = ca.densify(ca.jacobian(eq.output, eq.x)), ca.densify(ca.jacobian(eq.output, eq.w))
    C *= ca.DM([[x.nominal / y.nominal for x in model.states] for y in model.outputs])
    if model.unknown_disturbances:
        D = ca.mtimes(ca.diag(ca.DM([1 / y.nominal for y in model.outputs])), ca.mtimes(D, ca.diag(_free(model))))
    return ca.Function("gradients", [eq.x, eq.w, eq.u, eq.p, eq.t], [ca.vec(C), ca.densify(ca.vec(D))])


def _free(model: Model) -> ca.SX:
    """(k x 1): the nominal value of each disturbance that is not at a bound, 0 of one that is."""
    w = model.equations.w
    return ca.vertcat(
        *[
            (w[j] > v.min + AT_BOUND * v.nominal) * (w[j] < v.max - AT_BOUND * v.nominal) * v.nominal
            for j, v in enumerate(model.unknown_disturbances)
        ]
    )


def _transition(model: Model) -> ca.Function:
    """(x, u, w, p, t, active, s) -> (Phi, Gamma) (n (n + k) x 1) of an interval in units of nominal values, by the midpoint rule."""
    eq, n, k = model.equations, len(model.states), len(model.unknown_disturbances)
    active, s = ca.SX.sym("active"), ca.SX.sym("s")
    x = ca.diag(ca.DM([v.nominal for v in model.states]))
    A = ca.mtimes([ca.inv(x), ca.densify(ca.jacobian(eq.ode, eq.x)), x]) * active
    LU = linear.lu_factor(ca.SX.eye(n) - s / 2 * A)
    Phi = linear.backward(LU, linear.forward(LU, ca.densify(ca.SX.eye(n) + s / 2 * A)))
    Gamma = ca.SX(n, 0)
    if k:
        B = ca.mtimes([ca.inv(x), ca.densify(ca.jacobian(eq.ode, eq.w)), ca.diag(active * _free(model))])
        Gamma = linear.backward(LU, linear.forward(LU, s * ca.densify(B)))
    return ca.Function(
        "transition", [eq.x, eq.u, eq.w, eq.p, eq.t, active, s], [ca.vertcat(ca.vec(Phi), ca.vec(Gamma))]
    )


def _smallest(n: int) -> ca.Function:
    """smallest(P, S (n n x 1)) -> (the smallest lambda of P z = lambda S' S z, its z with |S z| = 1), P semidefinite; by
    inverse iteration.
    """
    columns = ca.SX.sym("P", n * n), ca.SX.sym("S", n * n)
    P, S = (ca.reshape(column, n, n) for column in columns)
    LU = linear.lu_factor(P + (SHIFT * ca.trace(P) + TINY) * ca.SX.eye(n))
    z = ca.SX([1 / (1 + i) for i in range(n)])
    for _ in range(SWEEPS):
        z = linear.backward(LU, linear.forward(LU, ca.mtimes([S.T, S, z])))
        z = z / ca.fmax(ca.norm_inf(z), TINY)
    z = z / ca.fmax(ca.norm_2(ca.mtimes(S, z)), TINY)
    return ca.Function("smallest", list(columns), [ca.mtimes([z.T, P, z]), z])


def describe(model: Model, N: int, sample_time: float) -> str:
    """What a window along the model's motion from its start values does not determine; "" where it does all, or diverges."""
    eq = model.equations
    rhs = ca.Function("rhs", [eq.x, eq.u, eq.w, eq.p, eq.t], [eq.ode])
    u, w, p, x = (
        ca.DM([v.start for v in group])
        for group in (model.inputs, model.unknown_disturbances, model.parameters, model.states)
    )
    X = [x]
    for i in range(N - 1):
        X.append(runge_kutta(lambda x, t: rhs(x, u, w, p, t), X[-1], i * sample_time, sample_time))
    states = ca.horzcat(*X)
    if not np.all(np.isfinite(states.full())):
        return ""
    # Within its bounds every disturbance is free here: what the equations alone leave open.
    ny, every = len(model.outputs), repeated(u, N)
    inside = repeated(ca.DM([_inside(v.min, v.max, v.start) for v in model.unknown_disturbances]), N - 1)
    arguments: list[Any] = [states, inside, ca.DM.zeros(ny, N), ca.DM.ones(ny, N)]
    arguments += [every[:, :-1], every[:, :-1], every, ca.DM.ones(1, N - 1), (N - 1) * sample_time, sample_time, p]
    visibility, direction = least_visible(model, N)(*arguments)
    if float(visibility) > VISIBLE:
        return ""
    variables = (*model.states, *model.unknown_disturbances)
    parts = [
        (v.name, e) for v, e in zip(variables, direction.full().ravel(), strict=True) if abs(e) > NAMED * v.nominal
    ]
    first = parts[0][1]
    sizes = [(name, entry / first, f"{abs(entry / first):.2g}") for name, entry in parts]
    return ", ".join(
        f"{name} {'+' if entry > 0 else '-'} {size + ' ' if size != '1' else ''}c" for name, entry, size in sizes
    )


def _inside(low: float, high: float, start: float) -> float:
    if math.isfinite(low) and math.isfinite(high):
        return (low + high) / 2
    return low + 1 if math.isfinite(low) else high - 1 if math.isfinite(high) else start
