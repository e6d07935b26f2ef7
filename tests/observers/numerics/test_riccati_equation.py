"""Riccati and exponential steps against scipy and against multiple precision, which tells whose error a difference is."""

import math

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_continuous_are

from high_precision import EPS, algebraic_riccati, condition, exponential, relative, riccati_flow
from observers.numerics.linear import qr_solve
from observers.numerics.riccati import propagator, riccati_step
from observers.riccati.correction import correction
from observers.riccati.rosenbrock import rosenbrock

SIZES = (1, 2, 6, 12, 20)
HARD = [(1.0, 1.0, 1.0), (1e4, 1.0, 1.0), (1.0, 1e6, 1.0), (1.0, 1.0, 1e8), (1e4, 1e6, 1e8)]  # stiff, gain, Q0


def two_outputs(n):
    return np.random.default_rng(n).normal(size=(2, n))


def all_outputs(n):
    return np.eye(n) + 0.3 / math.sqrt(n) * np.random.default_rng(n).normal(size=(n, n))


def system(n, stiff=1.0, gain=1.0, outputs=two_outputs):
    """(A, W, S): decay rates from about 1 to `stiff`, S = gain C'C."""
    A = np.random.default_rng(100 + n).normal(size=(n, n)) - np.diag(np.linspace(0, 1, n) ** 3 * stiff)
    S = gain * outputs(n).T @ outputs(n)
    return A, np.eye(n), (S + S.T) / 2


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize(("stiff", "h"), [(1.0, 0.1), (1e4, 0.01), (1e4, 0.1)])
def test_the_transition_matrix_is_the_exponential_to_1e_12(n, stiff, h):
    A, W, _ = system(n, stiff)
    Phi = propagator(n)(A, W, h)[0].full()
    assert relative(Phi, exponential(A, h)) < 1e-14
    assert relative(Phi, expm(A * h)) < (
        1e-12 if stiff == 1 else 1e-10
    )  # in the stiff cases the difference is scipy's error


@pytest.mark.parametrize("n", SIZES)
def test_the_process_noise_of_a_step_is_van_loans(n):
    A, W, _ = system(n)
    _, Wd = propagator(n)(A, W, 0.1)
    E = expm(0.1 * np.block([[-A, W], [np.zeros((n, n)), A.T]]))
    assert relative(Wd.full(), E[n:, n:].T @ E[:n, n:]) < 2e-14


@pytest.mark.parametrize("n", SIZES)
def test_a_riccati_step_is_the_differential_equations_solution_by_scipy(n):
    A, W, S = system(n)

    def rhs(_, q):
        Q = q.reshape(n, n)
        return (A @ Q + Q @ A.T - Q @ S @ Q + W).ravel()

    solved = solve_ivp(rhs, (0, 0.1), np.eye(n).ravel(), method="DOP853", rtol=1e-13, atol=1e-15)
    assert relative(riccati_step(n)(np.eye(n), A, W, S, 0.1).full(), solved.y[:, -1].reshape(n, n)) < 1e-13


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize(("stiff", "gain", "first"), HARD)
def test_a_riccati_step_is_exact_to_1e_12_where_every_state_is_measured(n, stiff, gain, first):
    A, W, S = system(n, stiff, gain, all_outputs)
    Q = first * np.eye(n)
    assert relative(riccati_step(n)(Q, A, W, S, 0.01).full(), riccati_flow(Q, A, W, S, 0.01)) < 1e-14


@pytest.mark.parametrize(
    "n", [2, 6, pytest.param(12, marks=pytest.mark.long), pytest.param(20, marks=pytest.mark.long)]
)
@pytest.mark.parametrize(("stiff", "gain", "first"), HARD)
def test_with_two_outputs_a_riccati_step_is_as_exact_as_its_condition_allows(n, stiff, gain, first):
    """1e-12 wherever the condition is below 500; beyond, no algorithm in doubles has it."""
    A, W, S = system(n, stiff, gain)
    Q = first * np.eye(n)

    def reference(*arguments):
        return riccati_flow(*arguments, 0.01)

    error = relative(riccati_step(n)(Q, A, W, S, 0.01).full(), reference(Q, A, W, S))
    assert error < 10 * EPS * max(1.0, condition(reference, Q, A, W, S))


@pytest.mark.parametrize("n", [2, 6, 12, pytest.param(20, marks=pytest.mark.long)])
@pytest.mark.parametrize(("stiff", "gain", "first"), HARD)
def test_riccati_steps_end_at_the_algebraic_equations_solution_to_1e_12(n, stiff, gain, first):
    A, W, S = system(n, stiff, gain, all_outputs)
    Q = first * np.eye(n)
    for _ in range(12):
        Q = riccati_step(n)(Q, A, W, S, 10.0).full()
    assert relative(Q, algebraic_riccati(A, W, S, Q)) < 1e-14
    by_scipy = solve_continuous_are(A.T, math.sqrt(gain) * all_outputs(n).T, W, np.eye(n))
    assert relative(Q, by_scipy) < 1e-12
    np.linalg.cholesky(Q)


