"""Several disturbances: two measured states with one each, coupled and bent, against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from observers.elementary import elementary
from observers.instance import Instance
from observers.model import Model, Variable
from observers.status import CODE

S = 0.05  # [s]
MIGRATING = Model(
    name="migrating",
    description="Prey and predators, both counted; prey that comes by itself, and a gain of the predators that nobody knows",
    states=[Variable("prey", start=1.5), Variable("predators", start=0.8)],
    unknown_disturbances=[Variable("a"), Variable("b")],
    outputs=[Variable("y1"), Variable("y2")],
    ode=lambda x, u, p, t: [
        1.1 * x.prey - 0.9 * x.prey * x.predators + u.a,
        -1.2 * x.predators + 0.8 * x.prey * x.predators + u.b * x.prey,
    ],
    output=lambda x, u, p, t: [x.prey, x.predators],
)
WEIGHTS = {
    "q": {"prey": 10.0, "predators": 10.0},
    "r": {"prey": {"predators": 10.0, "a": 1e-6}, "predators": {"prey": 10.0, "b": 1e-6}},
}


def rates(t: float, x: np.ndarray, a: float, b: float) -> list[float]:
    return [1.1 * x[0] - 0.9 * x[0] * x[1] + a, -1.2 * x[1] + 0.8 * x[0] * x[1] + b * x[0]]


@pytest.mark.parametrize("N", [3, 21])
def test_two_measured_states_with_two_disturbances_are_found_where_the_equations_are_bent(N: int) -> None:
    forces, x = 0.3 * np.random.default_rng(0).normal(size=(80, 2)), np.array([1.5, 0.8])
    observer = Instance(elementary(MIGRATING, sample_time=S, N=N, K=40, **WEIGHTS), {"tuning.epsilon": 0.0})
    for k in range(80):
        for name, value in zip(("y1", "y2"), x, strict=True):
            observer.set(name, value)
        observer.step(S * k, S)
        found = [observer.get(f"filtered.{name}") for name in ("prey", "predators", "a", "b")]
        if k > N:
            np.testing.assert_allclose(found[:2], x, rtol=0, atol=1e-12)
            np.testing.assert_allclose(found[2:], forces[k - 1], rtol=0, atol=1e-6, err_msg=str(k))
            assert observer.get("diagnostics.visibility") > 1
            assert observer.get("diagnostics.status") != CODE.undetermined
        x = solve_ivp(rates, (0, S), x, args=tuple(forces[k]), method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
