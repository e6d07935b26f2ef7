"""Estimates held within bounds: against the constrained least-squares problem, by scipy."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import lsq_linear

from observers.bounds import conditioned, inside, projected
from observers.model import Variable

VARIABLES = [Variable("a", min=-1.0, max=2.0), Variable("b"), Variable("c", max=0.5)]
M = np.array([[0.9, 0.2, -0.4], [0.3, 1.1, 0.5], [-0.6, 0.4, 0.8]])
P = M @ M.T


def nearest(x: np.ndarray) -> np.ndarray:
    """Of the points within the bounds the nearest one in the metric of P."""
    root = np.linalg.inv(np.linalg.cholesky(P))
    low, high = ([getattr(v, bound) for v in VARIABLES] for bound in ("min", "max"))
    return lsq_linear(root, root @ x, (low, high), tol=1e-14).x


@pytest.mark.parametrize("x", [[3.0, 0.4, -2.0], [-2.5, 0.4, -2.0], [0.3, -0.7, 1.5], [0.3, 9.0, 0.2]])
def test_where_one_bound_is_broken_what_is_correlated_moves_with_it(x: list[float]) -> None:
    found = conditioned(VARIABLES, ca.DM(x), ca.DM(P)).full().ravel()
    np.testing.assert_allclose(found, nearest(np.array(x)), rtol=0, atol=1e-13)


def test_where_several_are_broken_all_hold() -> None:
    for x in np.random.default_rng(1).normal(scale=4, size=(50, 3)):
        found = conditioned(VARIABLES, ca.DM(x), ca.DM(P)).full().ravel()
        assert -1 <= found[0] <= 2 and found[2] <= 0.5


def test_an_estimate_without_bounds_and_one_within_them_stay() -> None:
    free, x = [Variable(name) for name in "abc"], ca.DM([3.0, 4.0, 5.0])
    assert conditioned(free, x, ca.DM(P)) is x and projected(free, x) is x and inside(free, x) is x
    within = ca.DM([1.9, 30.0, 0.4])
    for found in (conditioned(VARIABLES, within, ca.DM(P)), projected(VARIABLES, within)):
        np.testing.assert_array_equal(found, within)


def test_a_row_is_cut_to_its_own_bounds() -> None:
    x = np.array([[3.0, -3.0, 0.0], [9.0, -9.0, 0.0], [0.6, -9.0, 0.4]])
    np.testing.assert_array_equal(projected(VARIABLES, ca.DM(x)), [[2, -1, 0], [9, -9, 0], [0.5, -9, 0.4]])
    assert math.isnan(float(projected(VARIABLES, ca.DM([math.nan, 0, 0]))[0]))


def test_a_derivative_is_taken_a_thousandth_of_a_nominal_value_within_the_bounds() -> None:
    wide = [Variable("a", min=0.0, max=10.0, nominal=5.0, start=1.0), Variable("b", max=0.0), Variable("c")]
    found = [inside(wide, ca.DM([a, b, 7.0])).full().ravel() for a, b in ((0.0, 0.0), (10.0, -1.0), (0.006, -5e-4))]
    np.testing.assert_allclose(found, [[0.005, -1e-3, 7], [9.995, -1, 7], [0.006, -1e-3, 7]], rtol=1e-14)
    narrow = [Variable("a", min=1.0, max=1.0004, start=1.0)]  # its middle, where there is no room
    for x in (0.0, 1.0, 1.0002, 2.0):
        assert float(inside(narrow, ca.DM([x]))) == pytest.approx(1.0002, rel=1e-14)
