"""The Riccati equation Q' = A Q + Q A' - Q S Q + W over a step, by structure-preserving doubling.

With A, W >= 0, S >= 0 held over h, the flow is Q -> Wd + Phi Q (I + Sd Q)^-1 Phi'. The triple (Phi, Wd, Sd) of a short step comes from the
Taylor series of exp(h M), M = [[A, W], [S, -A']], and is doubled until the step is h (Anderson, "Second-order convergent algorithms for the
steady-state Riccati equation", Int. J. Control 28, 1978). Sums of semidefinite terms only: nothing cancels, so that stiff A, high gain S
and a large Q are harmless, where Runge-Kutta on the equation and exp(h M) as a whole both fail.

What is doubled is F = Phi - I: in Phi of a short step a slow mode beside a stiff one is a few ulps away from 1, and every doubling would
double their rounding (to 2e-11 relative for |A| h = 1e3; with F it stays below 1e-15).
"""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca

from observers.numerics import linear, tiles
from observers.numerics.layout import Layout

ORDER = 9  # of the Taylor series of F
NOISE_TERMS = 12  # of that of Wd without measurements
SHORT = 1 / 8  # norm of the balanced h M up to which they are exact: SHORT^9 / 10! = 2e-15, (2 SHORT)^12 / 13! = 1e-17
FIRST_DOUBLINGS = 2  # what comes later is jumped over as a whole
MOST_DOUBLINGS = 40
UNROLLED = 4  # states up to which the products are unrolled into scalars
TINY = 1e-300


@cache
def propagator(n: int, measured: bool = False) -> ca.Function:
    """propagator(A, W, h) -> (Phi, Wd), or with `measured` propagator(A, W, S, h) -> (Phi, Wd, Sd); all n x n.

    Without measurements (S = 0) Phi = exp(A h) and Wd = integral of exp(A s) W exp(A' s) over [0, h]. At most MOST_DOUBLINGS
    doublings: up to h |M| = 1e11.
    """
    A, W, h, k = (ca.MX.sym(*shape) for shape in (("A", n, n), ("W", n, n), ("h",), ("k",)))
    S = ca.MX.sym("S", n, n) if measured else ca.MX(n, n)
    # A scalar change of units of Q trades W against S; the smallest norm that this leaves is what the series sees.
    size = h * ca.sqrt(ca.sumsqr(A)) + (h * ca.sqrt(ca.sqrt(ca.sumsqr(W) * ca.sumsqr(S))) if measured else 0)
    wanted = ca.ceil(ca.log(ca.fmax(size / SHORT, TINY)) / ca.log(2.0))
    doublings = ca.fmin(ca.fmax(wanted, 0), MOST_DOUBLINGS)
    state = Layout(**{name: n * n for name in (("F", "Wd", "Sd") if measured else ("F", "Wd"))})
    arguments = [A, W, S, h] if measured else [A, W, h]
    short = _small(ca.Function("short", [*arguments, k], [_pack(_short_step(A, W, S, h / 2**k, measured))]), n)
    first = short(*arguments, doublings)
    F, *rest = (ca.reshape(part, n, n) for part in vars(state.unpack(_doubled(n, measured)(first, doublings))).values())
    return ca.Function("propagator", arguments, [ca.MX.eye(n) + F, *rest])


@cache
def riccati_step(n: int) -> ca.Function:
    """riccati_step(Q, A, W, S, h) -> Q(h), n x n, symmetric positive semidefinite where Q, W and S are."""
    Q, A, W, S = (ca.MX.sym(name, n, n) for name in "QAWS")
    h = ca.MX.sym("h")
    Phi, Wd, Sd = propagator(n, measured=True)(A, W, S, h)
    return ca.Function("riccati_step", [Q, A, W, S, h], [symmetric(Wd + Phi @ Q @ _inverse(n)(Sd @ Q) @ Phi.T)])


