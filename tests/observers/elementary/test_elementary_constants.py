"""Unknown parameters as constant unknowns of the iterations: found where the window determines them, named where it does not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from observers.elementary import elementary
from observers.elementary.identifiability import describe as describe_null
from observers.elementary.problems import decompose, describe, with_constants
from observers.instance import Instance
from observers.model import Model, ModelError, Variable
from observers.status import CODE
from reference_models.duffing import DUFFING
from reference_models.lotka_volterra import LOTKA_VOLTERRA
from reference_models.rlc import RLC
from reference_models.van_der_pol import VAN_DER_POL_KNOWN

S = 0.05  # [s]
STIFF = replace(  # (5) with its 9 unknown, u and mu exact
    VAN_DER_POL_KNOWN,
    name="stiff",
    inputs=(),
    unknown_parameters=[Variable("stiffness", start=9.0, nominal=9.0)],
    ode=lambda x, u, p, t: [x.x2 + ca.sin(t), -p.stiffness * x.x1 + 0.1 * ca.sin(t) * (1 - x.x1**2) * x.x2],
)
OFFSET = Model(  # (4), (5) with mu = 0 and a constant v
    name="offset",
    states=[Variable("x1", start=0.5), Variable("x2", start=-0.3)],
    unknown_parameters=[Variable("v", start=0.2)],
    outputs=[Variable("y")],
    ode=lambda x, u, p, t: [x.x2 + p.v, -9 * x.x1],
    output=lambda x, u, p, t: [x.x1],
)


def followed(observer: Instance, inputs: Any, count: int, names: tuple[str, ...]) -> np.ndarray:
    """(count, len(names)): outputs after each sample, with the inputs (and y) that `inputs(t)` gives by name."""
    rows = []
    for k in range(count):
        for name, value in inputs(S * k).items():
            observer.set(name, float(value))
        observer.step(S * k, S)
        rows.append([observer.get(name) for name in names])
    return np.array(rows)


def test_a_rate_that_nobody_knows_is_found_beside_its_state() -> None:
    """x' = 1 - k x from 2: x = 1 / k + (2 - 1 / k) exp(-k t)."""
    model = Model(
        name="cooling",
        states=[Variable("x", start=2.0)],
        unknown_parameters=[Variable("k", start=0.2)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [1 - p.k * x.x],
        output=lambda x, u, p, t: [x.x],
    )
    observer = Instance(elementary(model, sample_time=S, N=41, K=20, q={"x": 10.0}, r={"x": {"k": 1e-2}}))
    found = followed(observer, lambda t: {"y": 2.5 - 0.5 * np.exp(-0.4 * t)}, 100, ("filtered.k", "diagnostics.status"))
    assert found[0, 0] == 0.2
    assert np.abs(found[45:, 0] - 0.4).max() < 1e-6
    assert set(found[45:, 1]) == {CODE.estimating}


def test_the_van_der_pol_systems_stiffness_is_found_with_its_hidden_state() -> None:
    def rates(t: float, x: np.ndarray) -> list[float]:
        return [x[1] + np.sin(t), -9 * x[0] + 0.1 * np.sin(t) * (1 - x[0] ** 2) * x[1]]

    truth = solve_ivp(rates, (0, 11), [0.5, -0.3], method="DOP853", rtol=1e-12, atol=1e-13, dense_output=True).sol
    weights: dict[str, Any] = {
        "q": {"x1": 10.0, "x2": 10.0},
        "r": {"x1": {"x2": 1e-3}, "x2": {"x1": 10.0, "stiffness": 1e-4}},
    }
    guess = {"x2": 0.0, "stiffness": 7.0}
    component = elementary(STIFF, sample_time=S, N=41, K=10, guess=guess, **weights)
    observer = Instance(component, {"tuning.epsilon": 1e-7})
    names = ("filtered.stiffness", "filtered.x2", "diagnostics.status", "estimate.stiffness")
    found = followed(observer, lambda t: {"y": truth(t)[0]}, 200, names)
    assert found[0, 0] == 7.0
    assert np.abs(found[60:, 0] - 9).max() < 1e-4
    assert np.abs(found[60:, 1] - truth(S * np.arange(60, 200))[1]).max() < 1e-5
    assert set(found[60:, 2]) == {CODE.estimating}
    np.testing.assert_array_equal(found[:, 3], found[:, 0])


def test_the_four_rates_of_prey_and_predators_are_found_where_both_are_counted() -> None:
    def rates(t: float, x: np.ndarray) -> list[float]:
        return [1.1 * x[0] - 0.9 * x[0] * x[1], -1.2 * x[1] + 0.8 * x[0] * x[1]]

    truth = solve_ivp(rates, (0, 13), [1.5, 0.8], method="DOP853", rtol=1e-12, atol=1e-13, dense_output=True).sol
    names = ("birth", "loss", "death", "gain")
    r = {
        "prey": {"predators": 10.0, "birth": 1e-2, "loss": 1e-2},
        "predators": {"prey": 10.0, "death": 1e-2, "gain": 1e-2},
    }
    q, guess = {"prey": 10.0, "predators": 10.0}, dict.fromkeys(names, 1.0)
    component = elementary(LOTKA_VOLTERRA, sample_time=0.1, N=61, K=20, q=q, r=r, guess=guess)
    observer = Instance(component, {"tuning.epsilon": 1e-7})
    for k in range(121):
        for name, value in zip(("y1", "y2"), truth(0.1 * k), strict=True):
            observer.set(name, value)
        observer.step(0.1 * k, 0.1)
    found = [observer.get(f"filtered.{name}") for name in names]
    np.testing.assert_allclose(found, [1.1, 0.9, 1.2, 0.8], rtol=0, atol=1e-4)
    assert observer.get("diagnostics.status") == CODE.estimating and observer.get("diagnostics.contraction") > 0.9


def test_a_constant_that_the_window_does_not_determine_is_named_and_is_none_in_truth() -> None:
    """y is the same for x2 + c, v - c: by scipy, without the observer."""

    def seen(c: float) -> np.ndarray:
        start, times = [0.5, -0.3 + c], S * np.arange(80)
        found = solve_ivp(lambda t, x: [x[1] + 0.2 - c, -9 * x[0]], (0, 4), start, rtol=1e-12, atol=1e-13, t_eval=times)
        return np.asarray(found.y[0])

    y = seen(0.0)
    np.testing.assert_allclose(seen(0.4), y, rtol=0, atol=1e-10)
    assert describe_null(with_constants(OFFSET), 41, S) == "x2 + c, v - c"
    observer = Instance(elementary(OFFSET, sample_time=S, N=41, guess={"v": 0.0}))
    found = followed(
        observer,
        lambda t: {"y": y[round(t / S)]},
        80,
        ("diagnostics.status", "diagnostics.null.v", "diagnostics.null.x2", "diagnostics.visibility"),
    )
    assert set(found[45:, 0]) == {CODE.undetermined} and found[45:, 3].max() < 1e-4
    np.testing.assert_allclose(found[45:, 1], -found[45:, 2], rtol=1e-3)


def test_a_constants_problem_is_said_to_have_no_controls() -> None:
    model = with_constants(STIFF)
    assert describe(model, decompose(model, {})) == [
        "x1: controls x2; follows y; solved by lq, as its equation is affine",
        "x2: controls x1, stiffness; follows the last iterate of x2; solved by gauss_newton, as its equation is smooth",
        "stiffness: controls none; follows the last iterate of stiffness; solved by lq, as its equation is affine",
    ]
    assert with_constants(VAN_DER_POL_KNOWN) is VAN_DER_POL_KNOWN


def test_a_constant_that_no_output_ever_sees_and_algebraic_variables_are_refused() -> None:
    unseen = replace(OFFSET, ode=lambda x, u, p, t: [x.x2, -9 * x.x1])
    with pytest.raises(ModelError, match="no output ever sees v"):
        elementary(unseen, sample_time=S, N=11)
    with pytest.raises(ModelError, match="algebraic variables"):
        elementary(RLC, sample_time=S, N=11)
    with pytest.raises(ValueError, match="different variables"):
        elementary(
            DUFFING,
            sample_time=S,
            N=11,
            first_guess=replace(
                DUFFING, unknown_parameters=[Variable("theta2")], ode=lambda x, u, p, t: [x.x2, p.theta2]
            ),
        )
