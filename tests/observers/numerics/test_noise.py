"""The noise generator: its integer sequence, its distributions, the independence of its seeds."""

import casadi as ca
import numpy as np

from observers.numerics import noise


def sequence(seed, count, bound=0.0, deviation=0.0):
    states = ca.SX.sym("s", 2)
    draw = ca.Function("draw", [states], list(noise.draw(states, [bound], [deviation])))
    state, values = noise.start(ca.DM(seed)), []
    for _ in range(count):
        state, value = draw(state)
        values.append(float(value))
    return np.array(values)


def lehmer(seed, count):
    """The same in Python integers, exact by construction."""
    state = 1 + (1 + (seed + 1) ** 2 * 7919) % 2147483646
    values = []
    for i in range(count + 3):
        state = 16807 * state % 2147483647
        if i >= 3:
            values.append(2 * state / 2147483647 - 1)
    return np.array(values)


def test_the_sequence_equals_the_exact_integer_one_for_any_seed():
    for seed in (0, 1, 7, 12345, noise.LARGEST_SEED):
        np.testing.assert_array_equal(sequence(seed, 200, bound=1.0), lehmer(seed, 200))


def test_the_sequences_of_seeds_0_to_39_do_not_correlate():
    for bound, deviation in ((1.0, 0.0), (0.0, 1.0)):
        streams = np.array([sequence(seed, 5000, bound, deviation) for seed in range(40)])
        correlation = np.corrcoef(streams) - np.eye(40)
        assert np.abs(correlation).max() < 0.07


def test_the_uniform_noise_is_uniform_and_the_gaussian_is_gaussian():
    uniform, gaussian = sequence(3, 20000, bound=0.5), sequence(3, 20000, deviation=2.0)
    assert np.abs(uniform).max() <= 0.5
    for level in (-0.4, -0.1, 0.0, 0.3):
        assert abs(np.mean(uniform < level) - (level + 0.5)) < 0.015
    assert abs(gaussian.std() - 2.0) < 0.03 and abs(gaussian.mean()) < 0.05
    assert abs(np.mean(np.abs(gaussian) < 2.0) - 0.6827) < 0.015
    assert abs(np.mean(np.abs(gaussian) < 4.0) - 0.9545) < 0.01
    assert abs(np.corrcoef(gaussian[1:], gaussian[:-1])[0, 1]) < 0.02


def test_no_noise_asked_for_is_exactly_none():
    np.testing.assert_array_equal(sequence(5, 10), np.zeros(10))
