"""What the observer says of its window, against the collocation and the least squares of a linear model in numpy."""

from __future__ import annotations

import functools
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.polynomial import legendre
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from observers.component import Component
from observers.instance import Instance
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral
from observers.status import CODE

T0, TS, NOISE, L, N = 2.7, 0.2, 0.3, 6, 5
A, C = np.array([[-1.0, 2.0], [-3.0, -0.5]]), np.array([1.0, 0.5])
NOMINAL, NOMINAL_Y = np.array([2.0, 0.5]), 4.0
OSCILLATOR = Model(
    name="oscillator",
    states=[Variable("a", nominal=2.0), Variable("b", nominal=0.5)],
    outputs=[Variable("y", nominal=NOMINAL_Y)],
    ode=lambda x, u, p, t: [-x.a + 2 * x.b, -3 * x.a - 0.5 * x.b + ca.sin(1.7 * t)],
    output=lambda x, u, p, t: [x.a + 0.5 * x.b],
)


def segment(start: float, samples: int) -> tuple[list[np.ndarray], np.ndarray]:
    """The polynomial of degree N that satisfies x' = A x + g(t) at the Legendre-Gauss-Lobatto nodes of [-1, 1] but the first, over
    `samples` sample intervals: its values at the samples, and the residual of the equation at node 0, as matrices (2 x 3) that act on its
    value at node 0 and 1."""
    inner = legendre.Legendre.basis(N).deriv().roots()
    nodes, half = np.concatenate([[-1.0], np.sort(inner), [1.0]]), TS * samples / 2
    vandermonde = legendre.legvander(nodes, N)
    slopes = np.array([legendre.legval(nodes, legendre.legder(row)) for row in np.eye(N + 1)]).T
    D = np.kron(slopes @ np.linalg.inv(vandermonde), np.eye(2)) - np.kron(np.eye(N + 1), A * half)
    g = half * np.kron(np.sin(1.7 * (start + half * (nodes + 1))), [0, 1])
    left, right = np.eye(2, 3), -D[2:, :2] @ np.eye(2, 3)
    right[:, 2] += g[2:]
    values = np.vstack([left, np.linalg.solve(D[2:, 2:], right)])
    node0 = D[:2] @ values
    node0[:, 2] -= g[:2]
    at = (
        np.kron(legendre.legvander(np.linspace(-1, 1, samples + 1), N) @ np.linalg.inv(vandermonde), np.eye(2)) @ values
    )
    return [at[2 * i : 2 * i + 2] for i in range(samples + 1)], node0


def deviation(covariance: np.ndarray) -> float:
    """Of the least certain state, in nominal values."""
    return float((np.sqrt(np.diag(covariance)) / NOMINAL).max())


def expected(ys: np.ndarray, there: np.ndarray, k: int, segments: int, noise: float | None) -> dict[str, Any] | None:
    """What the least squares of the samples in the window at k give; None where they are too few, or the last is missing."""
    each, to_sample, residuals = L // segments, [np.eye(2, 3)], []
    for j in range(segments):
        at, node0 = segment(T0 + TS * (max(0, k - L) + j * each), each)
        begin = np.vstack([to_sample[-1], [0, 0, 1]])
        to_sample += [M @ begin for M in at[1:]]
        residuals.append(node0 @ begin)
    window = slice(max(0, k - L), k + 1)
    place, valid = min(k, L), there[window]
    if valid.sum() < 3 or not valid[-1]:
        return None
    rows = np.array([C @ M for M in to_sample[: place + 1]])[valid]
    rows, y = rows[:, :2], ys[window][valid] - rows[:, 2]
    x0 = np.linalg.lstsq(rows, y, rcond=None)[0]
    pivots = np.diag(np.linalg.cholesky((rows * NOMINAL).T @ (rows * NOMINAL))) ** 2
    covariance = to_sample[place][:, :2] @ np.linalg.inv(rows.T @ rows) @ to_sample[place][:, :2].T
    begun = [j for j in range(segments) if j == 0 or place > j * each]
    squares = np.sum((y - rows @ x0) ** 2) / (noise or NOMINAL_Y) ** 2
    start = [*x0, 1]
    found = dict(zip(("filtered.a", "filtered.b"), to_sample[place] @ start, strict=True))
    return found | {
        "diagnostics.cost": TS * squares,
        "diagnostics.conditioning": pivots.min() / pivots.max(),
        "diagnostics.deviation": (noise or 1) * deviation(covariance),
        "covariance": covariance,
        "diagnostics.node0_residual": max(np.abs(residuals[j] @ start / NOMINAL).max() for j in begun),
        "rms": np.sqrt(squares / len(y)),
    }


