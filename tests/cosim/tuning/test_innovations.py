"""What is computed of innovations, against scipy's distributions and what they must do on noise that is white or is not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2, kstest, multivariate_normal

from cosim.tuning.innovations import Innovations, concentrated, consistency, joined, log_likelihood, whiteness


def drawn(n: int, m: int, seed: int) -> Innovations:
    """Innovations that have the covariances which they are said to have."""
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(n, m, m)) + 2 * np.eye(m)
    S = roots @ roots.transpose(0, 2, 1)
    return Innovations((roots @ rng.normal(size=(n, m, 1)))[:, :, 0], S)


@pytest.mark.parametrize("m", [1, 2, 3])
def test_the_likelihood_is_the_normal_density_of_what_was_measured(m: int) -> None:
    made, rng = drawn(50, m, m), np.random.default_rng(7)
    nu = np.where(rng.random((50, m)) < 0.2, np.nan, made.nu)
    expected = 0.0
    for row, S in zip(nu, made.S, strict=True):  # type: ignore[arg-type]
        there = np.isfinite(row)
        if there.any():
            expected += multivariate_normal.logpdf(row[there], cov=S[np.ix_(there, there)])
    assert log_likelihood(Innovations(nu, made.S)) == pytest.approx(expected, rel=1e-12)


def test_what_is_no_covariance_explains_nothing() -> None:
    nu = np.ones((3, 2))
    for entry in (np.nan, -1.0, np.inf):
        S = np.tile(np.eye(2), (3, 1, 1))
        S[1, 0, 0] = entry
        assert log_likelihood(Innovations(nu, S)) == -math.inf


def test_the_error_ahead_counts_as_the_likelihood_with_the_best_variance() -> None:
    errors = np.random.default_rng(1).normal(0, 3, (40, 1))
    errors[5] = np.nan
    there = errors[np.isfinite(errors)]
    best = multivariate_normal.logpdf(there, cov=np.mean(there**2)).sum() + 39 / 2 * (1 + math.log(2 * math.pi))
    assert concentrated(errors) == pytest.approx(best, rel=1e-12)


def test_innovations_as_large_as_believed_lie_in_the_band_in_95_of_100_runs() -> None:
    found = [consistency(drawn(60, 2, seed)) for seed in range(300)]
    low, high = found[0].band
    assert (low, high) == pytest.approx(tuple(chi2.ppf([0.025, 0.975], 120) / 120), rel=1e-12)
    inside = np.mean([low <= one.nis <= high for one in found])
    assert 0.91 < inside < 0.99  # three standard deviations of 300 draws
    assert np.mean([one.nis for one in found]) == pytest.approx(1, abs=0.03)


def test_the_test_of_whiteness_is_uniform_on_white_noise_and_finds_a_correlation() -> None:
    rng = np.random.default_rng(5)
    series = rng.normal(size=(300, 250))
    series[:, 40:43] = np.nan
    assert kstest([whiteness(one) for one in series], "uniform").pvalue > 1e-3
    coloured = series[:, :-1] + 0.5 * series[:, 1:]
    assert np.median([whiteness(one) for one in coloured]) < 1e-4


def test_ljung_and_boxs_statistic_of_a_few_numbers_by_hand() -> None:
    """x = 1, -1, 2, -2, 0: one lag (a fifth of five), r = -7 / 10, Q = 5 * 7 * 0.49 / 4."""
    assert whiteness(np.array([1.0, -1.0, 2.0, -2.0, 0.0])) == pytest.approx(chi2.sf(35 * 0.49 / 4, 1), rel=1e-12)


def test_records_that_are_joined_know_nothing_of_each_other() -> None:
    rng = np.random.default_rng(2)
    first, second = (np.cumsum(rng.normal(size=(30, 1)), axis=0) for _ in range(2))
    unit = np.ones((30, 1, 1))
    both = joined([Innovations(first, unit), Innovations(second, unit)])
    assert log_likelihood(both) == pytest.approx(
        sum(log_likelihood(Innovations(one, unit)) for one in (first, second)), rel=1e-12
    )
    reordered = joined([Innovations(second, unit), Innovations(first, unit)])
    assert whiteness(both.nu[:, 0]) == pytest.approx(whiteness(reordered.nu[:, 0]), rel=1e-9)
