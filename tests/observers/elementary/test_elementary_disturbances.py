"""Disturbances: two measured states with one each, coupled and bent; and in the outputs, y = h(x, delta); against scipy."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import fmpy
import fmpy.validation
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh, expm
from scipy.optimize import lsq_linear

from fmu_src import export
from observers.elementary import elementary
from observers.elementary.identifiability import describe as describe_null
from observers.elementary.identifiability import least_visible
from observers.elementary.output_problem import output_problems, solution
from observers.elementary.problems import decompose, describe
from observers.instance import Instance
from observers.model import Model, Variable
from observers.status import CODE
from once import compiled_once, plotted_briefly
from slave import Slave

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


A = np.array([[0.0, 1.0], [-4.0, -0.3]])
OSCILLATOR: dict[str, Any] = {
    "states": [Variable("x1", start=1.0), Variable("x2")],
    "unknown_disturbances": [Variable("w", nominal=0.5)],
}
PUSHED = Model(
    name="pushed",
    description="A spring pushed by a force that nobody measures, with an accelerometer that feels it",
    outputs=[Variable("place"), Variable("acceleration", nominal=4.0)],
    ode=lambda x, u, p, t: [x.x2, -4 * x.x1 - 0.3 * x.x2 + u.w],
    output=lambda x, u, p, t: [x.x1, -4 * x.x1 - 0.3 * x.x2 + u.w],
    **OSCILLATOR,
)
DRIFTING = Model(
    name="drifting",
    description="A spring seen by two sensors, one of which drifts",
    outputs=[Variable("drifts"), Variable("place")],
    ode=lambda x, u, p, t: [x.x2, -4 * x.x1 - 0.3 * x.x2],
    output=lambda x, u, p, t: [x.x1 + u.w, x.x1],
    **OSCILLATOR,
)
ALONE = Model(
    name="alone",
    description="A spring seen by a sensor that drifts",
    outputs=[Variable("drifts")],
    ode=DRIFTING.ode,
    output=lambda x, u, p, t: [x.x1 + u.w],
    **OSCILLATOR,
)


def followed(model: Model, pushed: bool, q: float, missing: tuple[int, ...] = ()) -> list[np.ndarray]:
    """Errors of x1, x2 and w at each of 100 samples, whose w is normal noise of 0.5 on each interval; closed form by expm."""
    seen = model.outputs[0 if model is DRIFTING else 1].name
    observer = Instance(
        elementary(
            model,
            sample_time=S,
            N=21,
            K=40,
            q={"x1": 10.0, "x2": q},
            r={"x1": {"x2": 1e-3}, "x2": {"x1": 10.0, **({"w": 1e-3} if pushed else {})}, seen: {"w": 1e-3}},
            guess={"x2": 1.0},
        ),
        {"tuning.epsilon": 1e-9},
    )
    forced = np.zeros((3, 3))  # of (x1, x2, w), w constant over an interval
    forced[:2, :2], forced[1, 2] = A, float(pushed)
    step = expm(S * forced)
    x, w, errors, output = np.array([1.0, 0.0]), 0.0, [], model.equations.output
    h = ca.Function("h", [model.equations.x, model.equations.w], [output])
    for k, force in enumerate(0.5 * np.random.default_rng(0).normal(size=100)):
        for variable, y in zip(model.outputs, h(x, w).full().ravel(), strict=True):
            observer.set(variable.name, math.nan if k in missing and variable.name == seen else y)
        observer.step(S * k, S)
        errors.append([observer.get(f"filtered.{name}") for name in ("x1", "x2", "w")] - np.append(x, w))
        if k > 22:
            accepted = [CODE.sample_rejected] if k in missing else [CODE.estimating]
            assert observer.get("diagnostics.status") in accepted, k
        w = force
        x = (step @ np.append(x, w))[:2]
    return errors


def test_a_force_that_an_accelerometer_feels_is_found_with_the_velocity() -> None:
    errors = np.abs(followed(PUSHED, True, 1e-3))
    assert errors[0, 1] > 0.9
    np.testing.assert_allclose(errors[22:, :2], 0, rtol=0, atol=2e-6)
    np.testing.assert_allclose(errors[22:, 2], 0, rtol=0, atol=2e-6)


def test_the_drift_of_one_of_two_sensors_is_found_and_a_missing_sample_is_none() -> None:
    errors = np.abs(followed(DRIFTING, False, 1e-3, missing=(50,)))
    there = np.arange(100) != 50
    np.testing.assert_allclose(errors[22:, :2], 0, rtol=0, atol=2e-6)
    np.testing.assert_allclose(errors[there][22:, 2], 0, rtol=0, atol=1e-5)


def test_a_drift_of_the_only_sensor_is_not_determined_and_hides_any_motion_in_truth() -> None:
    start, c = np.array([1.0, 0.0]), np.array([0.3, -0.2])
    moved, shifted, motion = (np.array([(expm(A * S * i) @ x)[0] for i in range(21)]) for x in (start, start + c, c))
    w = 0.1 - motion  # of any spring, taken off by the drift
    np.testing.assert_allclose(shifted + w, moved + 0.1, rtol=0, atol=1e-14)
    assert "w - c" in describe_null(ALONE, 21, S)
    observer = Instance(elementary(ALONE, sample_time=S, N=21, q={"x2": 1e-3}, r={"drifts": {"w": 10.0}}))
    for k in range(40):
        observer.set("drifts", 0.1 + (expm(A * S * k) @ [1.0, 0.0])[0])
        observer.step(S * k, S)
    assert observer.get("diagnostics.status") == CODE.undetermined and observer.get("diagnostics.visibility") < 1e-4


def test_an_outputs_problem_is_bounded_least_squares() -> None:
    """Two disturbances in one output, with bounds, against scipy's lsq_linear."""
    model = Model(
        name="two",
        states=[Variable("a")],
        unknown_disturbances=[Variable("v", min=-0.5, max=1.0), Variable("w", min=0.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-x.a],
        output=lambda x, u, p, t: [x.a + 2 * u.v - u.w],
    )
    (problem,) = output_problems(model)
    solve, rng = solution(model, problem), np.random.default_rng(2)
    for _ in range(40):
        y, x, q, r = rng.normal(scale=3), rng.normal(), *(10.0 ** rng.uniform(-3, 2, 2))
        reference, weights = rng.uniform([-0.5, 0], [1, 2]), np.array([r, 3 * r])
        found = solve(x, reference, y, 1, [], [], 0, q, weights).full().ravel()
        rows = np.vstack([np.sqrt(q) * np.array([[2.0, -1.0]]), np.diag(np.sqrt(weights))])
        target = np.concatenate([[np.sqrt(q) * (y - x)], np.sqrt(weights) * reference])
        expected = lsq_linear(rows, target, ([-0.5, 0], [1, np.inf]), tol=1e-14).x
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
        np.testing.assert_array_equal(solve(x, reference, y, 0, [], [], 0, q, weights).full().ravel(), reference)


def test_the_visibility_with_a_disturbance_in_an_output_is_that_of_dense_least_squares() -> None:
    """The least change of all outputs by a motion of the end, with the disturbances chosen by numpy; midpoint rule as the observer's."""
    N, half = 21, S / 2
    Phi = np.linalg.solve(np.eye(2) - half * A, np.eye(2) + half * A)
    Gamma = np.linalg.solve(np.eye(2) - half * A, [0.0, S])
    C, D = np.array([[1.0, 0.0], A[1] / 4]), np.array([0.0, 0.25])  # over nominal values: 1 and 4
    to_state, to_force = [np.eye(2)], [np.zeros((2, N - 1))]
    rows_state, rows_force = [C[:1]], [np.zeros((1, N - 1))]  # of the first sample the output without the disturbance
    for i in range(N - 1):
        unit = np.eye(N - 1)[i]
        to_state.append(Phi @ to_state[-1])
        to_force.append(Phi @ to_force[-1] + np.outer(Gamma, unit))
        rows_state.append(C @ to_state[-1])
        rows_force.append(C @ to_force[-1] + np.outer(D, unit))
    X, W = np.vstack(rows_state), np.vstack(rows_force)
    hidden = -np.linalg.lstsq(W, X, rcond=None)[0]
    left, end = X + W @ hidden, to_state[-1] + to_force[-1] @ hidden
    expected = math.sqrt(eigh(left.T @ left, end.T @ end)[0][0] / (2 * N - 1))
    data = [np.zeros((2, N)), np.zeros((1, N - 1)), np.zeros((2, N)), np.ones((2, N)), *[np.zeros((0, N - 1))] * 2]
    data += [np.zeros((0, N)), np.ones((1, N - 1)), (N - 1) * S, S, []]
    assert float(least_visible(PUSHED, N)(*data)[0]) == pytest.approx(expected, rel=1e-5)


def test_the_fmu_of_a_model_with_both_finds_what_the_python_face_finds(tmp_path: Path) -> None:
    """A constant, the spring's stiffness, beside a force that the accelerometer feels."""
    model = replace(
        PUSHED,
        name="pushed_stiffness",
        unknown_parameters=[Variable("stiffness", start=4.0, nominal=4.0)],
        ode=lambda x, u, p, t: [x.x2, -p.stiffness * x.x1 - 0.3 * x.x2 + u.w],
        output=lambda x, u, p, t: [x.x1, -p.stiffness * x.x1 - 0.3 * x.x2 + u.w],
    )
    component = elementary(model, sample_time=S, N=11, K=3, guess={"stiffness": 3.9})
    with compiled_once(optimised=False), plotted_briefly():
        path = export(component, tmp_path)
    assert fmpy.validation.validate_fmu(str(path)) == []
    fmpy.extract(str(path), str(tmp_path / "unpacked"))
    slave, face = Slave(tmp_path / "unpacked"), Instance(component)
    slave.initialize()
    names = [port.name for port in component.outputs]
    for k in range(25):
        for one in (slave, face):
            one.set("place", math.cos(2 * S * k))
            one.set("acceleration", math.nan if k == 15 else -4 * math.cos(2 * S * k))
            one.step(S * k, S)
        found = [slave.get(name) for name in names]
        np.testing.assert_allclose(found, face.outputs(), rtol=1e-9, atol=1e-9)
    slave.fmu.freeInstance()


def test_what_is_done_with_a_disturbed_output_is_said() -> None:
    assert describe(DRIFTING, decompose(DRIFTING, {}))[-1] == (
        "drifts: controls w; follows drifts; solved at each sample, as it is an output's"
    )
    names = [p.name for p in elementary(DRIFTING, sample_time=S, N=11).parameters if p.name.startswith("tuning.")]
    assert {"tuning.q.drifts", "tuning.r.drifts.w", "tuning.weight.w.drifts"} <= set(names)
