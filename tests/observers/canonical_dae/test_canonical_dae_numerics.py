"""Pole placement, Riccati equation, interpolation, backward differentiation and complements against independent sources."""

import itertools
from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import null_space, solve_continuous_are

from observers.canonical_dae.bdf import MOST, coefficients
from observers.canonical_dae.care import care
from observers.canonical_dae.complement import complement, exact_inverse
from observers.canonical_dae.half_explicit import half_explicit
from observers.canonical_dae.interpolation import interpolated, lagrange_slopes, lagrange_weights
from observers.canonical_dae.placement import ackermann, observability_matrix
from observers.canonical_dae.tuning import poles as placed
from observers.canonical_dae.tuning import weight
from observers.numerics.linear import inverse
from observers.numerics.rank import unobservable


def constant(array):
    return ca.SX(ca.DM(array))


def polynomial_at(A, wanted):
    """omega(A) for the poles `wanted` at the start values of their parameters."""
    made = placed(wanted, len(A))
    values = [port.start for port in made.ports]
    return ca.Function("omega", [made.values], [made.polynomial_at(constant(A))])(values)


@pytest.mark.parametrize(
    "wanted",
    [
        [-1],
        [-1, -2],
        [-1 + 2j, -1 - 2j],
        [-3 - 1j, -2, -3 + 1j],
        [-1, -2, -3, -4],
        [-1 + 1j, -2 + 3j, -2 - 3j, -4, -1 - 1j],
    ],
)
def test_ackermann_places_real_eigenvalues_and_conjugate_pairs(wanted):
    n = len(wanted)
    rng = np.random.default_rng(n)
    A, c = rng.normal(size=(n, n)), rng.normal(size=(1, n))
    J, determinant = ackermann(constant(A), constant(c), constant(polynomial_at(A, wanted)), ca.SX(1e-9))
    found = np.linalg.eigvals(A - ca.DM(J).full() @ c)
    np.testing.assert_allclose(np.poly(found), np.poly(wanted).real, rtol=1e-13)
    O = ca.DM(observability_matrix(constant(c), constant(A))).full()
    np.testing.assert_allclose(float(ca.DM(determinant)), np.linalg.det(O), rtol=1e-13)


def test_ackermanns_division_is_guarded_where_the_pair_is_not_observable():
    J, determinant = ackermann(constant(np.eye(2)), constant([[1.0, 0.0]]), constant(np.ones((2, 2))), ca.SX(0.1))
    assert float(ca.DM(determinant)) == 0 and np.all(ca.DM(J).full() == 0)


def test_a_matrix_satisfies_its_characteristic_polynomial():
    A = np.array([[-1.0, 2.0, 0.0], [-2.0, -1.0, 1.0], [0.0, 0.0, -3.0]])  # -1 +- 2i, -3
    assert np.abs(polynomial_at(A, [-1 + 2j, -1 - 2j, -3]).full()).max() < 1e-14


def test_a_full_weight_is_given_by_its_cholesky_factor_and_positive_definite_wherever_that_is_moved():
    X = np.array([[2.0, -0.5, 0.3], [-0.5, 1.0, 0.2], [0.3, 0.2, 0.5]])
    made = weight(X, 3)
    at = ca.Function("X", [made.values], [made.matrix])
    np.testing.assert_allclose(at([port.start for port in made.ports]).full(), X, rtol=1e-14)
    rng = np.random.default_rng(0)
    for _ in range(20):
        moved = [
            max(0.1, value) if port.min > 0 else value
            for port, value in zip(made.ports, rng.normal(size=6), strict=True)
        ]
        assert np.linalg.eigvalsh(at(moved).full()).min() > 0


def test_what_an_output_never_shows_is_found_whatever_the_scale():
    rng = np.random.default_rng(1)
    for scale in (1e-3, 1.0, 1e3):
        A = scale * np.block(
            [[rng.normal(size=(2, 2)), np.zeros((2, 2))], [rng.normal(size=(2, 2)), np.diag([-1.0, -2.0])]]
        )
        T = np.linalg.qr(rng.normal(size=(4, 4)))[0]
        hidden = unobservable(T @ A @ T.T, np.array([[1.0, 0, 0, 0]]) @ T.T)
        assert len(hidden) == 2
        found = np.sort(np.linalg.eigvals(hidden @ T @ A @ T.T @ hidden.T).real)
        np.testing.assert_allclose(found, [-2 * scale, -scale], rtol=1e-13)
        assert len(unobservable(A, rng.normal(size=(1, 4)))) == 0


