"""Both linear-gain observers on linear systems of every size, through FMUs whose matrices are parameters."""

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import expm

from linear_models import LARGEST, SAMPLE_TIME, design, entries, kalman, outputs_of
from slave import Slave


def estimates(
    slave: Slave, names: list[str], samples: np.ndarray, known: np.ndarray, Ts: float
) -> Iterator[np.ndarray]:
    """The variables `names` after each step of Ts, with `samples` (count x ny) and the known input u (count)."""
    inputs = [slave.variables[name].valueReference for name in (*(f"y{i}" for i in range(samples.shape[1])), "u")]
    read = [slave.variables[name].valueReference for name in names]
    for k, (y, u) in enumerate(zip(samples, known, strict=True)):
        slave.fmu.setReal(inputs, [*y, u])
        slave.step(k * Ts, Ts)
        yield np.array(slave.fmu.getReal(read))


TEXTBOOK = {"tuning.gate": 1e9}  # measurements of no motion act all the same


def names_of(n: int) -> list[str]:
    return [
        *(f"estimate.x{i}" for i in range(n)),
        *(f"diagnostics.Q[{i + 1},{j + 1}]" for i in range(n) for j in range(n)),
    ]


SIZES = [2, 6, *(pytest.param(n, marks=pytest.mark.long) for n in range(1, LARGEST + 1) if n not in (2, 6))]


@pytest.mark.parametrize("n", SIZES)
def test_the_riccati_observers_fmu_is_the_sampled_kalman_filter(slave: Callable[..., Slave], n: int) -> None:
    rng, ny, Ts = np.random.default_rng(n), outputs_of(n), SAMPLE_TIME
    A, C = rng.normal(size=(n, n)) - np.eye(n), rng.normal(size=(ny, n))
    N = np.diag(rng.uniform(0.5, 2, n)) + 0.2 * rng.normal(size=(n, n))
    R = np.diag(rng.uniform(0.5, 2, ny)) + 0.2 * rng.normal(size=(ny, ny))
    root = rng.normal(size=(n, n))
    Q0, m0 = root @ root.T + np.eye(n), rng.normal(size=n)
    Q0 = (Q0 + Q0.T) / 2
    y, u = rng.normal(size=(60, ny)), rng.normal(size=60)
    guess = {f"guess.x{i}": value for i, value in enumerate(m0)}
    instance = slave(f"linear_{n}_riccati").initialize(
        {**entries(A, C), **guess, **design(N=N, R=R, Q0=Q0), **TEXTBOOK}
    )
    found = list(estimates(instance, names_of(n), y, u, Ts))
    expected = list(kalman(A, C, N, R, Q0, m0, y, u, Ts))
    np.testing.assert_allclose(found, expected, rtol=0, atol=6e-11)


def detectable(rng: np.random.Generator, n: int, ny: int) -> tuple[np.ndarray, np.ndarray]:
    """A, C with unstable modes that the outputs see, and stable ones that they do not, in random coordinates."""
    hidden = rng.integers(0, n)
    A = np.triu(rng.normal(size=(n, n)), 1)
    A[np.diag_indices(n)] = [*rng.uniform(-3, 2, n - hidden), *rng.uniform(-3, -0.1, hidden)]
    A[: n - hidden, n - hidden :] = 0
    C = rng.normal(size=(ny, n))
    C[:, n - hidden :] = 0
    T, _ = np.linalg.qr(rng.normal(size=(n, n)))
    return T @ A @ T.T, C @ T.T


@pytest.mark.parametrize(
    ("count", "sizes"),
    [(50, (2, 6)), pytest.param(1000, tuple(range(1, LARGEST + 1)), marks=pytest.mark.long)],
    ids=["50 systems", "1000 systems"],
)
def test_random_detectable_systems_keep_Q_symmetric_positive_definite_and_everything_finite(
    slave: Callable[..., Slave], count: int, sizes: tuple[int, ...]
) -> None:
    rng, instances = np.random.default_rng(count), {n: slave(f"linear_{n}_riccati") for n in sizes}
    for index in range(count):
        n = sizes[index % len(sizes)]
        instance, ny = instances[n], outputs_of(n)
        instance.fmu.reset()
        instance.initialize(entries(*detectable(rng, n, ny)))
        for values in estimates(instance, names_of(n), rng.normal(size=(20, ny)), np.zeros(20), SAMPLE_TIME):
            assert np.isfinite(values).all()
            Q = values[n:].reshape(n, n)
            assert np.array_equal(Q, Q.T)
            np.linalg.cholesky(Q)
        assert instance.get("diagnostics.solver_failures") == 0


