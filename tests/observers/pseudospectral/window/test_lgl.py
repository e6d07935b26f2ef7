"""LGL collocation against closed forms, exactness on polynomials, and spectral convergence."""

import numpy as np
import pytest

from observers.pseudospectral.window import lgl

CLOSED_FORMS = {
    2: ([-1, 0, 1], [1 / 3, 4 / 3, 1 / 3]),
    3: ([-1, -np.sqrt(1 / 5), np.sqrt(1 / 5), 1], [1 / 6, 5 / 6, 5 / 6, 1 / 6]),
    4: ([-1, -np.sqrt(3 / 7), 0, np.sqrt(3 / 7), 1], [1 / 10, 49 / 90, 32 / 45, 49 / 90, 1 / 10]),
}


@pytest.mark.parametrize("order", CLOSED_FORMS)
def test_nodes_and_weights_equal_their_closed_forms(order):
    nodes, weights = CLOSED_FORMS[order]
    np.testing.assert_allclose(lgl.nodes(order), nodes, rtol=0, atol=2e-16)
    np.testing.assert_allclose(lgl.weights(order), weights, rtol=2e-15)


def test_the_differentiation_matrix_of_order_2_equals_its_closed_form():
    np.testing.assert_allclose(
        lgl.differentiation(2), [[-1.5, 2, -0.5], [-0.5, 0, 0.5], [0.5, -2, 1.5]], rtol=0, atol=1e-15
    )


@pytest.mark.parametrize("order", [2, 5, 8, 15, 50])
def test_the_corner_entries_are_those_of_the_paper(order):
    D = lgl.differentiation(order)
    assert D[0, 0] == pytest.approx(-order * (order + 1) / 4, rel=1e-12)
    assert D[-1, -1] == pytest.approx(order * (order + 1) / 4, rel=1e-12)


@pytest.mark.parametrize("order", [1, 2, 5, 15, 50])
def test_differentiation_and_interpolation_are_exact_up_to_degree_N_and_quadrature_up_to_2N_minus_1(order):
    tau, D, w = lgl.nodes(order), lgl.differentiation(order), lgl.weights(order)
    at = np.linspace(-1, 1, 37)
    P = lgl.interpolation(order, at)
    for degree in range(2 * order):
        basis = np.polynomial.legendre.Legendre.basis(degree)
        assert w @ basis(tau) == pytest.approx(2.0 if degree == 0 else 0.0, abs=1e-14)
        if degree <= order:
            np.testing.assert_allclose(D @ basis(tau), basis.deriv()(tau), rtol=0, atol=1e-11 * order**2)
            np.testing.assert_allclose(P @ basis(tau), basis(at), rtol=0, atol=2e-14)


def test_interpolation_at_the_nodes_is_the_identity_and_repeats_bit_for_bit():
    np.testing.assert_array_equal(lgl.interpolation(15, lgl.nodes(15)), np.eye(16))
    at = np.linspace(-0.9, 0.9, 11)
    np.testing.assert_array_equal(lgl.interpolation(15, at), lgl.interpolation(15, at))


def test_differentiation_converges_spectrally_on_an_analytic_function():
    def error(order):
        tau = lgl.nodes(order)
        return np.abs(
            lgl.differentiation(order) @ np.exp(np.sin(3 * tau)) - 3 * np.cos(3 * tau) * np.exp(np.sin(3 * tau))
        ).max()

    errors = np.array([error(order) for order in (8, 16, 24, 32)])
    ratios = errors[:-1] / errors[1:]
    assert np.all(ratios > 30), errors  # a method of fixed order q gains 2^q once and then ever less
    assert error(48) < 4e-12


def test_an_order_below_one_is_refused():
    with pytest.raises(ValueError, match="N = 0 must be at least 1"):
        lgl.nodes(0)
