"""An unknown parameter that wanders inside the window and is seen through a nonlinear output: against scipy's least squares."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import least_squares

from observers.instance import Instance
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral

TS, L, Q, NOISE = 0.1, 6, 0.9, {"y1": 0.2, "y2": 0.05}
MODEL = Model(
    name="gain",
    states=[Variable("a", start=1.0)],
    unknown_parameters=[Variable("d", start=0.3)],
    outputs=[Variable("y1"), Variable("y2")],
    ode=lambda x, u, p, t: [-0.5 * x.a],
    output=lambda x, u, p, t: [x.a, ca.exp(p.d) * x.a + p.d**2],
)


def smoothed(y: np.ndarray, segments: int) -> tuple[float, float]:
    """(a, d) at the last of the window's samples y (L + 1, 2): d jumps at the segments' ends, whose samples see it after the jump."""
    each = L // segments
    place = np.arange(L + 1) // each  # how many jumps a sample has behind it

    def residuals(unknown: np.ndarray) -> np.ndarray:
        a = unknown[0] * np.exp(-0.5 * TS * np.arange(L + 1))
        d = (unknown[1] + np.concatenate([[0.0], np.cumsum(unknown[2:])]))[place]
        seen = (y[:, 0] - a) / NOISE["y1"], (y[:, 1] - np.exp(d) * a - d**2) / NOISE["y2"]
        return np.concatenate([*seen, unknown[2:] / (Q * math.sqrt(each * TS))])

    found = least_squares(residuals, [1.0, 0.3, *np.zeros(segments)], xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    return found[0] * math.exp(-0.5 * TS * L), found[1:].sum()


@pytest.mark.parametrize("segments", [2, 3, 6])
def test_with_jumps_at_the_segments_ends_it_is_scipys_solution(segments: int) -> None:
    made = pseudospectral(
        MODEL, sample_time=TS, N=8, L=L, segments=segments, process_noise={"d": Q}, measurement_noise=NOISE
    )
    run, rng, rows = Instance(made, {"tuning.gate": 1e30}), np.random.default_rng(4), []
    for k in range(14):
        d, a = 0.3 + 0.5 * math.sin(1.5 * TS * k), math.exp(-0.5 * TS * k)
        rows.append([a + 0.2 * rng.normal(), math.exp(d) * a + d**2 + 0.05 * rng.normal()])
        for i in range(2):
            run.set(f"y{i + 1}", rows[-1][i])
        run.step(k * TS, TS)
        if k >= L:
            expected = smoothed(np.array(rows[k - L :]), segments)
            found = [run.get(f"filtered.{name}") for name in "ad"]
            np.testing.assert_allclose(found, expected, rtol=0, atol=5e-6)  # a step below which the iterations end
    assert run.get("diagnostics.solver_failures") == 0