@pytest.mark.parametrize(("T", "Ts"), [(0.5, 0.1), (1.0, 0.05), (0.1, 0.1)])
def test_the_least_squares_observers_fmu_keeps_the_contraction_identity_on_every_interval(
    slave: Callable[..., Slave], T: float, Ts: float
) -> None:
    """e+ = Phi Y^-1 e / p0 with Phi and Y by scipy's exponential, half weights at the interval's ends."""
    A = np.array([[0.1, 1.0, 0.0], [-1.0, -0.2, 0.5], [0.2, 0.0, -0.4]])
    C, gamma, p0, intervals = np.array([[1.0, 0.0, 0.3]]), 5.0, 0.4, 12
    count = round(T / Ts)
    steps = intervals * count + 1
    # The true state moves with the input held at 0.3: exact by one exponential.
    move = expm(Ts * np.block([[A, np.full((3, 1), 0.3)], [np.zeros((1, 4))]]))
    true = [np.array([1.0, -2.0, 0.5, 1.0])]
    for _ in range(steps):
        true.append(move @ true[-1])
    states = np.array(true)[:, :3]
    instance = slave("linear_3_least_squares").initialize(
        {**entries(A, C), "sample_time": Ts, "tuning.T": T, "tuning.gamma": gamma, "tuning.p0": p0, **TEXTBOOK}
    )
    found = estimates(instance, [f"estimate.x{i}" for i in range(3)], states[:-1] @ C.T, np.full(steps, 0.3), Ts)

    Y = np.eye(3) / p0
    for i in range(count + 1):
        w = expm(A * i * Ts).T @ C.T
        Y += gamma * Ts * (0.5 if i in (0, count) else 1.0) * w @ w.T
    factor = expm(A * T) @ np.linalg.inv(Y) / p0
    # An interval's begin is seen one sample later, once that sample has weighed half in the new interval.
    first = expm(A * Ts) @ np.linalg.inv(np.eye(3) / p0 + gamma * Ts / 2 * C.T @ C) / p0
    errors = [np.linalg.solve(first, value - states[k + 1]) for k, value in enumerate(found) if k % count == 0]
    np.testing.assert_allclose(errors[0], [-1.0, 2.0, -0.5], rtol=0, atol=9e-15)
    assert len(errors) == intervals + 1
    for before, after in pairwise(errors):
        np.testing.assert_allclose(after, factor @ before, rtol=0, atol=3e-14)
    assert instance.get("diagnostics.intervals") == intervals
    actual, certified = (instance.get(f"diagnostics.{name}") for name in ("contraction", "certified_contraction"))
    assert np.linalg.norm(factor, 2) * (1 - 1e-9) <= actual <= certified * (1 + 1e-3)


def test_samples_that_have_not_arrived_are_as_if_they_were_not_there_in_the_riccati_observers_fmu(
    slave: Callable[..., Slave],
) -> None:
    n, Ts, rng = 2, SAMPLE_TIME, np.random.default_rng(3)
    ny = outputs_of(n)
    A, C = rng.normal(size=(n, n)) - np.eye(n), rng.normal(size=(ny, n))
    y, u = rng.normal(size=(60, ny)), rng.normal(size=60)
    arrives = rng.random(y.shape) > 0.3
    arrives[20:25] = False
    instance = slave(f"linear_{n}_riccati").initialize(entries(A, C) | TEXTBOOK)
    found = []
    for k in range(len(u)):
        for i in range(ny):
            instance.set(f"y{i}", y[k, i] if arrives[k, i] else 1e6)
            instance.set(f"measurement_valid.y{i}", arrives[k, i])
        instance.set("u", u[k])
        instance.step(k * Ts, Ts)
        found.append([instance.get(name) for name in names_of(n)])
    there = np.where(arrives, y, np.nan)
    expected = list(kalman(A, C, np.eye(n), np.eye(ny), np.eye(n), np.zeros(n), there, u, Ts))
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-13)
    assert instance.get("diagnostics.rejected_samples") == 0