@pytest.mark.parametrize("n", [2, 6, 12])
@pytest.mark.parametrize(("stiff", "gain", "first"), HARD)
def test_with_two_outputs_the_algebraic_solution_is_reached_as_its_condition_allows(n, stiff, gain, first):
    A, W, S = system(n, stiff, gain)
    Q = first * np.eye(n)
    for _ in range(12):
        Q = riccati_step(n)(Q, A, W, S, 10.0).full()

    def reference(start, *matrices):
        return algebraic_riccati(*matrices, start)

    assert relative(Q, reference(Q, A, W, S)) < 20 * EPS * max(1.0, condition(reference, Q, A, W, S))
    np.linalg.cholesky(Q)


@pytest.mark.parametrize(("stiff", "gain", "first"), [(1e4, 1, 1), (1, 1e6, 1), (1, 1, 1e8), (1e4, 1e6, 1e8)])
def test_a_riccati_step_stays_positive_definite_where_it_is_stiff(stiff, gain, first):
    for n in (2, 6, 12, 20):
        A, W, S = system(n, stiff, gain)
        Q = first * np.eye(n)
        for _ in range(20):
            Q = riccati_step(n)(Q, A, W, S, 0.01).full()
            assert np.array_equal(Q, Q.T)
            np.linalg.cholesky(Q)


def test_two_half_steps_are_one_whole_one():
    A, W, S = system(6, gain=1e3)
    step = riccati_step(6)
    assert (
        relative(step(step(np.eye(6), A, W, S, 0.05), A, W, S, 0.05).full(), step(np.eye(6), A, W, S, 0.1).full())
        < 1e-13
    )


@pytest.mark.parametrize("n", [1, 3, 7])
def test_givens_rotations_solve_where_pivots_vanish(n):
    rng = np.random.default_rng(n)
    A = np.fliplr(np.diag(rng.uniform(1, 2, n))) + np.triu(rng.normal(size=(n, n)), 2)
    b = rng.normal(size=(n, 2))
    np.testing.assert_allclose(ca.DM(qr_solve(ca.SX(A), ca.SX(b))), np.linalg.solve(A, b), rtol=0, atol=2e-14)


def test_the_exponential_step_is_exact_for_linear_systems_with_linear_forcing_however_stiff():
    rng = np.random.default_rng(1)
    A = np.array([[-1e6, 3.0, 0], [1.0, -0.5, 2], [0, 1, -30]])
    b, c, x, h = rng.normal(size=3), rng.normal(size=3), rng.normal(size=3), 0.1
    arguments = [ca.MX(v) for v in (A, A @ x + b, c, np.eye(3))]
    found = ca.evalf(rosenbrock(*arguments, h)[0])
    block = np.zeros((5, 5))
    block[:3, :3], block[:3, 3], block[:3, 4], block[3, 4] = A, c, b, 1
    expected = expm(block * h) @ np.concatenate([x, [0, 1]])
    np.testing.assert_allclose(x + found.full().ravel(), expected[:3], rtol=0, atol=1e-12)


def test_a_correction_is_bayes_rule_and_leaves_rejected_outputs_out():
    rng = np.random.default_rng(2)
    root, C, r, m = rng.normal(size=(4, 4)), rng.normal(size=(3, 4)), rng.normal(size=3), rng.normal(size=4)
    Q, Rd = root @ root.T, np.array([[1.0, 0.3, 0.2], [0.3, 2.0, 0.1], [0.2, 0.1, 0.5]])
    for valid in ([1, 1, 1], [1, 0, 1], [0, 0, 0]):
        rows = np.flatnonzero(valid)
        information = np.linalg.inv(Q) + C[rows].T @ np.linalg.inv(Rd[np.ix_(rows, rows)]) @ C[rows]
        gain = np.linalg.solve(information, C[rows].T @ np.linalg.inv(Rd[np.ix_(rows, rows)]))
        m_after, Q_after, distance = correction(4, 3)(m, Q, Q @ C.T, C, r * valid, Rd, valid)
        S = (C @ Q @ C.T + Rd)[np.ix_(rows, rows)]
        assert float(distance) == pytest.approx(r[rows] @ np.linalg.solve(S, r[rows]), rel=1e-13)
        np.testing.assert_allclose(Q_after, np.linalg.inv(information), rtol=0, atol=7e-14)
        np.testing.assert_allclose(m_after.full().ravel(), m + gain @ r[rows], rtol=0, atol=2e-14)
