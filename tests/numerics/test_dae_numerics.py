"""Pole placement, Riccati equation, interpolation, backward differentiation and complements against independent sources."""

from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import null_space, solve_continuous_are

from observers.numerics.bdf import coefficients
from observers.numerics.care import care
from observers.numerics.complement import complement, exact_inverse
from observers.numerics.interpolation import interpolated, lagrange_slopes, lagrange_weights
from observers.numerics.linear import inverse
from observers.numerics.placement import ackermann, observability_matrix, polynomial_at


def constant(array):
    return ca.SX(ca.DM(array))


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_ackermann_places_the_eigenvalues(n):
    rng = np.random.default_rng(n)
    A, c, poles = rng.normal(size=(n, n)), rng.normal(size=(1, n)), -1.0 - np.arange(n)
    J, determinant = ackermann(constant(A), constant(c), constant(poles), ca.SX(1e-9))
    found = np.linalg.eigvals(A - ca.DM(J).full() @ c)
    np.testing.assert_allclose(np.poly(found), np.poly(poles), rtol=1e-6)
    O = ca.DM(observability_matrix(constant(c), constant(A))).full()
    np.testing.assert_allclose(float(ca.DM(determinant)), np.linalg.det(O), rtol=1e-9)


def test_ackermanns_division_is_guarded_where_the_pair_is_not_observable():
    J, determinant = ackermann(constant(np.eye(2)), constant([[1.0, 0.0]]), constant([-1.0, -2.0]), ca.SX(0.1))
    assert float(ca.DM(determinant)) == 0 and np.all(ca.DM(J).full() == 0)


def test_a_matrix_satisfies_its_characteristic_polynomial():
    A = np.diag([1.0, 2.0, 3.0]) + np.eye(3, k=1)
    assert np.abs(ca.DM(polynomial_at(constant(A), constant([1.0, 2.0, 3.0]))).full()).max() < 1e-14


@pytest.mark.parametrize("n", [1, 2, 3, 4])
@pytest.mark.parametrize("scale", [0.1, 1.0, 30.0])
def test_the_riccati_equation_has_scipys_solution(n, scale):
    rng = np.random.default_rng(n)
    A, C = scale * rng.normal(size=(n, n)), rng.normal(size=(max(1, n - 1), n))
    shift = 2 * (np.linalg.norm(A) + np.linalg.norm(C))
    found = ca.DM(care(constant(A), constant(C.T @ C), ca.SX.eye(n), ca.SX(shift))).full()
    expected = solve_continuous_are(A.T, C.T, np.eye(n), np.eye(len(C)))
    assert np.abs(found - expected).max() <= 1e-7 * np.abs(expected).max()


def test_the_inverse_is_numpys():
    A = np.eye(4) + 0.3 * np.random.default_rng(0).normal(size=(4, 4))
    np.testing.assert_allclose(ca.DM(inverse(constant(A))).full(), np.linalg.inv(A), rtol=1e-10)


@pytest.mark.parametrize("degree", [1, 2, 3, 5])
def test_lagranges_weights_and_slopes_are_exact_for_polynomials(degree):
    polynomial = np.polynomial.Polynomial(np.arange(1.0, degree + 2))
    samples = [polynomial(-i) for i in range(degree + 1)]
    for at in (Fraction(-1), Fraction(-1, 2), Fraction(0)):
        value = sum(float(w) * y for w, y in zip(lagrange_weights(degree, at), samples, strict=True))
        slope = sum(float(w) * y for w, y in zip(lagrange_slopes(degree, at), samples, strict=True))
        assert value == pytest.approx(polynomial(float(at)), rel=1e-12)
        assert slope == pytest.approx(polynomial.deriv()(float(at)), rel=1e-12, abs=1e-12)


def test_the_first_samples_are_interpolated_by_lower_degrees():
    samples = [ca.DM(v) for v in (9.0, 4.0, 1.0, 0.0)]  # (i + 3)^2
    for k, expected in ((1, 6.5), (2, 6.25), (3, 6.25)):
        assert float(interpolated(samples, ca.DM(k), Fraction(-1, 2))) == expected


def test_backward_differentiation_has_the_published_coefficients():
    assert coefficients(1) == [1, -1]
    assert coefficients(2) == [3 / 2, -2, 1 / 2]
    assert coefficients(5) == [137 / 60, -5, 5, -10 / 3, 5 / 4, -1 / 5]


@pytest.mark.parametrize(("n", "q"), [(2, 0), (3, 1), (4, 2), (5, 3)])
def test_a_complement_spans_the_left_null_space(n, q):
    E = np.random.default_rng(n).normal(size=(n, q))
    found = complement(E)
    assert found is not None
    np.testing.assert_allclose(found.T @ E, 0, atol=1e-14)
    np.testing.assert_allclose(found.T @ found.R, np.eye(n - q), atol=1e-14)
    np.testing.assert_allclose(found.L @ E, np.eye(q), atol=1e-13)
    if q:
        basis = null_space(E.T)
        np.testing.assert_allclose(basis @ basis.T @ found.T.T, found.T.T, atol=1e-12)


def test_a_matrix_without_full_column_rank_has_no_complement():
    assert complement(np.array([[1.0, 2.0], [2.0, 4.0], [3.0, 6.0]])) is None
    assert exact_inverse(np.array([[1.0, 2.0], [2.0, 4.0]])) is None
    np.testing.assert_array_equal(exact_inverse(np.array([[0.0, 2.0], [4.0, 0.0]])), [[0, 0.25], [0.5, 0]])
