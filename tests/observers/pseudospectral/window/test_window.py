"""The window's constants: the semilinear split, the forced response, collocation; against scipy and exactness."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from observers.model import Model, Variable
from observers.numerics import semilinear
from observers.pseudospectral.window import collocation
from observers.pseudospectral.window.forced import forced_response, input_at

A = np.array([[0.0, 1.0], [-2.0, -0.3]])
B = np.array([[0.0], [1.5]])


def test_the_split_moves_constant_terms_out_and_keeps_the_sum():
    x, u, p, t = ca.SX.sym("x", 3), ca.SX.sym("u", 2), ca.SX.sym("p"), ca.SX.sym("t")
    f = ca.vertcat(2 * x[1] - 3 * u[0], x[0] - 0.5 * x[2] + ca.sin(x[1]) * u[1] + 4 * u[0], p * x[0] + ca.cos(t))
    parts = semilinear.split(f, x, u)
    np.testing.assert_array_equal(parts.A, [[0, 2, 0], [1, 0, -0.5], [0, 0, 0]])
    np.testing.assert_array_equal(parts.B, [[-3, 0], [4, 0], [0, 0]])
    assert (parts.rows, parts.states, parts.inputs) == ([1, 2], [0, 1], [1])
    whole = ca.Function(
        "whole", [x, u, p, t], [f - ca.DM(parts.A) @ x - ca.DM(parts.B) @ u - ca.DM(parts.E) @ parts.phi]
    )
    rng = np.random.default_rng(0)
    assert np.abs(whole(rng.normal(size=3), rng.normal(size=2), 0.7, 1.3).full()).max() < 1e-14


def test_what_no_output_sees_is_found_through_chains_of_states():
    x, theta = ca.SX.sym("x", 3), ca.SX.sym("theta", 2)
    f = ca.vertcat(x[1], theta[0] * x[0], x[0] + theta[1])
    assert semilinear.unreachable(f, x[0], ca.vertcat(x, theta), x) == [2, 4]


@pytest.mark.parametrize("kind", ["held", "linear"])
def test_the_forced_response_is_exact_for_a_held_and_a_linear_input(kind):
    Ts, L = 0.2, 6
    values = np.random.default_rng(1).normal(size=L + (kind == "linear"))
    times = np.array([0.0, 0.05, 0.2, 0.77, 1.2])

    def u(t):
        i = min(int(t / Ts + 1e-9), L - 1)
        return values[i] if kind == "held" else values[i] + (values[i + 1] - values[i]) * (t / Ts - i)

    found = (forced_response(A, B, Ts, L, times, kind) @ values).reshape(-1, 2)
    state, at, expected = np.zeros(2), 0.0, []
    for time in times:
        for end in [*[k * Ts for k in range(L + 1) if at < k * Ts < time], time]:
            if end > at:
                middle = lambda t, a=at, b=end: u(min(max(t, a + 1e-12), b - 1e-7 * (b - a)))  # noqa: E731
                run = solve_ivp(
                    lambda t, x, m=middle: A @ x + B[:, 0] * m(t),
                    (at, end),
                    state,
                    rtol=1e-12,
                    atol=1e-13,
                    method="DOP853",
                )
                state, at = run.y[:, -1], end
        expected.append(state)
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-9)
    np.testing.assert_allclose(
        input_at(Ts, L, np.array([0.05, 0.77]), kind) @ values, [u(0.05), u(0.77)], rtol=0, atol=6e-15
    )


def linear_model():
    return Model(
        name="lti",
        states=[Variable("x1"), Variable("x2")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.x2, -2 * x.x1 - 0.3 * x.x2],
        output=lambda x, u, p, t: [x.x1],
    )


def test_the_free_response_of_a_linear_model_converges_spectrally_in_N():
    eq = linear_model().equations
    parts = semilinear.split(eq.ode, eq.x, eq.u)
    exact = expm(A * 4.0) @ [1.0, -1.0]
    errors = []
    for order in (4, 6, 8, 10, 12):
        Ph, Ps = collocation.segment(parts, order, 8, 0.5).at(np.array([4.0]))
        assert Ps.shape == (2, 0)
        errors.append(np.abs(Ph @ [1.0, -1.0] - exact).max())
    ratios = np.array(errors[:-1]) / errors[1:]
    assert np.all(ratios[1:] > ratios[0]) and errors[-1] < 2e-7, errors  # faster than any fixed order
