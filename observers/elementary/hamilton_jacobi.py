"""The scalar Hamilton-Jacobi equation (9) of Calvillo-Corona & Alamir on a grid: a semi-Lagrangian scheme for any scalar problem.

    V_n(xi) = w_n l(xi) + min over nu in V of ( s/2 sum_j r_j delta_j^2 + V_(n+1)(xi+) ),   V_(N-1) = w_(N-1) l

backward over the window, then V_0 is minimised over the unknown initial state, then the minimising controls are followed forward. Between
the grid's nodes V is a cubic Hermite interpolant with slopes of fourth order, exact for quadratics; beyond its ends the parabola through
its first, middle and last value, as far as it rises.

The minimum over nu is one over a scalar however many controls there are: at it, nu_j = clip(nu_ref_j + b_j lambda / r_j) with a common
costate lambda. Costates that would lead to places all over the grid are tried, the best is refined by Newton steps on lambda = -V' / (1 -
s a / 2), and the best of all is taken, so that V need not be convex.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from observers.elementary.columns import repeated
from observers.elementary.scalar_problem import ScalarProblem
from observers.numerics.layout import Layout

SPREAD = 6  # places on the grid, from end to end, for which the costate that would lead there is tried
NEWTON = 6  # steps from the best of them, halving the bracket where Newton's leads out of it
TINY = 1e-100  # reach of a costate where nothing acts as a control
SETTLING = 2  # more of them for xi+ alone
SETTLED = 1e-6  # of the grid's range: the largest last Newton step of an xi+ that counts
PASSES = 3  # Newton steps for xi+ and the controls of a costate, where the equation is not affine


def hamilton_jacobi(problem: ScalarProblem, N: int) -> ca.Function:
    """solve(ref, nu, rate, known, target, active, s, p, q, r) -> (xi (1 x N), delta (m x N-1)), as `gauss_newton`; O(N nodes)."""
    v = problem.arguments(ca.MX, N)
    # Before the first sample nothing is paid and nothing moves.
    weight = v.s / 2 * (ca.horzcat(0, v.active) + ca.horzcat(v.active, 0))
    shared = repeated(ca.vertcat(v.s, v.p, v.r), N - 1)
    data = ca.vertcat(v.nu, (v.ref[:-1] + v.ref[1:]) / 2, v.rate, v.known, v.active, shared)
    nodes = ca.vertcat(weight, v.ref, v.target, repeated(v.p, N), repeated(v.q, N))
    last = _penalty(problem)(nodes[:, -1])
    back = list(reversed(range(N - 1)))
    values = _backward(problem).mapaccum("values", N - 1)(last, data[:, back], nodes[:, back])
    following = ca.horzcat(values[:, back[1:]], last)  # V_(i+1) of the interval i
    start = _lowest(problem)(values[:, -1])
    xi, delta = _forward(problem).mapaccum("trajectory", N - 1)(start, data, following)
    return ca.Function(f"solve_{problem.name}", list(vars(v).values()), [ca.horzcat(start, xi), delta])


def _grid(problem: ScalarProblem) -> ca.DM:
    """The grid's nodes, 1 x M."""
    return ca.DM(np.linspace(*problem.nodes)).T


def _penalty(problem: ScalarProblem) -> ca.Function:
    """penalty(node) -> w l (M x 1) at the grid's nodes; `node` holds w, ref, target, p, q."""
    sizes = [1, *(problem.penalty.numel_in(i) for i in range(1, 5))]
    M, node = problem.nodes[2], ca.MX.sym("node", sum(sizes))
    weight, *rest = ca.vertsplit(node, np.cumsum([0, *sizes]).tolist())
    cost = problem.penalty.map(M)(_grid(problem), *[repeated(column, M) for column in rest])[0]
    return ca.Function("penalty", [node], [weight * cost.T])


def _slopes(V: Any) -> Any:
    """dV/dindex (M x 1) at the grid's nodes: fourth order inside, second order at the two nodes at either end."""
    M = V.numel()
    inside = (8 * (V[3:-1] - V[1:-3]) - (V[4:] - V[: M - 4])) / 12
    first = (-3 * V[0] + 4 * V[1] - V[2]) / 2
    last = (3 * V[M - 1] - 4 * V[M - 2] + V[M - 3]) / 2
    return ca.vertcat(first, (V[2] - V[0]) / 2, inside, (V[M - 1] - V[M - 3]) / 2, last)


