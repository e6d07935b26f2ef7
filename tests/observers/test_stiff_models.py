"""A nonlinear model that is stiff, with every step at its default: the prediction is the model's."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from observers.component import Component
from observers.instance import Instance
from observers.least_squares import least_squares
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral
from observers.riccati import riccati
from observers.ukf import ukf
from reference_models.plant import plant

MU, TS = 100.0, 0.1
STIFF = Model(
    name="van_der_pol_100",
    states=[Variable("x", start=2.0), Variable("v", start=0.0)],
    outputs=[Variable("y")],
    ode=lambda x, u, p, t: [x.v, MU * (1 - x.x**2) * x.v - x.x],
    output=lambda x, u, p, t: [x.x],
)
OBSERVERS: dict[str, Callable[[], Component]] = {
    "ukf": lambda: ukf(STIFF, sample_time=TS),
    "riccati": lambda: riccati(STIFF, sample_time=TS),
    "least_squares": lambda: least_squares(STIFF, sample_time=TS, T=2.0, linearise=True),
    "pseudospectral": lambda: pseudospectral(STIFF, sample_time=TS, N=6, L=8),
}


@pytest.fixture(scope="module")
def truth() -> np.ndarray:
    """x at 0, Ts, ... up to 60 s: the slow branch, on which the fast rate is about -300 1/s."""
    times = np.arange(601) * TS
    rhs = lambda t, z: [z[1], MU * (1 - z[0] ** 2) * z[1] - z[0]]  # noqa: E731
    found = solve_ivp(rhs, (0, 60), [2.0, 0.0], "Radau", times, rtol=1e-9, atol=1e-12)
    assert found.success
    return found.y


def test_the_plant_is_the_model(truth: np.ndarray) -> None:
    run = Instance(plant(STIFF))
    for k in range(600):
        run.step(k * TS, TS)
        assert abs(run.get("x.x") - truth[0, k + 1]) < 1e-6


@pytest.mark.parametrize("kind", OBSERVERS)
def test_the_observers_estimate_is_near_the_truth(kind: str, truth: np.ndarray) -> None:
    run = Instance(OBSERVERS[kind](), {"guess.x": 1.5})
    largest = 0.0
    for k in range(600):
        run.set("y", truth[0, k])
        run.step(k * TS, TS)
        if k >= 100:
            largest = max(largest, abs(run.get("estimate.x") - truth[0, k + 1]))
    assert largest < 1e-2, largest


def test_a_plant_that_is_stiffer_than_its_steps_says_which_argument_to_lower() -> None:
    """At its start values the model is slow; where it goes it is not."""
    model = Model(
        name="late",
        states=[Variable("x", start=1.0, nominal=0.1)],
        inputs=[Variable("u")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [u.u - x.x**9],
        output=lambda x, u, p, t: [x.x],
    )
    run = Instance(plant(model))
    run.set("u", 1e6)
    with pytest.raises(ValueError, match=r"late: the state is not finite .* smaller max_step than 0\.\d+"):
        for k in range(100):
            run.step(TS * k, TS)
