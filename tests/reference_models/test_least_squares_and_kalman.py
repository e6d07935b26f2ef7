"""Chen & Yen's example under noise: the least-squares observer beside a Kalman filter that is numpy's and scipy's only."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cosim.results import Result

NOISE, TS, LATE = 0.1, 0.05, 10.0  # standard deviation of a sample; [s]; from when on it counts [s]
SEEDS = range(4)


def run_with_noise(example: Callable[..., Result], seed: int, product: float) -> Result:
    """Figure 1's system (T = 0.25) with gamma p0 = `product`."""
    noisy = {
        "plant.sensor.noise_std": NOISE,
        "plant.sensor.sample_time": TS,
        "plant.sensor.seed": seed,
        "observer.sample_time": TS,
        "observer.tuning.gamma": product / 0.1,
    }
    return example("chen_yen_short", step=TS, overrides=noisy)


@cache
def transition(k: int) -> np.ndarray:
    """From t = k Ts to the next sample."""

    def rhs(t: float, z: np.ndarray) -> np.ndarray:
        s, c = math.sin(t), math.cos(t)
        A = np.array([[-1 + 1.5 * c * c, 1 - 1.5 * s * c], [-1 + 1.5 * s * c, -1 + 1.5 * s * s]])
        return (A @ z.reshape(2, 2)).ravel()

    moved = solve_ivp(rhs, (k * TS, (k + 1) * TS), [1, 0, 0, 1], method="DOP853", rtol=1e-10, atol=1e-12)
    return moved.y[:, -1].reshape(2, 2)


def kalman(samples: np.ndarray, process_noise: float) -> Iterator[np.ndarray]:
    """The prediction for the next instant after each sample, in Joseph's form; from the guess 0, off by 5 in each state."""
    x, P = np.zeros(2), 25 * np.eye(2)
    for k, y in enumerate(samples):
        r = math.sqrt(k * TS)
        C = np.array([[math.cos(r) + math.sin(r), 3 * math.cos(r) ** 2]])
        K = P @ C.T / (C @ P @ C.T + NOISE**2)
        left = np.eye(2) - K @ C
        x, P = x + K[:, 0] * (y - C[0] @ x), left @ P @ left.T + NOISE**2 * K @ K.T
        F = transition(k)
        x, P = F @ x, F @ P @ F.T + process_noise**2 * TS * np.eye(2)
        yield x


def truth(result: Result) -> np.ndarray:
    return np.array([result["plant.x.x1"], result["plant.x.x2"]]).T[1:]


def rms(errors: list[np.ndarray]) -> float:
    """Of both states, from LATE on."""
    late = TS * np.arange(1, len(errors[0]) + 1) > LATE - TS / 2
    return math.sqrt(float(np.mean(np.square([one[late] for one in errors]))))


@pytest.mark.parametrize(
    ("product", "expected"), [(0.5, 0.030), (1.0, 0.033), (2.0, 0.016), (4.0, 0.016), (8.0, 0.021)]
)
def test_the_rms_error_of_the_least_squares_observer_under_noise(
    example: Callable[..., Result], product: float, expected: float
) -> None:
    errors = []
    for seed in SEEDS:
        result = run_with_noise(example, seed, product)
        estimate = np.array([result["observer.estimate.x1"], result["observer.estimate.x2"]]).T[1:]
        errors.append(estimate - truth(result))
    assert rms(errors) == pytest.approx(expected, abs=6e-4)


@pytest.mark.parametrize(("process_noise", "expected"), [(0.0, 0.0031), (0.01, 0.0074), (0.016, 0.0087), (0.1, 0.020)])
def test_a_kalman_filter_of_the_same_samples_has_a_smaller_rms_error_the_less_it_forgets(
    example: Callable[..., Result], process_noise: float, expected: float
) -> None:
    """Nothing disturbs the plant. Process noise in units of a state per sqrt(s)."""
    results = [run_with_noise(example, seed, 2.0) for seed in SEEDS]
    errors = [np.array(list(kalman(one["plant.y"][:-1], process_noise))) - truth(one) for one in results]
    assert rms(errors) == pytest.approx(expected, rel=0.03)