def symmetric(X: Any) -> Any:
    """(X + X') / 2."""
    return (X + X.T) / 2


def _short_step(A: Any, W: Any, S: Any, h: Any, measured: bool) -> list[Any]:
    """(F, Wd, Sd), F = Phi - I, of a step so short that the Taylor series of E = exp(h M) is exact."""
    n = A.shape[0]
    one = ca.MX.eye(n)
    if not measured:
        # Wd = integral of exp(A s) W exp(A' s): its terms are W's images under X -> A X + X A'.
        E11, F11, Wd = one, ca.MX(n, n), h * W
        term = Wd
        for j in range(ORDER, 0, -1):
            F11 = h / j * A @ E11
            E11 = one + F11
        for j in range(2, NOISE_TERMS + 1):
            moved = A @ term
            term = h / j * (moved + moved.T)
            Wd = Wd + term
        return [F11, Wd]
    E11, E12, E21, E22 = one, ca.MX(n, n), ca.MX(n, n), one
    for j in range(ORDER, 0, -1):
        F11, E12, E21, F22 = (
            h / j * (A @ E11 + W @ E21),
            h / j * (A @ E12 + W @ E22),
            h / j * (S @ E11 - A.T @ E21),
            h / j * (S @ E12 - A.T @ E22),
        )
        E11, E22 = one + F11, one + F22
    both, _ = tiles.solve(E22.T, ca.horzcat(-F22.T, E12.T))
    return [both[:, :n], symmetric(both[:, n:].T), symmetric(tiles.solve(E22, E21)[0])]


@cache
def _doubled(n: int, measured: bool) -> ca.Function:
    """doubled(triple, k): `triple` (F, Wd, Sd), as one column, of a step 2^k as long."""
    names = ("F", "Wd", "Sd") if measured else ("F", "Wd")
    state = Layout(**{name: n * n for name in names})
    column, k = ca.MX.sym("column", state.total), ca.MX.sym("k")
    F, Wd, *rest = (ca.reshape(part, n, n) for part in vars(state.unpack(column)).values())
    Phi = ca.MX.eye(n) + F
    if measured:
        Sd = rest[0]
        X = Wd @ Sd
        Z = _inverse(n)(X)
        half = Phi @ Z
        twice = [
            2 * F + F @ F - half @ X @ Phi,
            symmetric(Wd + half @ Wd @ Phi.T),
            symmetric(Sd + Phi.T @ Sd @ Z @ Phi),
        ]
    else:
        twice = [2 * F + F @ F, symmetric(Wd + Phi @ Wd @ Phi.T)]
    double = _small(ca.Function("double", [column], [_pack(twice)]), n)
    one = ca.Function.if_else("maybe_double", double, ca.Function("keep", [column], [column]))

    def chain(value: Any, start: int, end: int) -> Any:
        for i in range(start, end):
            value = one(k > i, value)
        return value

    tail = ca.Function("tail", [column, k], [chain(column, FIRST_DOUBLINGS, MOST_DOUBLINGS)])
    no_tail = ca.Function("no_tail", [column, k], [column])
    begun = chain(column, 0, FIRST_DOUBLINGS)
    rest_of_it = ca.Function.if_else("maybe_tail", tail, no_tail)(k > FIRST_DOUBLINGS, begun, k)
    return ca.Function("doubled", [column, k], [rest_of_it])


@cache
def _inverse(n: int) -> ca.Function:
    """inverse(X) -> (I + X)^-1 for a product X of two semidefinite matrices: no eigenvalue below 1, but pivots can vanish."""
    X = ca.SX.sym("X", n, n)
    return ca.Function("inverse", [X], [linear.qr_solve(ca.SX.eye(n) + X, ca.SX.eye(n))])


def _pack(parts: list[Any]) -> Any:
    return ca.vertcat(*[ca.vec(ca.densify(part)) for part in parts])


def _small(function: ca.Function, n: int) -> ca.Function:
    return function.expand() if n <= UNROLLED else function
