"""Chen & Yen's claim of observability indices that vary, two outputs: through the built FMUs, against scipy."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from build_fmus import FMUS
from cosim.results import Result
from observers.instance import Instance

T, GAMMA, P0, STOP = 4.0, 200.0, 1.0, 40.0
C = np.array([[1.0, 0, 0, 0], [0, 0, 0, 1.0]])
NAME = "chen_yen_alternating"


def A(t: float, coupling: Callable[[float], float] = lambda s: max(s, 0.0) ** 3) -> np.ndarray:
    s = math.sin(t)
    return np.array([[-1, coupling(s), 0, 0], [0, 0, 1, 0], [0, -1, 0.1, 0], [0, coupling(-s), 0, -1]])


def gap(result: Result) -> np.ndarray:
    """Estimate minus truth (4, rows)."""
    return np.array([result[f"observer.estimate.x{i}"] - result[f"plant.x.x{i}"] for i in (1, 2, 3, 4)])


def indices(t: float) -> tuple[int, int]:
    """Of the outputs: rows of the observability matrix, c_i first, then its derivatives q' + q A, that are new; the products by hand.

    With a = max(s, 0)^3, b = max(-s, 0)^3: c_1, -c_1 + a e_2, c_1 + (a' - a) e_2 + a e_3; c_2 likewise with b.
    """
    s, c = math.sin(t), math.cos(t)
    rows = []
    for sign, k in ((1, 0), (-1, 3)):
        a, da = max(sign * s, 0.0) ** 3, 3 * max(sign * s, 0.0) ** 2 * sign * c
        lag = np.eye(4)[k]
        rows.append([lag, -lag + a * np.eye(4)[1], lag + (da - a) * np.eye(4)[1] + a * np.eye(4)[2]])
    kept: list[np.ndarray] = []
    count = [0, 0]
    for order in range(3):
        for output in (0, 1):
            if np.linalg.matrix_rank([*kept, rows[output][order]]) > len(kept):
                kept.append(rows[output][order])
                count[output] += 1
    return count[0], count[1]


def test_the_observability_indices_of_the_two_outputs_change_places() -> None:
    assert [indices(t) for t in (1.0, 2.5, 4.0, 5.5, 7.0)] == [(3, 1), (3, 1), (1, 3), (1, 3), (3, 1)]
    assert indices(0.0) == (1, 1)


def continuous() -> tuple[np.ndarray, np.ndarray]:
    """Errors of the paper's observer (8), (11) to (15) at each reset, and the theorem's factor of each interval, by scipy."""

    def rhs(t: float, z: np.ndarray) -> np.ndarray:
        e, Phi, P = z[:4], z[4:20].reshape(4, 4), z[20:36].reshape(4, 4)
        w = Phi.T @ C.T
        rates = A(t) @ Phi, -GAMMA * P @ w @ w.T @ P, w @ w.T
        return np.concatenate([A(t) @ e - GAMMA * Phi @ P @ w @ (C @ e), *(M.ravel() for M in rates)])

    e, errors, factors = np.array([-1.0, -2.0, 1.0, 1.0]), [], []
    for start in np.arange(0, STOP, T):
        z = np.concatenate([e, np.eye(4).ravel(), P0 * np.eye(4).ravel(), np.zeros(16)])
        z = solve_ivp(rhs, (start, start + T), z, method="DOP853", rtol=1e-11, atol=1e-14).y[:, -1]
        e = z[:4]
        errors.append(e)
        Phi, W = z[4:20].reshape(4, 4), z[36:].reshape(4, 4)
        factors.append(np.linalg.norm(Phi, 2) / (1 + GAMMA * P0 * np.linalg.eigvalsh(W)[0]))
    return np.array(errors), np.array(factors)


def test_the_observer_converges_as_the_papers_continuous_one_and_every_interval_is_certified(
    example: Callable[..., Result],
) -> None:
    result = example(NAME)
    errors, factors = continuous()
    rows = np.rint(np.arange(T, STOP + T / 2, T) / 0.01).astype(int)
    found = gap(result)[:, rows].T
    # The sample at the interval's end is still to come, hence of first order in Ts.
    for one, expected in zip(found, errors, strict=True):
        np.testing.assert_allclose(one, expected, rtol=0, atol=0.05 * np.linalg.norm(expected))
    assert np.linalg.norm(found[-1]) < 1e-5 * np.linalg.norm(found[0])
    assert factors.max() < 1
    shown = result["observer.diagnostics.certified_contraction"][rows[:-1] + 1]
    np.testing.assert_allclose(shown, factors[:-1], rtol=0, atol=0.02)
    actual = result["observer.diagnostics.contraction"][rows[:-1] + 1]
    assert np.all(actual <= shown * (1 + 1e-3))
    assert set(result["observer.diagnostics.intervals"]) == set(range(len(factors)))


def test_the_python_face_and_the_fmu_agree_over_the_whole_run(example: Callable[..., Result]) -> None:
    result, observer = example(NAME), Instance(FMUS["alternating_least_squares"][0]())
    outputs = [port.name for port in observer.component.outputs if f"observer.{port.name}" in result.names]
    for k in range(len(result.time) - 1):
        for y in ("y1", "y2"):
            observer.set(y, result[f"plant.{y}"][k])
        observer.step(result.time[k], result.step)
        expected = [result[f"observer.{name}"][k + 1] for name in outputs]
        np.testing.assert_array_equal([observer.get(name) for name in outputs], expected)
