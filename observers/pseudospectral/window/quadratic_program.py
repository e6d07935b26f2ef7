"""A small dense convex quadratic program with soft rows and a hard box, as a function that CasADi can generate as C.

    minimise  s'H s / 2 + g's + w t + t^2 / 2     subject to  A s - t <= b,  t >= 0,  lower <= s <= upper

One slack t for all rows: with a weight w above the sum of the rows' multipliers the penalty is exact (t = 0 where the rows can be met), and
where they cannot, the step that misses them least is found instead of none. Mehrotra's predictor-corrector interior point method (SIAM J.
Optim. 2, 1992; Nocedal & Wright, "Numerical Optimization", 2nd ed., algorithm 16.4), in x = (s, t):

    minimise  x'Q x / 2 + c'x   subject to  G x + q = h,  q >= 0,  multipliers lam >= 0,   G = [A, -1; I; -I]

Own code, not a library's: of CasADi's solvers only qrqp generates C that stands alone, an active set method which missed the solution of
one in four of the tests' random programs.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from observers.numerics import linear
from observers.numerics.layout import Layout

MOST_ITERATIONS = 40
FIRST_ITERATIONS = 12  # most programs need fewer: what comes later is jumped over as a whole
LARGEST_START = 1e4  # of the multipliers, in units where the largest violation and the curvatures are one
STEP_FRACTION = 0.995  # of the way to the nearest bound
TOLERANCE = 1e-11  # of the error below
ACCEPTED = 1e-7  # the same, where rounding lets the iteration go no further
GAP = 1e-2  # weight of sqrt(mu), which bounds a weakly active row's share of the error, against the residuals in it
BLOCK = 4  # rows that one call adds to the normal matrix
HUGE = 1e150  # beyond: not finite; its square still is a number


def quadratic_program(ns: int, rows: int) -> ca.Function:
    """Function quadratic_program(H, g, A, b, mask, lower, upper, weight) -> (s, t, iterations, ok).

    H (ns x ns) symmetric positive definite, g (ns), A (rows x ns), b (rows), mask (rows; 0 switches a row off, whatever it holds),
    lower and upper (ns; infinite: no bound), weight w > 0. Returns s (ns), the slack t, the iterations (0: the free step -H^-1 g satisfies
    everything and is the solution) and ok. With ok = 0 the program could not be solved (lower > upper, H not positive definite, a value
    that is not finite, no convergence) and s is the free step cut to the box, or zero cut to it where that is not finite; never a NaN.

    Raises:
        ValueError: ns or rows below 1.
    """
    if ns < 1 or rows < 1:
        raise ValueError(f"a quadratic program of {ns} variables and {rows} rows: both must be at least 1")
    H, g, A, b = ca.MX.sym("H", ns, ns), ca.MX.sym("g", ns), ca.MX.sym("A", rows, ns), ca.MX.sym("b", rows)
    mask, weight = ca.MX.sym("mask", rows), ca.MX.sym("weight")
    lower, upper = ca.MX.sym("lower", ns), ca.MX.sym("upper", ns)
    free, solvable = _free_step(ns)(H, g, lower, upper)
    At = A.T
    present, excess = _excess(ns).map("excesses", "serial", rows, [3], [])(At, b.T, mask.T, free)
    solvable = solvable * (ca.sumsqr(excess) < HUGE) * (weight > 0) * (weight < HUGE)
    outside = ca.mmax(ca.vertcat(excess.T, lower - free, free - upper)) > 0
    problem = [H, g, At, b.T, present, lower, upper, weight, free]
    names = [ca.MX.sym(f"i{k}", *part.shape) for k, part in enumerate(problem)]
    at_free = ca.Function("at_free", names, [names[-1], 1, 0])
    solved, ok, iterations = ca.Function.if_else("maybe_interior", _interior(ns, rows), at_free)(
        solvable * outside, *problem
    )
    ok = solvable * ok
    s = _cut(ns)(ca.if_else(ok, solved, free), lower, upper)
    _, missed = _excess(ns).map("excesses", "serial", rows, [3], [])(At, b.T, mask.T, s)
    return ca.Function(
        "quadratic_program",
        [H, g, A, b, mask, lower, upper, weight],
        [s, ca.fmax(ca.mmax(missed), 0), iterations, ok],
    )


def _free_step(ns: int) -> ca.Function:
    """(H, g, lower, upper) -> (-H^-1 g, whether it and the box exist)."""
    H, g = ca.SX.sym("H", ns, ns), ca.SX.sym("g", ns)
    lower, upper = ca.SX.sym("lower", ns), ca.SX.sym("upper", ns)
    step, pivots = linear.ldl_solve(H, -g)
    exists = ca.sumsqr(step) < HUGE
    for i in range(ns):
        exists = ca.logic_and(exists, ca.logic_and(pivots[i] > 0, lower[i] <= upper[i]))
    return ca.Function("free_step", [H, g, lower, upper], [step, exists])


def _excess(ns: int) -> ca.Function:
    """(a, b, mask, s) -> (whether the row is there, by how much it is exceeded); a row that is off: 0, -1."""
    a, b, mask, s = ca.SX.sym("a", ns), ca.SX.sym("b"), ca.SX.sym("mask"), ca.SX.sym("s", ns)
    present = ca.logic_and(mask != 0, ca.logic_not(b >= HUGE))
    return ca.Function("excess", [a, b, mask, s], [present, ca.if_else(present, ca.dot(a, s) - b, -1)])


def _cut(ns: int) -> ca.Function:
    """(s, lower, upper) -> s cut to the box; zero cut to it where s is not finite."""
    s, lower, upper = ca.SX.sym("s", ns), ca.SX.sym("lower", ns), ca.SX.sym("upper", ns)
    finite = ca.if_else(ca.sumsqr(s) < HUGE, s, 0)
    return ca.Function("cut", [s, lower, upper], [ca.fmin(ca.fmax(finite, lower), upper)])


def _interior(ns: int, rows: int) -> ca.Function:
    """(H, g, A', b', present', lower, upper, w, free) -> (s, ok, iterations), from the free step's point."""
    n = ns + 1
    H, g, At, b = ca.MX.sym("H", ns, ns), ca.MX.sym("g", ns), ca.MX.sym("At", ns, rows), ca.MX.sym("b", 1, rows)
    present, free = ca.MX.sym("present", 1, rows), ca.MX.sym("free", ns)
    lower, upper, weight = ca.MX.sym("lower", ns), ca.MX.sym("upper", ns), ca.MX.sym("weight")
    Q, c, x0, scale, box, box_h = _scaled(ns)(H, g, lower, upper, weight, free)
    G, h = _normalised(ns).map("normalise", "serial", rows, [3], [])(At, b, present, scale)
    padding = -rows % BLOCK
    G = ca.horzcat(G, ca.DM.zeros(n, padding))
    mask = ca.vertcat(present.T, ca.DM.zeros(padding), box)
    h = ca.vertcat(h.T, ca.DM.ones(padding), box_h)
    gap = h - mask * _rows(G, x0)
    # In units of the largest violation the start is of order one, whatever the program's scale.
    unit = ca.fmax(-ca.mmin(gap), 1 / HUGE)
    c, x0, h = c / unit, x0 / unit, ca.if_else(mask, h / unit, 1)
    q0 = ca.if_else(mask, ca.fmax(gap / unit, 1), 1)
    lam0 = mask * ca.fmin(weight / unit, LARGEST_START)
    fixed = [Q, c, G, h, mask]
    residuals = _residuals(n, G.shape[1])
    state = Layout(x=n, q=q0.numel(), lam=q0.numel(), dual=n, primal=q0.numel(), error=1, going=1, iterations=1)
    value = ca.vertcat(x0, q0, lam0, *residuals(x0, q0, lam0, *fixed), 1, 0)
    names = [ca.MX.sym(f"f{k}", *part.shape) for k, part in enumerate(fixed)]
    now = ca.MX.sym("now", state.total)
    stay = ca.Function("stay", [now, *names], [now])
    step = ca.Function.if_else("maybe_step", _step(n, G.shape[1], state, residuals), stay)

    def chain(value: Any, count: int, fixed: list[Any]) -> Any:
        for _ in range(count):
            value = step(state.unpack(value).going, value, *fixed)
        return value

    tail = ca.Function("tail", [now, *names], [chain(now, MOST_ITERATIONS - FIRST_ITERATIONS, names)])
    value = chain(value, FIRST_ITERATIONS, fixed)
    value = ca.Function.if_else("maybe_tail", tail, stay)(state.unpack(value).going, value, *fixed)
    end = state.unpack(value)
    s = scale * end.x[:ns] * unit
    return ca.Function(
        "interior",
        [H, g, At, b, present, lower, upper, weight, free],
        [s, (ca.sumsqr(s) < HUGE) * (end.error < ACCEPTED), end.iterations],
    )


def _scaled(ns: int) -> ca.Function:
    """(H, g, lower, upper, w, free) -> Q (unit diagonal), c, x0, scale, and mask and h of the box rows (2n); x = (s / scale, t)."""
    H, g, free = ca.SX.sym("H", ns, ns), ca.SX.sym("g", ns), ca.SX.sym("free", ns)
    lower, upper, weight = ca.SX.sym("lower", ns), ca.SX.sym("upper", ns), ca.SX.sym("weight")
    scale = 1 / ca.sqrt(ca.diag(H))
    Q = ca.diagcat(H * ca.mtimes(scale, scale.T), 1)
    x0 = ca.vertcat(free / scale, 0)
    has = ca.vertcat(upper < HUGE, 0, lower > -HUGE, 1)  # t has no upper bound
    ends = ca.vertcat(upper / scale, 0, -lower / scale, 0)
    return ca.Function(
        "scaled",
        [H, g, lower, upper, weight, free],
        [ca.densify(Q), ca.vertcat(g * scale, weight), x0, scale, has, ca.if_else(has, ends, 1)],
    )


def _normalised(ns: int) -> ca.Function:
    """(a, b, present, scale) -> the row (a, -1) in x (n) and its right side, divided by the row's norm; 0 and 1 for a row that is off."""
    a, b, present, scale = ca.SX.sym("a", ns), ca.SX.sym("b"), ca.SX.sym("present"), ca.SX.sym("scale", ns)
    row = ca.vertcat(a * scale, -1)
    norm = ca.norm_2(row)
    return ca.Function(
        "normalised",
        [a, b, present, scale],
        [ca.if_else(present, row / norm, 0), ca.if_else(present, b / norm, 1)],
    )


def _rows(G: Any, x: Any) -> Any:
    """G x of all rows: those of A, then the box."""
    return ca.vertcat(ca.mtimes(x.T, G).T, x, -x)


def _transposed(G: Any, v: Any) -> Any:
    """G' v."""
    n, rows = G.shape
    return ca.mtimes(G, v[:rows]) + v[rows : rows + n] - v[rows + n :]


def _residuals(n: int, rows: int) -> ca.Function:
    """(x, q, lam, Q, c, G', h, mask) -> (Q x + c + G'lam, G x + q - h, error: the largest of their relative sizes and GAP sqrt(mu))."""
    x, Q, c, G = ca.MX.sym("x", n), ca.MX.sym("Q", n, n), ca.MX.sym("c", n), ca.MX.sym("G", n, rows)
    q, lam, h, mask = (ca.MX.sym(name, rows + 2 * n) for name in ("q", "lam", "h", "mask"))
    Qx, forces, reach = ca.mtimes(Q, x), _transposed(G, lam), mask * _rows(G, x)
    dual, primal = Qx + c + forces, reach + q - h
    errors = [
        ca.norm_inf(dual / (1 + ca.fabs(Qx) + ca.fabs(c) + ca.fabs(forces))),
        ca.norm_inf(primal / (1 + ca.fabs(reach) + ca.fabs(h))),
        GAP * ca.sqrt(ca.dot(q, lam) / ca.sum1(mask)),
    ]
    return ca.Function("residuals", [x, q, lam, Q, c, G, h, mask], [dual, primal, ca.mmax(ca.vertcat(*errors))])


def _step(n: int, rows: int, state: Layout, residuals: ca.Function) -> ca.Function:
    """(state, Q, c, G', h, mask) -> state: predictor and corrector; the point stays where rounding lets none be better."""
    now, Q, c = ca.MX.sym("now", state.total), ca.MX.sym("Q", n, n), ca.MX.sym("c", n)
    G, h, mask = ca.MX.sym("G", n, rows), ca.MX.sym("h", rows + 2 * n), ca.MX.sym("mask", rows + 2 * n)
    point = state.unpack(now)
    x, q, lam = point.x, point.q, point.lam
    mu = ca.dot(q, lam) / ca.sum1(mask)
    D = lam / q
    normal = Q + _normal_matrix(n, rows)(G, D[:rows]) + ca.diag(D[rows : rows + n] + D[rows + n :])

    def direction(centring: Any) -> tuple[Any, Any, Any, Any]:
        """(dx, dq, dlam, 1 / the longest step that keeps q and lam positive); centring = -r_c / q."""
        dx = _solve(n)(normal, -point.dual - _transposed(G, centring + D * point.primal))
        dq = -point.primal - mask * _rows(G, dx)
        dlam = centring - D * dq
        return dx, dq, dlam, ca.mmax(ca.vertcat(-dq / q, ca.if_else(mask, -dlam / lam, 0), 1))

    _, dq, dlam, shortest = direction(-lam)
    mu_affine = ca.dot(q + dq / shortest, lam + dlam / shortest) / ca.sum1(mask)
    sigma = (mu_affine / mu) ** 3
    dx, dq, dlam, shortest = direction(mask * (sigma * mu - dq * dlam) / q - lam)
    # Nearer to the bounds as mu vanishes, so that the end converges faster than linearly.
    length = ca.fmin(1, ca.fmax(STEP_FRACTION, 1 - mu) / shortest)
    moved = [x + length * dx, q + length * dq, lam + length * dlam]
    dual, primal, error = residuals(*moved, Q, c, G, h, mask)
    better = ca.logic_or(error < point.error, point.error > ACCEPTED) * (ca.sumsqr(ca.vertcat(*moved)) < HUGE)
    after = ca.vertcat(*moved, dual, primal, error)
    going = better * (error > TOLERANCE)
    result = ca.vertcat(ca.if_else(better, after, now[: after.numel()]), going, point.iterations + 1)
    return ca.Function("step", [now, Q, c, G, h, mask], [result])


def _solve(n: int) -> ca.Function:
    A, b = ca.SX.sym("A", n, n), ca.SX.sym("b", n)
    return ca.Function("solve_normal", [A, b], [linear.ldl_solve(A, b)[0]])


def _normal_matrix(n: int, rows: int) -> ca.Function:
    """(G', d) -> G' diag(d) G, blocks of rows added to the upper triangle in a loop."""
    entries, G, d = ca.SX.sym("entries", n * (n + 1) // 2), ca.SX.sym("G", n, BLOCK), ca.SX.sym("d", BLOCK)
    pairs = [(i, j) for j in range(n) for i in range(j + 1)]
    weighted = ca.mtimes(G, ca.diag(d))
    sums = [entries[k] + ca.dot(weighted[i, :], G[j, :]) for k, (i, j) in enumerate(pairs)]
    add = ca.Function("add_block", [entries, G, ca.reshape(d, 1, BLOCK)], [ca.vertcat(*sums)])
    G_all, d_all = ca.MX.sym("G", n, rows), ca.MX.sym("d", rows)
    total = add.fold(rows // BLOCK)(ca.DM.zeros(len(pairs)), G_all, d_all.T)
    order = {pair: k for k, pair in enumerate(pairs)}
    full = [total[order[min(i, j), max(i, j)]] for j in range(n) for i in range(n)]
    return ca.Function("normal_matrix", [G_all, d_all], [ca.reshape(ca.vertcat(*full), n, n)])
