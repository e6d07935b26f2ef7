"""The error dynamics that the report derives, against closed forms and scipy: Example 2.2, (3.14), and (2.4) with a general v."""

import math

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import place_poles

from observers.canonical_dae import canonical_dae
from observers.canonical_dae.dae import relaxed
from observers.canonical_dae.gain import exact
from observers.canonical_dae.region import region
from observers.instance import Instance
from observers.model import Model, Variable
from reference_models.chua import CHUA
from reference_models.nikoukhah_1995 import CHUA_POLES

ALPHA, BETA, CUBIC, LINEAR = (p.start for p in CHUA.parameters)
A = np.array([[-ALPHA * LINEAR, ALPHA, 0], [1, -1, 1], [0, -BETA, 0]])  # of (2.23); g(x) = (-alpha a x1^3, 0, 0)
C = np.eye(3)[:1]


def chua_rates(t, x):
    return A @ x - [ALPHA * CUBIC * x[0] ** 3, 0, 0]


def followed(component, measured, names, stop, Ts, guess):
    """(times, values of `names`) after samples at 0, Ts, ... to `stop` of an observer of one output that sees `measured(t)`."""
    run, times, rows = Instance(component, guess), np.arange(round(stop / Ts) + 1) * Ts, []
    for t in times:
        run.set("y", measured(t))
        run.step(t, Ts)
        rows.append([run.get(name) for name in names])
    assert run.get("diagnostics.solver_failures") == 0
    return times, np.array(rows)


def gamma(model, poles, x):
    """Gamma by exact placement at the states x, parameters at their start values."""
    gain = exact(relaxed(model), region(model), poles)
    return gain.gamma(x, [], [v.start for v in model.parameters], 0, 0, [*poles, 1e-9])[0].full()


@pytest.mark.parametrize("size", [0.01, 1.0, 100.0])
def test_example_2_2s_error_follows_its_linear_equation_whatever_its_size_while_the_circuit_is_chaotic(size):
    J = place_poles(A.T, C.T, CHUA_POLES).gain_matrix.T
    x0 = np.array([0.1, 0.0, 0.0])
    truth = solve_ivp(chua_rates, (0, 11), x0, method="DOP853", rtol=1e-12, atol=1e-13, dense_output=True).sol
    component = canonical_dae(CHUA, sample_time=0.01, poles=CHUA_POLES)
    names = ["filtered.x1", "filtered.x2", "filtered.x3", "diagnostics.lambda"]
    guess = {"guess.x1": 0.1 + max(size, 1), "guess.x2": -size, "guess.x3": size}
    times, found = followed(component, lambda t: truth(t)[0], names, 10.0, 0.01, guess)
    # w = error - C' lambda obeys w' = (A - J C) w; C error = 0 leaves lambda = -w1 and the other two errors themselves.
    w = np.array([expm((A - J @ C) * t) @ [0, -size, size] for t in times])
    expected = np.column_stack([0 * times, w[:, 1], w[:, 2], -w[:, 0]])
    error = found - np.column_stack([truth(times).T, 0 * times])
    np.testing.assert_allclose(error, expected, rtol=0, atol=2e-6 * max(size, 1))


def test_example_2_2s_gain_does_not_move_with_the_state_though_the_jacobian_does():
    J = place_poles(A.T, C.T, CHUA_POLES).gain_matrix.T
    for x in np.random.default_rng(0).uniform(-2, 2, (5, 3)):
        np.testing.assert_allclose(gamma(CHUA, CHUA_POLES, x), (J @ C - A) @ C.T, rtol=0, atol=1e-11)


MANY_EQUILIBRIA = Model(
    name="many_equilibria",
    description="(3.14): every x1 with x2 = 0 is an equilibrium",
    states=[Variable("x1", start=0.7), Variable("x2", start=-0.2)],
    outputs=[Variable("y")],
    ode=lambda x, u, p, t: [x.x2, x.x1 * x.x2],
    output=lambda x, u, p, t: [x.x1],
)


