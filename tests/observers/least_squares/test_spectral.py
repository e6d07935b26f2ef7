"""The bound of a norm that the contraction of the least-squares observer is told by: against numpy."""

import numpy as np
import pytest

from observers.least_squares.spectral import norm_bound


@pytest.mark.parametrize("n", [1, 2, 6, 30])
def test_the_norms_bound_is_above_the_norm_by_a_third_of_a_percent_at_most(n):
    for scale in (1e-60, 1.0, 1e60):
        X = scale * np.random.default_rng(n).normal(size=(n, n))
        norm = np.linalg.norm(X, 2)
        found = float(norm_bound(n)(X))
        assert norm * (1 - 1e-12) <= found <= 1.0034 * norm
    assert float(norm_bound(n)(np.zeros((n, n)))) == 0
