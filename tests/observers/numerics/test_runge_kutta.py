"""Runge-Kutta steps against their order and scipy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from observers.numerics.runge_kutta import CLASSICAL_4, DORMAND_PRINCE_8, runge_kutta


def rhs(x, t):
    return np.array([x[1], -np.sin(x[0]) + 0.3 * np.cos(t) - 0.1 * x[1]])


def integrate(tableau, steps, end=4.0):
    x, h = np.array([1.0, 0.5]), end / steps
    for i in range(steps):
        x = runge_kutta(rhs, x, i * h, h, tableau)
    return x


@pytest.mark.parametrize(("tableau", "steps"), [(CLASSICAL_4, (40, 80, 160)), (DORMAND_PRINCE_8, (8, 16, 32))])
def test_the_error_falls_with_the_order_of_the_method(tableau, steps):
    reference = solve_ivp(lambda t, x: rhs(x, t), (0, 4), [1, 0.5], method="Radau", rtol=1e-13, atol=1e-14).y[:, -1]
    exact = integrate(DORMAND_PRINCE_8, 400)
    np.testing.assert_allclose(exact, reference, rtol=0, atol=3e-14)  # another family of methods, to its own accuracy
    errors = [np.abs(integrate(tableau, n) - exact).max() for n in steps]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(orders - tableau.order) < 0.6), orders
