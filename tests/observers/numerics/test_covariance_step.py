"""A covariance over a step, by series or by doubling: against the exponential of Van Loan's matrix in 40 digits."""

from __future__ import annotations

import casadi as ca
import mpmath as mp
import numpy as np
import pytest

from observers.numerics.lyapunov import TERMS, covariance_step, longest


def moved(Q: np.ndarray, A: np.ndarray, W: np.ndarray, h: float) -> np.ndarray:
    n = len(A)
    with mp.workdps(40):
        E = mp.expm(mp.matrix(np.block([[-A, W], [np.zeros((n, n)), A.T]]).tolist()) * mp.mpf(h), method="taylor")
        Phi = E[n:, n:].T
        result = Phi * mp.matrix(Q.tolist()) * Phi.T + Phi * E[:n, n:]
        return np.array(result.tolist(), dtype=float)


@pytest.mark.parametrize("n", [1, 3, 6, 9])
@pytest.mark.parametrize("density", [0.3, 1.0], ids=["sparse", "dense"])
def test_it_is_exact_to_rounding_whatever_the_number_of_terms(n: int, density: float) -> None:
    rng = np.random.default_rng(n)
    sizes = [1e-4, *(longest(terms) * part for terms in TERMS for part in (0.99, 1.01)), 3.0, 30.0]
    A = np.where(rng.random((n, n)) < density, rng.normal(size=(n, n)), 0) - np.eye(n)
    norm = np.sqrt(np.abs(A).sum(axis=0).max() * np.abs(A).sum(axis=1).max())
    Q, W = (M @ M.T for M in rng.normal(size=(2, n, n)))
    given = ca.sparsify(ca.DM(A))
    step = covariance_step(given.sparsity())
    for size in sizes:
        h = size / (2 * norm)
        found, expected = step(Q, given, W, h).full(), moved(Q, A, W, h)
        assert np.abs(found - expected).max() < 2e-15 * max(1.0, size) * np.abs(expected).max()
        assert np.array_equal(found, found.T)


def test_entries_that_are_no_numbers_are_none_after_it() -> None:
    step = covariance_step(ca.Sparsity.dense(2, 2))
    assert not np.isfinite(step(np.eye(2), np.full((2, 2), np.nan), np.eye(2), 0.1).full()).any()
