"""Unrolled factorisations against scipy."""

import casadi as ca
import numpy as np
import pytest
from scipy import linalg as reference

from observers.numerics import linear


@pytest.mark.parametrize("n", [1, 2, 5, 12])
def test_lu_solves_as_scipy_does(n):
    rng = np.random.default_rng(n)
    A, b = np.eye(n) + 0.5 * rng.standard_normal((n, n)) / n, rng.standard_normal((n, 3))
    sym_A, sym_b = ca.SX.sym("A", n, n), ca.SX.sym("b", n, 3)
    LU = linear.lu_factor(sym_A)
    solve = ca.Function(
        "f", [sym_A, sym_b], [linear.backward(LU, linear.forward(LU, sym_b)), linear.right_solve(LU, sym_b.T)]
    )
    x, right = solve(A, b)
    np.testing.assert_allclose(x.full(), reference.solve(A, b), rtol=0, atol=1e-14)
    upper = np.triu(ca.Function("g", [sym_A], [LU])(A).full())
    np.testing.assert_allclose(right.full(), reference.solve(upper.T, b).T, rtol=0, atol=1e-14)


@pytest.mark.parametrize("n", [1, 3, 8])
def test_ldl_solves_as_scipy_does_and_its_pivots_are_those_of_the_factorisation(n):
    rng = np.random.default_rng(n)
    root = rng.standard_normal((n + 2, n))
    H, b = root.T @ root, rng.standard_normal(n)
    sym_H, sym_b = ca.SX.sym("H", n, n), ca.SX.sym("b", n)
    x, pivots = ca.Function("f", [sym_H, sym_b], list(linear.ldl_solve(sym_H, sym_b)))(H, b)
    np.testing.assert_allclose(x.full().ravel(), reference.solve(H, b, assume_a="pos"), rtol=1e-13)
    np.testing.assert_allclose(pivots.full().ravel(), np.diag(np.linalg.cholesky(H)) ** 2, rtol=1e-13)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_givens_keeps_the_determinant_with_its_sign_and_solves_with_a_zero_pivot(n):
    A = np.roll(np.diag(np.arange(1.0, n + 1)), 1, axis=0)  # without pivoting, elimination would divide by zero
    b = np.arange(1.0, n + 1)
    sym_A, sym_b = ca.SX.sym("A", n, n), ca.SX.sym("b", n)
    R, _ = ca.Function("f", [sym_A, sym_b], list(linear.givens(sym_A, sym_b)))(A, b)
    assert np.prod(np.diag(R.full())) == pytest.approx(np.linalg.det(A), rel=1e-14)
    x = ca.Function("g", [sym_A, sym_b], [linear.qr_solve(sym_A, sym_b)])(A, b)
    np.testing.assert_allclose(x.full().ravel(), np.linalg.solve(A, b), rtol=1e-14)
