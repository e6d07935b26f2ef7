"""Recursive least squares for the state at an interval's start, in information form, and by how much an interval contracts the error."""

from __future__ import annotations

from functools import cache

import casadi as ca

from observers.least_squares.spectral import norm_bound
from observers.numerics import linear
from observers.numerics.riccati import UNROLLED, symmetric


@cache
def information_update(n: int, ny: int) -> ca.Function:
    """information_update(x, Phi, Y, C, r, g) -> (x, Y, K) after a sample with the innovation r = y - C x and the weight g.

    x (n), now; Phi (n x n), the transition matrix from the interval's start to now; Y (n x n), the information on the state at that start;
    C (ny x n), r (ny). With w = Phi' C': Y + g w w', and x + Phi K r with K = g Y^-1 w (n x ny), the gain at that start, of the new Y.
    """
    x, Phi, Y, C, r, g = (
        ca.MX.sym(*shape) for shape in (("x", n), ("Phi", n, n), ("Y", n, n), ("C", ny, n), ("r", ny), ("g",))
    )
    w = Phi.T @ C.T
    Y_after = symmetric(Y + g * w @ w.T)
    solved = linear.solver(n, 1 + ny)(Y_after, ca.horzcat(w @ r, w))
    x_after = x + g * Phi @ solved[:, 0]
    function = ca.Function("information_update", [x, Phi, Y, C, r, g], [x_after, Y_after, g * solved[:, 1:]])
    return function.expand() if n <= UNROLLED else function


@cache
def error_covariance(n: int, ny: int) -> ca.Function:
    """error_covariance(S, M, K, noise) -> M S M' + noise K K', symmetric: of an error M e - K v, e of covariance S, v of noise I.

    S, M (n x n), K (n x ny); noise, a scalar.
    """
    S, M, K, noise = (ca.MX.sym(*shape) for shape in (("S", n, n), ("M", n, n), ("K", n, ny), ("noise",)))
    function = ca.Function("error_covariance", [S, M, K, noise], [symmetric(M @ S @ M.T + noise * K @ K.T)])
    return function.expand() if n <= UNROLLED else function


@cache
def contraction(n: int) -> ca.Function:
    """contraction(Phi, Y, p0) -> (|Phi Y^-1| / p0, |Phi| |Y^-1| / p0), upper bounds by `norm_bound`, for Phi and Y at an interval's end.

    e+ = Phi Y^-1 e / p0 over the interval. The second is the product that Chen & Yen's theorem bounds: p0 lmin(Y) = 1 + gamma p0 lmin(W), W
    being the Gramian of the interval's samples.
    """
    Phi, Y, p0 = ca.MX.sym("Phi", n, n), ca.MX.sym("Y", n, n), ca.MX.sym("p0")
    P = symmetric(linear.solver(n, n)(Y, ca.MX.eye(n)))
    bound = norm_bound(n)
    return ca.Function("contraction", [Phi, Y, p0], [ca.vertcat(bound(Phi @ P), bound(Phi) * bound(P)) / p0])
