"""What innovations say of the noises that an observer believes in: their likelihood, their size, and whether they are white."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

LAGS = 20  # of the test of whiteness, at most, and a fifth of the samples at most
BAND = 0.95  # of the mean of the normalised innovations squared


@dataclass(frozen=True)
class Innovations:
    """The innovations of some samples in a row.

    Attributes:
        nu: (n, m), NaN where there was no sample.
        S: (n, m, m) their covariances; None where the observer has none.
    """

    nu: np.ndarray
    S: np.ndarray | None

    def part(self, rows: slice) -> Innovations:
        return Innovations(self.nu[rows], None if self.S is None else self.S[rows])

    def whitened(self) -> tuple[np.ndarray, np.ndarray]:
        """L^-1 nu and the logarithms of the diagonal of L, S = L L', both (n, m); NaN where there was no sample.

        An output without a sample has no part in S: its row and column are those of one that is independent of the others.

        Raises:
            numpy.linalg.LinAlgError: a covariance is not positive definite.
        """
        assert self.S is not None
        there = np.isfinite(self.nu)
        S = np.where(there[:, :, None] & there[:, None, :], self.S, np.eye(self.nu.shape[1]))
        L = np.linalg.cholesky(S)
        e = np.linalg.solve(L, np.where(there, self.nu, 0.0)[:, :, None])[:, :, 0]
        logs = np.log(np.diagonal(L, axis1=1, axis2=2))
        return np.where(there, e, np.nan), np.where(there, logs, np.nan)

    def series(self) -> np.ndarray:
        """What is white if the observer is right, (n, m): `whitened`, or the innovations as they are where nobody says their size."""
        return self.nu if self.S is None else self.whitened()[0]


def log_likelihood(innovations: Innovations) -> float:
    """The logarithm of the probability density of the innovations; -inf where a covariance is none."""
    there = np.isfinite(innovations.nu)
    try:
        e, logs = innovations.whitened()
    except np.linalg.LinAlgError:
        return -math.inf
    found = float(-0.5 * np.sum(e[there] ** 2) - np.sum(logs[there]) - 0.5 * there.sum() * math.log(2 * math.pi))
    return found if math.isfinite(found) else -math.inf


def concentrated(errors: np.ndarray) -> float:
    """The log-likelihood of errors (n, m) whose variance nobody knows, an output each, up to a constant: -n / 2 log of the mean square."""
    total = 0.0
    for column in errors.T:
        there = column[np.isfinite(column)]
        mean = float(np.mean(there**2)) if len(there) else 0.0
        if not 0 < mean < math.inf:
            return -math.inf
        total -= len(there) / 2 * math.log(mean)
    return total


def joined(parts: Sequence[Innovations]) -> Innovations:
    """Innovations of several records, so far apart that no correlation reaches from one into the next."""
    if len(parts) == 1:
        return parts[0]
    m = parts[0].nu.shape[1]
    gap, unit = np.full((LAGS, m), np.nan), np.broadcast_to(np.eye(m), (LAGS, m, m))
    nu = np.concatenate([piece for part in parts for piece in (part.nu, gap)])
    if any(part.S is None for part in parts):
        return Innovations(nu, None)
    return Innovations(nu, np.concatenate([piece for part in parts for piece in (part.S, unit)]))


@dataclass(frozen=True)
class Consistency:
    """Are the innovations what the observer believes them to be?

    Attributes:
        nis: mean of nu' S^-1 nu for each output, which should be 1; NaN without S.
        band: where it lies with the probability BAND if it is right.
        whiteness: probability of correlations as large as these between samples if there are none; the least of all outputs' times their
            number.
    """

    nis: float
    band: tuple[float, float]
    whiteness: float


def consistency(innovations: Innovations) -> Consistency:
    """What the tests say."""
    nis, band, series = math.nan, (math.nan, math.nan), innovations.series()
    if innovations.S is not None:
        squares = series[np.isfinite(series)] ** 2
        count = max(len(squares), 1)
        low, high = (float(chi2.ppf(q, count)) / count for q in ((1 - BAND) / 2, (1 + BAND) / 2))
        nis, band = float(squares.sum()) / count, (low, high)
    outputs = series.shape[1]
    return Consistency(nis, band, min(1.0, outputs * min(whiteness(series[:, i]) for i in range(outputs))))


def whiteness(series: np.ndarray) -> float:
    """The p-value of Ljung and Box's test (Biometrika 65, 1978) of a series (n), NaN where a value is missing; 1 where it is too short."""
    r, count = correlations(series), int(np.isfinite(series).sum())
    if not len(r):
        return 1.0
    statistic = count * (count + 2) * float(np.sum(r**2 / (count - np.arange(1, len(r) + 1))))
    return float(chi2.sf(statistic, len(r)))


def correlations(series: np.ndarray) -> np.ndarray:
    """Those of a series (n), NaN where a value is missing, with itself 1, 2, ... samples later: LAGS of them, or a fifth of the samples.

    Empty where it is too short, or constant.
    """
    there = np.isfinite(series)
    lags = min(LAGS, int(there.sum()) // 5)
    if lags < 1:
        return np.empty(0)
    x = np.where(there, series - series[there].mean(), 0.0)
    power = float(x @ x)
    return np.array([x[k:] @ x[:-k] for k in range(1, lags + 1)]) / power if power > 0 else np.empty(0)
