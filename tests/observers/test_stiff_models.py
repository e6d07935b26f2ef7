"""A nonlinear model that is stiff, with every step at its default: the prediction is the model's."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from observers.canonical_dae import canonical_dae
from observers.component import Component
from observers.elementary import elementary
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
    "exponential": lambda: riccati(STIFF, sample_time=TS, stiff=True),
    "least_squares": lambda: least_squares(STIFF, sample_time=TS, T=2.0, linearise=True),
    "pseudospectral": lambda: pseudospectral(STIFF, sample_time=TS, N=6, L=8),
    "canonical_dae": lambda: canonical_dae(STIFF, sample_time=TS),
    "elementary": lambda: elementary(STIFF, sample_time=TS, N=8, K=3),
}
ITERATIVE = ("elementary",)  # of three iterations a sample: says so
THROUGH = ("riccati", "exponential", "least_squares")  # whose estimate does not lose the state in the jump
SLOW, SAMPLES = (
    600,
    1000,
)  # samples on the slow branch, on which the fast rate is about -300 1/s; at 81 s x jumps to the other one


def exact(x: float, v: float = 0.0) -> np.ndarray:
    """x at 0, Ts, ..."""
    rhs = lambda t, z: [z[1], MU * (1 - z[0] ** 2) * z[1] - z[0]]  # noqa: E731
    end = SAMPLES * TS
    found = solve_ivp(rhs, (0, end), [x, v], "Radau", np.arange(SAMPLES + 1) * TS, rtol=1e-10, atol=1e-12)
    assert found.success
    return np.asarray(found.y[0])


@pytest.fixture(scope="module")
def truth() -> np.ndarray:
    return exact(2.0)


@pytest.mark.parametrize("start", [(2.0, 0.0), (0.5, 0.0), (0.01, 0.0), (0.0, 1.0)])
def test_the_plant_is_the_model_wherever_it_starts(start: tuple[float, float]) -> None:
    x, v = start
    states = [Variable("x", start=x), Variable("v", start=v)]
    run = Instance(plant(Model(STIFF.name, states, STIFF.outputs, STIFF.ode, STIFF.output)))
    expected = exact(x, v)
    for k in range(SAMPLES):
        run.step(k * TS, TS)
        assert abs(run.get("x.x") - expected[k + 1]) < 2e-6, k


@pytest.mark.parametrize("kind", OBSERVERS)
def test_the_observers_estimate_is_near_the_truth_or_not_trusted(kind: str, truth: np.ndarray) -> None:
    """Which of two branches x is on is seen with the next sample only: within the jump, an estimate may miss it."""
    run = Instance(OBSERVERS[kind](), {"guess.x": 1.5})
    errors, trusted = [], []
    for k in range(SAMPLES):
        run.set("y", truth[k])
        run.step(k * TS, TS)
        errors.append(abs(run.get("estimate.x") - truth[k + 1]))
        trusted.append(run.get("diagnostics.trusted"))
    off = np.array(errors[100:])
    if kind not in ITERATIVE:
        assert off[: SLOW - 100].max() < 1e-2
    if kind in THROUGH:
        assert off.max() < 1e-2
    assert not np.any((off > 0.5) & (np.array(trusted[100:]) != 0)), np.flatnonzero(off > 0.5) + 100


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