def test_the_half_explicit_method_has_order_4_on_a_constraint_whose_gradient_moves():
    # (2.10) for y = a + 0.2 a^2 + 0.1 sin b, y(t) given: x' = f + C(x)' m' + m Gamma, against its ODE (2.7), which needs y'.
    def f(x):
        return np.array([-0.5 * x[0] + x[1] + 1, np.cos(x[0]) - x[1]])

    def C(x):
        return np.array([1 + 0.4 * x[0], 0.1 * np.cos(x[1])])

    def h(x):
        return x[0] + 0.2 * x[0] ** 2 + 0.1 * np.sin(x[1])

    def y(t):
        return 1.2 + 0.3 * np.sin(t)

    def ode(t, z):
        rate, c = f(z[:2]) + z[2] * np.array([2.0, 1.0]), C(z[:2])
        m_dot = (0.3 * np.cos(t) - c @ rate) / (c @ c)
        return [*(rate + c * m_dot), m_dot]

    a = ca.SX.sym("a")
    begin = float(ca.rootfinder("a", "newton", {"x": a, "g": a + 0.2 * a**2 - 1.2})(x0=1)["x"])
    reference = solve_ivp(ode, (0, 2), [begin, 0.0, 0.4], rtol=1e-12, atol=1e-13).y[:, -1]
    gaps = []
    for steps in (20, 40, 80):
        size, x, m = 2 / steps, np.array([begin, 0.0]), np.array([0.4])
        for k in range(steps):

            def constrain(moved, G, c, t=k * size, size=size):
                nu = np.zeros(1)
                for _ in range(8):
                    here = moved + G @ nu
                    nu = nu - (h(here) - y(t + c * size)) / (C(here) @ G)
                return nu

            x, m = half_explicit(
                lambda x, m, c: (f(x) + m * np.array([2.0, 1.0]), C(x)[:, None]), constrain, x, m, size
            )
        assert h(x) == pytest.approx(y(2.0), abs=1e-14)
        gaps.append(np.abs(np.append(x, m) - reference).max())
    assert all(3.7 < np.log2(coarse / fine) < 4.6 for coarse, fine in itertools.pairwise(gaps))


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
    np.testing.assert_allclose(ca.DM(inverse(constant(A))).full(), np.linalg.inv(A), rtol=1e-13)


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
        assert float(interpolated(samples, ca.DM(k), Fraction(-1, 2), 3)) == expected


def test_backward_differentiation_has_the_published_coefficients():
    assert coefficients(1) == [1, -1]
    assert coefficients(2) == [3 / 2, -2, 1 / 2]
    assert coefficients(5) == [137 / 60, -5, 5, -10 / 3, 5 / 4, -1 / 5]
    assert coefficients(6) == [147 / 60, -6, 15 / 2, -20 / 3, 15 / 4, -6 / 5, 1 / 6]


def test_backward_differentiation_is_zero_stable_up_to_its_largest_order_and_not_beyond():
    largest = []
    for order in (*range(2, MOST + 1), MOST + 1):
        roots = np.roots([float(a) for a in lagrange_slopes(order, Fraction(0))])
        largest.append(np.sort(np.abs(roots[np.abs(roots - 1) > 1e-6]))[-1])
    assert largest[-2] == pytest.approx(0.863, abs=1e-3) and max(largest[:-1]) == largest[-2]
    assert largest[-1] == pytest.approx(1.022, abs=1e-3)


@pytest.mark.parametrize(("order", "wedge"), [(5, 51.8), (6, 17.8)])
def test_backward_differentiation_is_stable_for_poles_in_a_wedge_and_for_all_others_as_the_page_says(order, wedge):
    def grows(size, angle):
        """Whether steps of the linear error with the pole z = Ts p, `angle` degrees off the negative real axis, grow."""
        polynomial = np.array(coefficients(order), dtype=complex)
        polynomial[0] += size * np.exp(-1j * np.pi * angle / 180)
        return np.abs(np.roots(polynomial)).max() > 1

    sizes = np.geomspace(1e-2, 30, 60)
    assert not any(grows(size, angle) for size in sizes for angle in (0, wedge / 2, wedge - 0.3))
    assert any(grows(size, wedge + 0.5) for size in sizes)
    assert not any(grows(size, angle) for size in sizes[sizes < 0.72] for angle in range(0, 90, 8))


@pytest.mark.parametrize(("n", "q"), [(2, 0), (3, 1), (4, 2), (5, 3)])
def test_a_complement_spans_the_left_null_space(n, q):
    E = np.random.default_rng(n).normal(size=(n, q))
    found = complement(E)
    assert found is not None
    np.testing.assert_allclose(found.T @ E, 0, rtol=0, atol=5e-15)
    np.testing.assert_allclose(found.T @ found.R, np.eye(n - q), rtol=0, atol=1e-14)
    np.testing.assert_allclose(found.L @ E, np.eye(q), rtol=0, atol=5e-15)
    if q:
        basis = null_space(E.T)
        np.testing.assert_allclose(basis @ basis.T @ found.T.T, found.T.T, rtol=0, atol=5e-15)


def test_a_matrix_without_full_column_rank_has_no_complement():
    assert complement(np.array([[1.0, 2.0], [2.0, 4.0], [3.0, 6.0]])) is None
    assert exact_inverse(np.array([[1.0, 2.0], [2.0, 4.0]])) is None
    np.testing.assert_array_equal(exact_inverse(np.array([[0.0, 2.0], [4.0, 0.0]])), [[0, 0.25], [0.5, 0]])
