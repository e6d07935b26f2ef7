"""What the observer says of its window, against the collocation and the least squares of a linear model in numpy."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from numpy.polynomial import legendre
from scipy.linalg import expm

from observers.component import Component
from observers.instance import Instance
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral
from observers.status import CODE

TS, NOISE, L, N = 0.2, 0.3, 6, 5
A, C = np.array([[-1.0, 2.0], [-3.0, -0.5]]), np.array([1.0, 0.5])
NOMINAL, NOMINAL_Y = np.array([2.0, 0.5]), 4.0
OSCILLATOR = Model(
    name="oscillator",
    states=[Variable("a", nominal=2.0), Variable("b", nominal=0.5)],
    outputs=[Variable("y", nominal=NOMINAL_Y)],
    ode=lambda x, u, p, t: [-x.a + 2 * x.b, -3 * x.a - 0.5 * x.b],
    output=lambda x, u, p, t: [x.a + 0.5 * x.b],
)


class Segment:
    """The polynomials of degree N with a given value at node 0 that satisfy x' = A x at the other Legendre-Gauss-Lobatto nodes of [-1, 1],
    over `samples` sample intervals: at the samples, and the residual of the equation at node 0; both linear in that value."""

    def __init__(self, samples: int):
        inner = legendre.Legendre.basis(N).deriv().roots()
        nodes = np.concatenate([[-1.0], np.sort(inner), [1.0]])
        vandermonde = legendre.legvander(nodes, N)
        slopes = np.array([legendre.legval(nodes, legendre.legder(row)) for row in np.eye(N + 1)]).T
        D = np.kron(slopes @ np.linalg.inv(vandermonde), np.eye(2)) - np.kron(np.eye(N + 1), A * TS * samples / 2)
        values = np.vstack([np.eye(2), -np.linalg.solve(D[2:, 2:], D[2:, :2])])
        self.node0 = D[:2] @ values
        times = np.linspace(-1, 1, samples + 1)
        at = np.kron(legendre.legvander(times, N) @ np.linalg.inv(vandermonde), np.eye(2)) @ values
        self.at = [at[2 * i : 2 * i + 2] for i in range(samples + 1)]


SEGMENTS = {count: Segment(L // count) for count in (1, 2, 3)}


def expected(ys: np.ndarray, there: np.ndarray, k: int, segments: int, noise: float | None) -> dict[str, float] | None:
    """What the least squares of the samples in the window at k give; None where they are too few, or the last is missing."""
    one, each = SEGMENTS[segments], L // segments
    to_sample = list(one.at)
    for _ in range(segments - 1):
        end = to_sample[-1]
        to_sample += [M @ end for M in one.at[1:]]
    window = slice(max(0, k - L), k + 1)
    place, valid = min(k, L), there[window]
    if valid.sum() < 3 or not valid[-1]:
        return None
    rows, y = np.array([C @ M for M in to_sample[: place + 1]])[valid], ys[window][valid]
    x0 = np.linalg.lstsq(rows, y, rcond=None)[0]
    pivots = np.diag(np.linalg.cholesky((rows * NOMINAL).T @ (rows * NOMINAL))) ** 2
    variances = np.diag(to_sample[place] @ np.linalg.inv(rows.T @ rows) @ to_sample[place].T)
    begun = [j * each for j in range(segments) if j == 0 or place > j * each]
    squares = np.sum((y - rows @ x0) ** 2) / (noise or NOMINAL_Y) ** 2
    found = dict(zip(("filtered.a", "filtered.b"), to_sample[place] @ x0, strict=True))
    return found | {
        "diagnostics.cost": TS * squares,
        "diagnostics.conditioning": pivots.min() / pivots.max(),
        "diagnostics.deviation": (noise or 1) * (np.sqrt(variances) / NOMINAL).max(),
        "diagnostics.node0_residual": max(np.abs(one.node0 @ to_sample[i] @ x0 / NOMINAL).max() for i in begun),
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
    run, rng, compared = Instance(made(segments, noise), {"tuning.gate": 1e30}), np.random.default_rng(6), 0
    ys, there = rng.normal(size=30), rng.random(30) >= missing
    for k in range(30):
        run.set("y", ys[k])
        run.set("measurement_valid.y", there[k])
        run.step(k * TS, TS)
        for name, value in (expected(ys, there, k, segments, noise) or {}).items():
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
    x = np.array([expm(A * TS * k) @ [3.0, 1.0] for k in range(30)])
    ys, there = x @ C + NOISE * np.random.default_rng(2).normal(size=30), np.ones(30, bool)
    value = (expected(ys, there, 29, 1, NOISE) or {})[name]
    wide = {"tuning.collocation_limit": 1e3, "tuning.deviation_limit": 1e3}
    run = Instance(made(1, NOISE), wide | {f"tuning.{limit}": part * value})
    for k in range(30):
        run.set("y", ys[k])
        run.step(k * TS, TS)
    assert run.get("diagnostics.status") == (code if (part < 1) == above else CODE.estimating)
