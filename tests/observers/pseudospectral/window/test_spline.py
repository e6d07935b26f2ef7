"""The spline matrix against scipy's not-a-knot cubic spline."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from observers.pseudospectral.window.spline import spline_matrix


@pytest.mark.parametrize("samples", [3, 4, 8, 50])
def test_the_spline_is_scipys_not_a_knot_cubic(samples):
    at = np.linspace(0, samples, 4 * samples + 3)
    values = np.random.default_rng(samples).normal(size=samples + 1)
    expected = CubicSpline(np.arange(samples + 1), values, bc_type="not-a-knot")(at)
    np.testing.assert_allclose(spline_matrix(samples, at) @ values, expected, rtol=0, atol=2e-14)