def _interpolant(problem: ScalarProblem, V: Any, S: Any) -> Any:
    """look(xi) -> (V, V', V'') at xi (1 x k), from the grid's values and slopes (M x 1)."""
    low, high, M = problem.nodes
    width = (high - low) / (M - 1)
    place, v0, v1, s0, s1, before, behind, bend = (
        ca.SX.sym(name) for name in ("place", "v0", "v1", "s0", "s1", "before", "behind", "bend")
    )
    inside = ca.fmin(ca.fmax(place, 0), 1)
    beyond = place - inside
    rise = v1 - v0
    c2, c3 = 3 * rise - 2 * s0 - s1, s0 + s1 - 2 * rise
    outward = ca.if_else(beyond > 0, behind, before)
    value = v0 + inside * (s0 + inside * (c2 + inside * c3)) + beyond * (outward + beyond / 2 * bend)
    slope = ca.if_else(beyond == 0, s0 + inside * (2 * c2 + 3 * inside * c3), outward + beyond * bend)
    second = ca.if_else(beyond == 0, 2 * c2 + 6 * inside * c3, bend)
    symbols = [place, v0, v1, s0, s1, before, behind, bend]
    cell = ca.Function("cell", symbols, [value, slope / width, second / width**2])
    # Differences over the whole grid, not over its last cells: an edge whose motion leads outwards is continued from itself at every
    # step, and what the cells' differences make of rounding would grow without limit.
    middle, last = (M - 1) // 2, M - 1
    left, right = (V[middle] - V[0]) / middle, (V[last] - V[middle]) / (last - middle)
    second_difference = (right - left) / last
    ends = (
        ca.fmin(left - second_difference * middle, 0),
        ca.fmax(right + second_difference * (last - middle), 0),
        ca.fmax(2 * second_difference, 0),
    )

    def look(xi: Any) -> tuple[Any, Any, Any]:
        position = (xi - low) / width
        index = ca.fmin(ca.fmax(ca.floor(position), 0), M - 2)
        corners = [ca.reshape(column[index + k], xi.shape) for column in (V, S) for k in (0, 1)]
        k = xi.shape[1]
        value, slope, second = cell.map(k)(position - index, *corners, *(repeated(end, k) for end in ends))
        return value, slope, second

    return look


def _step(problem: ScalarProblem, k: int) -> ca.Function:
    """step(xi, lambda (1 x k), data) -> (xi+, control cost, delta (m x k), 1 - s a/2, s sum over the free b^2 / r)."""
    m = problem.n_controls
    xi, costate, data = ca.SX.sym("xi"), ca.SX.sym("lambda"), ca.SX.sym("data", _layout(problem).total)
    d = _layout(problem).unpack(data)
    at_reference, _, _ = problem.dynamics(d.middle, d.nu, d.known, d.p)
    after, delta = xi + d.s * d.rate, ca.SX.zeros(m)
    low, high = ca.DM(list(problem.lower)) - d.nu, ca.DM(list(problem.upper)) - d.nu
    a, gain, moved = ca.SX(0), ca.SX(0), ca.SX(0)
    for _ in range(1 if problem.affine else PASSES):
        F, a, b = problem.dynamics((xi + after) / 2, d.nu + delta, d.known, d.p)
        wanted = b.T / d.r * costate if m else ca.SX(0, 1)
        chosen = ca.fmin(ca.fmax(wanted, low), high)
        free = chosen == wanted
        F = F + (ca.mtimes(b, chosen - delta) if m else 0)
        moved = (after - xi - d.s * (d.rate + F - at_reference)) / (1 - d.s / 2 * a)
        after, delta = after - moved, chosen
        gain = d.s * ca.dot(free * b.T, b.T / d.r) if m else ca.SX(0)
    cost = d.s / 2 * ca.dot(d.r * delta, delta) if m else ca.SX(0)
    if not problem.affine:
        # Whatever the controls have become, xi+ is theirs: no value can be lower than what some controls reach.
        for _ in range(SETTLING):
            F, a, _ = problem.dynamics((xi + after) / 2, d.nu + delta, d.known, d.p)
            moved = (after - xi - d.s * (d.rate + F - at_reference)) / (1 - d.s / 2 * a)
            after = after - moved
        cost = ca.if_else(ca.fabs(moved) < SETTLED * (problem.nodes[1] - problem.nodes[0]), cost, ca.inf)
    after = ca.if_else(d.active, after, xi)
    one = ca.Function(
        "one",
        [xi, costate, data],
        [after, ca.if_else(d.active, cost, 0), ca.if_else(d.active, delta, 0), 1 - d.s / 2 * a, d.active * gain],
    )
    xis, costates, shared = ca.MX.sym("xi", 1, k), ca.MX.sym("lambda", 1, k), ca.MX.sym("data", data.numel())
    return ca.Function("step", [xis, costates, shared], [*one.map(k)(xis, costates, repeated(shared, k))])


