"""Bounds of |Q| from uniform detectability, James & Baras 1987, section 3.

Two sufficient conditions are tried over the cells of the model's region:

- (3.3) with Lambda = -s H' (the paper leaves Lambda to the designer), s >= 0 chosen for the smallest bound; s = 0 where A is negative.
- (3.3) in other coordinates: a constant matrix X > 0 with

      A(xi) X + X A(xi)' - X H(xi)' H(xi) X + N N' <= 0   for all xi                                   (*)

  bounds Q(t) <= c X for every c >= 1 with Q0 <= c X, by comparison of the two Riccati equations (c X satisfies (*) with X). The candidates
  are X(theta), theta > 0, the stationary solution of (2.2) at the region's mean A and H'H with A + theta I / 2 for A: the covariance of the
  Kalman filter that forgets at the rate theta (Anderson & Moore, "Optimal filtering", 1979, section 6.2), whose inverse is, but for N, the
  observability Gramian with that forgetting. This is what the paper means for its Example 5.1 by bounding Q through the Gramian; its
  own way there, Corollary 3.1, needs the Gramian's infimum over all controls, and its constants grow as exp(4 tau |A|). X(theta) grows with
  theta, and so does the slack theta X that (*) has for A(xi) away from the mean: the smallest theta for which (*) holds is taken.

(*) is checked in the coordinates in which X is the identity.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from observers.numerics.exact import in_high_precision, matrix, product, rounded, table
from observers.numerics.riccati import riccati_step
from observers.riccati.interval import Range
from observers.riccati.suprema import MARGIN, downward, largest, point, smallest_gain, supremum, upward

GAINS = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 121)])  # s of Lambda = -s H', times |A| / |H|^2
FORGETTING = np.geomspace(1e-6, 1e3, 19)  # theta, times |A|
BISECTIONS = 6  # between two of them
STEADY = 1e5  # times 1 / |A|: the time in which X(theta) is reached

Pairs = list[tuple[Range, Range]]  # A and H over each cell


def by_injection(pairs: Pairs, A: float, H: float, NN: float) -> tuple[float, float, float]:
    """(s, alpha0, (|N|^2 + |Lambda|^2) / (2 alpha0)) of (3.3) with the Lambda = -s H' for which the last is smallest.

    alpha0 is rounded down, the last up; -inf and inf where A or H has no bound.
    """
    best = (0.0, -math.inf, math.inf)
    if not (math.isfinite(A) and math.isfinite(H)):
        return best
    half = np.array([(a.middle + a.middle.T) / 2 for a, _ in pairs])
    square = np.array([h.middle.T @ h.middle for _, h in pairs])
    spread = np.array([np.linalg.norm((a.radius + a.radius.T) / 2, 2) for a, _ in pairs])
    slack = np.array([2 * np.linalg.norm(h.middle, 2) * np.linalg.norm(h.radius, 2) for _, h in pairs])
    for gain in GAINS:
        s = float(gain) * (A / H**2 if H > 0 else 0.0)
        eigenvalues = np.linalg.eigvalsh(half - s * square)[:, -1] + spread + s * slack
        alpha0 = -upward(float(eigenvalues.max()) + MARGIN * (A + 3 * s * H**2))
        forcing = upward((NN + s**2 * H**2) / (2 * alpha0) * (1 + 1e-14)) if alpha0 > 0 else math.inf
        if forcing < best[2] or (best[2] == math.inf and alpha0 > best[1]):
            best = (s, alpha0, forcing)
    return best


def by_comparison(pairs: Pairs, A: float, N: np.ndarray) -> Callable[[np.ndarray], float]:
    """bound(Q0) of |Q| by X(theta) with the smallest theta that satisfies (*); inf where none within FORGETTING does."""
    if not (math.isfinite(A) and all(np.all(np.isfinite(h.radius)) for _, h in pairs)):
        return lambda Q0: math.inf
    candidate = _candidates(pairs, A, N)
    best, below = None, 0.0
    for theta in FORGETTING * (A or 1.0):
        best = candidate(theta)
        if best is not None:
            break
        below = theta
    if best is None:
        return lambda Q0: math.inf
    for _ in range(BISECTIONS if below else 0):
        middle = math.sqrt(below * theta)
        found = candidate(middle)
        if found is None:
            below = middle
        else:
            theta, best = middle, found
    X, T = best
    unit = -largest(point(-product(T, X, T.T)))  # 1 but for rounding

    def bound(Q0: np.ndarray) -> float:
        factor = max(1.0, largest(point(product(T, Q0, T.T))) / unit)
        return upward(factor * largest(point(X)) * (1 + MARGIN))

    return bound


def by_full_rank(pairs: Pairs, NN: float) -> float:
    """The bound of |Q| from a smaller Q0 where H has full column rank, (3.4), by comparison with a scalar Riccati equation; else inf."""
    rank = downward(min(smallest_gain(h) for _, h in pairs))
    growth = supremum(largest(a) for a, _ in pairs)
    if not (rank > 0 and math.isfinite(growth)):
        return math.inf
    return upward((growth + math.sqrt(growth**2 + rank**2 * NN)) / rank**2 * (1 + 1e-14))


def _candidates(pairs: Pairs, A: float, N: np.ndarray) -> Callable[[float], tuple[np.ndarray, np.ndarray] | None]:
    """candidate(theta) -> (X(theta), T with T X T' = I but for rounding), or None where (*) does not hold.

    X has six digits: what a machine's last bits change must not matter.
    """
    n, W = len(N), N @ N.T
    mean = np.mean([a.middle for a, _ in pairs], axis=0)
    S = np.mean([h.middle.T @ h.middle for _, h in pairs], axis=0)
    step, time, waiting = riccati_step(n), STEADY / (A or 1.0), list(pairs)

    def candidate(theta: float) -> tuple[np.ndarray, np.ndarray] | None:
        X = step(np.eye(n), mean + theta / 2 * np.eye(n), W, S, time).full()
        # Where (mean A, H) is not detectable X grows without bound.
        if not np.all(np.isfinite(X)):
            return None
        X = np.array([float(f"{x:.6g}") for x in X.ravel()]).reshape(n, n)
        if np.linalg.eigvalsh(X).min() <= MARGIN * np.linalg.norm(X):
            return None
        T = np.linalg.inv(np.linalg.cholesky(X))
        for i, (a, h) in enumerate(waiting):
            if not _excess(a, h, N, X, T) < 0:
                waiting.insert(0, waiting.pop(i))  # what refuses this theta most likely refuses the next one
                return None
        return X, T

    return candidate


@in_high_precision
def _residual(A: np.ndarray, H: np.ndarray, N: np.ndarray, X: np.ndarray, T: np.ndarray) -> np.ndarray:
    """T (A X + X A' - X H'H X + N N') T', without rounding errors: it is a small difference of large terms."""
    A_, H_, N_, X_, T_ = (matrix(M) for M in (A, H, N, X, T))
    HX = H_ * X_
    M = A_ * X_ + X_ * A_.transpose() - HX.transpose() * HX + N_ * N_.transpose()
    return rounded(table(T_ * M * T_.transpose()))


def _excess(A: Range, H: Range, N: np.ndarray, X: np.ndarray, T: np.ndarray) -> float:
    """Upper bound over a cell of the largest eigenvalue of the left side of (*), congruent by T."""
    XT = product(X, T.T)
    spread = 2 * np.linalg.norm(abs(T) @ A.radius @ abs(XT), 2)
    spread += 2 * np.linalg.norm(product(H.middle, X, T.T), 2) * np.linalg.norm(H.radius @ abs(XT), 2)
    return largest(point(_residual(A.middle, H.middle, N, X, T))) + float(spread) * (1 + MARGIN)
