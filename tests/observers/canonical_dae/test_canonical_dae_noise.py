"""Example 2.3, (2.60)-(2.66): what noise does to the velocity, against the report's full-order and reduced-order observers."""

import numpy as np
import pytest
from scipy.signal import lsim

from observers.canonical_dae import canonical_dae
from observers.instance import Instance
from reference_models.double_integrator import DOUBLE_INTEGRATOR

TS = 0.01  # [s]
A, C = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[1.0, 0.0]])


def coefficients(pole):
    """gamma_1, gamma_2 of a double pole."""
    return -2 * pole, pole**2


def full_order(s, pole):
    """(2.61): the errors of both estimates for noise exp(s t)."""
    g1, g2 = coefficients(pole)
    return np.array([g1 * s + g2, g2 * s]) / (s**2 + g1 * s + g2)


def reduced_order(s, pole):
    """(2.63)."""
    return np.array([1, -pole * s / (s - pole)])


def derivative(s, pole):
    """(2.65)."""
    return np.array([1, s])


def canonical(s, pole):
    """(2.66)."""
    g1, g2 = coefficients(pole)
    return np.array([1, g2 * s / (s**2 + g1 * s + g2)])


def of_dae(s, E, Gamma, direct):
    """x for y = exp(s t) of s x = A x + E s lambda + Gamma lambda, 0 = y - C x + direct lambda."""
    pencil = np.block([[s * np.eye(2) - A, -(s * E + Gamma)[:, None]], [C, np.array([[-direct]])]])
    return np.linalg.solve(pencil, [0, 0, 1])[:2]


@pytest.mark.parametrize("s", [0.3j, 2j, 50j, 1 + 3j])
@pytest.mark.parametrize("pole", [-1.0, -10.0])
def test_the_reports_responses_are_those_of_its_daes(s, pole):
    (g1, g2), none = coefficients(pole), np.zeros(2)
    cases = [
        (full_order, none, np.array([-g1, -g2]), 1),  # (2.1), (2.2)
        (reduced_order, none, np.array([1, -pole]), 0),  # (2.1), (2.3), Gamma' = (1, gamma)
        (derivative, none, np.array([0, -pole]), 0),  # (2.1), (2.3), Gamma' = (0, gamma)
        (canonical, C[0], np.array([g1, g2]), 0),  # (2.10), (2.11)
    ]
    for response, E, Gamma, direct in cases:
        np.testing.assert_allclose(of_dae(s, E, Gamma, direct), response(s, pole), rtol=1e-12)


def test_high_frequencies_reach_the_velocity_as_2_64_says():
    """gamma in the reduced-order observer, ever more in (2.65), ever less in the full-order and the canonical one, which are alike."""
    pole, s = -10.0, 1e5j
    assert abs(reduced_order(s, pole)[1]) == pytest.approx(10, rel=1e-3)
    assert abs(derivative(s, pole)[1]) == pytest.approx(1e5)
    assert canonical(s, pole)[1] == full_order(s, pole)[1]
    assert abs(canonical(s, pole)[1]) == pytest.approx(100 / 1e5, rel=1e-3)


def rms(response, pole):
    """Of both errors, for noise that is white up to half the sampling frequency and of rms 1."""
    omega = np.linspace(0, np.pi / TS, 20001)[1:]
    power = np.abs([response(1j * w, pole) for w in omega]) ** 2
    return np.sqrt(power.mean(axis=0))


def measured(noise, pole, degree):
    """Errors of x1 and x2 (N x 2) that the observer makes of noise on the measurement of a mass at rest."""
    observer = canonical_dae(DOUBLE_INTEGRATOR, sample_time=TS, poles=(pole, pole), degree=degree)
    start = {"guess.x1": 0.0, "guess.x2": 0.0, "tuning.measurement_noise.y": 10.0}  # no sample is an outlier
    run, rows = Instance(observer, start), []
    for k, value in enumerate(noise):
        run.set("y", value)
        run.step(TS * k, TS)
        rows.append([run.get("filtered.x1"), run.get("filtered.x2")])
    return np.array(rows)


@pytest.mark.parametrize(
    ("pole", "degree", "more"),
    [(-1.0, 3, 1.0), (-1.0, 9, 1.08), (-10.0, 3, 1.0), (-10.0, 9, 1.66)],
    ids=["slow", "slow, degree 9", "fast", "fast, degree 9"],
)
def test_noise_reaches_the_velocity_as_in_the_full_order_observer_and_not_as_in_the_reduced_order_one(
    pole, degree, more
):
    noise = np.random.default_rng(3).normal(size=12000)
    late, times = slice(1000, None), TS * np.arange(12000)
    error = measured(noise, pole, degree)
    np.testing.assert_array_equal(error[:, 0], noise)  # as (2.66) and (2.63) say of x1
    found = error[late, 1].std()
    g1, g2 = coefficients(pole)
    full = lsim(([g2, 0], [1, g1, g2]), noise, times)[1][late].std()
    reduced = lsim(([-pole, 0], [1, -pole]), noise, times)[1][late].std()
    assert found == pytest.approx(more * rms(canonical, pole)[1], rel=0.1)
    assert found == pytest.approx(more * full, rel=0.1)
    assert reduced > 0.6 * rms(reduced_order, pole)[1]  # between samples lsim draws lines
    assert found < (0.3 if pole == -10 else 0.1) * rms(reduced_order, pole)[1]