def _layout(problem: ScalarProblem) -> Layout:
    """What `data` of an interval holds."""
    m, known, p = problem.n_controls, problem.dynamics.numel_in(2), problem.dynamics.numel_in(3)
    return Layout(nu=m, middle=1, rate=1, known=known, active=1, s=1, p=p, r=m)


def _minimise(problem: ScalarProblem, k: int) -> ca.Function:
    """minimise(xi (1 x k), data, V, S (M x 1)) -> (cost-to-go without the node's own penalty, xi+ (1 x k), delta (m x k))."""
    M = problem.nodes[2]
    xi, data = ca.MX.sym("xi", 1, k), ca.MX.sym("data", _layout(problem).total)
    V, S = ca.MX.sym("V", M), ca.MX.sym("S", M)
    step, look = _step(problem, k), _interpolant(problem, V, S)
    best: list[Any] = []

    def tried(costate: Any) -> Any:
        """Keeps the costate where it is better than those before; returns (psi = costate + V' / .., where Newton leads)."""
        nonlocal best
        after, cost, delta, inverse, gain = step(xi, costate, data)
        value, slope, second = look(after)
        psi = costate + slope / inverse
        newton = costate - psi / (1 + ca.fmax(second, 0) * gain / inverse**2)
        found = [cost + value, after, delta, costate, psi, newton, gain / inverse]
        if best:
            better = found[0] < best[0]
            pairs = zip(found, best, strict=True)
            best = [ca.if_else(ca.repmat(better, new.shape[0], 1), new, old) for new, old in pairs]
        else:
            best = found
        return psi, newton

    tried(ca.MX.zeros(1, k))
    _, drift, *_, reach = best
    goals = np.linspace(*problem.nodes[:2], SPREAD)
    between = float(goals[1] - goals[0]) / ca.fmax(reach, TINY)
    first = (problem.nodes[0] - drift) / ca.fmax(reach, TINY)
    for place in range(SPREAD):
        tried(first + place * between)
    # The optimum lies beside the best of these, on the side to which psi points; beyond the first and the last there is no end.
    costate, psi, proposed = best[3:6]
    last = first + (SPREAD - 1.5) * between
    low = ca.if_else(psi < 0, costate, ca.if_else(costate < first + between / 2, -ca.inf, costate - between))
    high = ca.if_else(psi > 0, costate, ca.if_else(costate > last, ca.inf, costate + between))
    for _ in range(NEWTON):
        inside = ca.logic_and(low < proposed, proposed < high)
        costate = ca.if_else(inside, proposed, (low + high) / 2)
        psi, proposed = tried(costate)
        low, high = ca.if_else(psi < 0, costate, low), ca.if_else(psi > 0, costate, high)
    return ca.Function("minimise", [xi, data, V, S], best[:3])


def _backward(problem: ScalarProblem) -> ca.Function:
    """backward(V_(i+1), data, node) -> V_i, all values M x 1."""
    penalty, M = _penalty(problem), problem.nodes[2]
    V, data, node = ca.MX.sym("V", M), ca.MX.sym("data", _layout(problem).total), ca.MX.sym("node", penalty.numel_in(0))
    cost = _minimise(problem, M)(_grid(problem), data, V, _slopes(V))[0]
    return ca.Function("backward", [V, data, node], [penalty(node) + cost.T])


def _forward(problem: ScalarProblem) -> ca.Function:
    """forward(xi_i, data, V_(i+1) (M x 1)) -> (xi_(i+1), delta_i (m x 1))."""
    xi, data, V = ca.MX.sym("xi"), ca.MX.sym("data", _layout(problem).total), ca.MX.sym("V", problem.nodes[2])
    _, after, delta = _minimise(problem, 1)(xi, data, V, _slopes(V))
    return ca.Function("forward", [xi, data, V], [after, delta])


def _lowest(problem: ScalarProblem) -> ca.Function:
    """lowest(V) -> the xi where V (M x 1) is least: the best node, then Newton steps within the cells beside it."""
    low, high, M = problem.nodes
    V, width = ca.MX.sym("V", M), (high - low) / (M - 1)
    look = _interpolant(problem, V, _slopes(V))
    first = ca.mmax(ca.if_else(ca.mmin(V) == V, _grid(problem).T, low))
    xi = first
    for _ in range(NEWTON):
        _, slope, second = look(xi)
        moved = ca.if_else(second > 0, xi - slope / second, xi)
        xi = ca.fmin(ca.fmax(moved, ca.fmax(first - width, low)), ca.fmin(first + width, high))
    return ca.Function("lowest", [V], [xi])