@functools.cache
def made(segments: int, noise: float | None) -> Component:
    given = None if noise is None else {"y": noise}
    return pseudospectral(OSCILLATOR, sample_time=TS, N=N, L=L, segments=segments, measurement_noise=given)


@pytest.mark.parametrize(("segments", "noise"), [(1, NOISE), (2, NOISE), (3, None)])
@pytest.mark.parametrize("missing", [0.0, 0.25])
def test_every_diagnostic_is_that_of_the_least_squares_solution(
    segments: int, noise: float | None, missing: float
) -> None:
    """While the window grows too, where its last sample is not its end."""
    run, rng, compared = Instance(made(segments, noise), {"tuning.gate": 1e30}, t0=T0), np.random.default_rng(6), 0
    ys, there, covariance = rng.normal(size=30), rng.random(30) >= missing, np.eye(2)
    for k in range(30):
        run.set("y", ys[k])
        run.set("measurement_valid.y", there[k])
        run.step(T0 + k * TS, TS)
        found = expected(ys, there, k, segments, noise)
        if found is None:
            if noise and compared and not there[k]:  # moved on from the last fit by the model, not the polynomial
                covariance = expm(A * TS) @ covariance @ expm(A * TS).T
                assert run.get("diagnostics.deviation") == pytest.approx(noise * deviation(covariance), rel=5e-4), k
            continue
        covariance = found.pop("covariance")
        for name, value in found.items():
            if name != "rms" and (noise or name != "diagnostics.deviation"):  # which is in the scale of what was learnt
                assert run.get(name) == pytest.approx(value, rel=1e-10, abs=1e-13), (k, name)
                compared += 1
    assert compared > 80


LIMITS = {
    "collocation_limit": ("diagnostics.node0_residual", CODE.coarse_collocation, True),
    "deviation_limit": ("diagnostics.deviation", CODE.uncertain, True),
    "residual_limit": ("rms", CODE.inconsistent, True),
    "conditioning_limit": ("diagnostics.conditioning", CODE.undetermined, False),
}


@pytest.mark.parametrize("limit", LIMITS)
@pytest.mark.parametrize("part", [0.999, 1.001])
def test_the_status_says_where_a_diagnostic_is_beyond_its_limit(limit: str, part: float) -> None:
    name, code, above = LIMITS[limit]
    true = solve_ivp(
        lambda t, x: A @ x + [0, np.sin(1.7 * t)], (T0, T0 + 30 * TS), [3.0, 1.0], rtol=1e-8, dense_output=True
    )
    ys, there = (
        C @ true.sol(T0 + TS * np.arange(30)) + NOISE * np.random.default_rng(2).normal(size=30),
        np.ones(30, bool),
    )
    value = (expected(ys, there, 29, 1, NOISE) or {})[name]
    wide = {"tuning.collocation_limit": 1e3, "tuning.deviation_limit": 1e3}
    run = Instance(made(1, NOISE), wide | {f"tuning.{limit}": part * value}, t0=T0)
    for k in range(30):
        run.set("y", ys[k])
        run.step(T0 + k * TS, TS)
    assert run.get("diagnostics.status") == (code if (part < 1) == above else CODE.estimating)