def test_3_14s_gain_is_the_same_on_its_equilibria_and_beside_them():
    """A is taken at the estimate, not restricted to x2 = 0 as in (3.15): Gamma = (J C - A) C' does not see the difference."""
    for x1, x2 in np.random.default_rng(1).uniform(-2, 2, (5, 2)):
        restricted = np.array([[0, 1], [0, x1]])
        J = place_poles(restricted.T, np.array([[1.0], [0.0]]), [-3, -4]).gain_matrix.T
        np.testing.assert_allclose(
            gamma(MANY_EQUILIBRIA, [-3.0, -4.0], [x1, x2]), J - restricted[:, :1], rtol=0, atol=1e-11
        )


def test_3_14_is_estimated_along_its_closed_form():
    def x1(t):
        return -np.tanh(t / 2 - 1)  # x2 = x1' = (x1^2 - 1) / 2

    component = canonical_dae(MANY_EQUILIBRIA, sample_time=0.01, poles=[-3.0, -4.0])
    times, found = followed(component, x1, ["filtered.x1", "filtered.x2"], 8.0, 0.01, {"guess.x2": 1.0})
    gap = np.abs(found[:, 1] - (x1(times) ** 2 - 1) / 2)
    assert np.array_equal(found[:, 0], x1(times)) and gap[0] > 1
    assert gap[-1] < 1e-8


def pendulum(bend):
    return Model(
        name="pendulum",
        states=[Variable("x1", start=1.0), Variable("x2")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.x2, -ca.sin(x.x1)],
        output=lambda x, u, p, t: [x.x1 + bend * x.x1**3],
    )


def general(x, u, p, t, lam):
    """v = (3 lambda + x1^2 lambda^3, 4 lambda / (1 + lambda^2)) of (2.4) as Gamma lambda; v = 0 at lambda = 0, as (2.8) asks."""
    return [[3 + x.x1**2 * lam[0] ** 2], [4 / (1 + lam[0] ** 2)]]


def pendulum_reference(bend, guess, stop):
    """The plant and (2.7) with that v by scipy: (x1, x2, x1^, x2^, lambda)."""

    def rates(t, z):
        x1, x2, e1, e2, lam = z
        slope, there = 1 + 3 * bend * e1**2, 1 + 3 * bend * x1**2
        v1, v2 = 3 * lam + e1**2 * lam**3, 4 * lam / (1 + lam**2)
        lam_dot = (there * x2 - slope * (e2 + v1)) / slope**2
        return [x2, -np.sin(x1), e2 + v1 + slope * lam_dot, -np.sin(e1) + v2, lam_dot]

    return solve_ivp(rates, (0, stop), [1, 0, 1, guess, 0], rtol=1e-11, atol=1e-12, dense_output=True).sol


@pytest.mark.parametrize("bend", [0.0, 0.1], ids=["y = x1", "a bent output"])
@pytest.mark.parametrize(("options", "order"), [({}, 2.7), ({"form": "bdf", "order": 2}, 1.7)], ids=["w", "bdf"])
def test_a_general_v_is_integrated_as_the_reports_dae_as_the_step_shrinks(bend, options, order):
    reference, gaps = pendulum_reference(bend, 3.0, 3.1), []
    for Ts in (0.02, 0.01):
        component = canonical_dae(pendulum(bend), sample_time=Ts, gain=general, **options)
        names = ["filtered.x1", "filtered.x2", "diagnostics.lambda"]
        times, found = followed(
            component,
            lambda t: float(reference(t)[0] + bend * reference(t)[0] ** 3),
            names,
            3.0,
            Ts,
            {"guess.x1": 2.0, "guess.x2": 3.0},
        )
        gaps.append(np.abs(found - reference(times)[2:].T)[times > 1].max())
    assert gaps[1] < 1e-3 and math.log2(gaps[0] / gaps[1]) > order


def test_a_general_v_bends_the_error_where_a_gain_does_not():
    """What v adds to Gamma lambda is seen: the same motion with Gamma = v_lambda(0) alone is another."""
    found = []
    for gain in (general, lambda x, u, p, t: [[3], [4]]):
        component = canonical_dae(pendulum(0.0), sample_time=0.01, gain=gain)
        sol = pendulum_reference(0.0, 3.0, 1.1)
        _, rows = followed(
            component,
            lambda t, sol=sol: float(sol(t)[0]),
            ["filtered.x2"],
            1.0,
            0.01,
            {"guess.x1": 2.0, "guess.x2": 3.0},
        )
        found.append(rows)
    assert np.abs(found[0] - found[1]).max() > 0.1
