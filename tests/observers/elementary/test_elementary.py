"""Calvillo-Corona & Alamir's observer in Python: decomposition, levels, identifiability, what goes wrong."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import eigh, expm

from observers.elementary import elementary
from observers.elementary.identifiability import describe as describe_null
from observers.elementary.identifiability import least_visible
from observers.elementary.iteration import iteration, tuning_layout
from observers.elementary.problems import GAUSS_NEWTON, GRID, LQ, decompose, describe
from observers.instance import Instance
from observers.model import Model, ModelError, Variable
from observers.status import CODE
from reference_models.calvillo_alamir import FMUS, WEIGHTS, WEIGHTS_WITHOUT_V
from reference_models.plant import plant
from reference_models.roessler import ROESSLER
from reference_models.van_der_pol import VAN_DER_POL, VAN_DER_POL_KNOWN, VAN_DER_POL_SIGNED

TUNING = [10, 1e-3, 1e-3, 5e-4, 10, 1, 1, 1, 1, 1]


def test_controls_and_levels_follow_from_the_equations() -> None:
    first, second = decompose(VAN_DER_POL, {})
    assert (first.states, first.disturbances, first.outputs, first.level) == ((1,), (0,), (0,), LQ)
    assert (second.states, second.disturbances, second.outputs, second.level) == ((0,), (), (), GAUSS_NEWTON)
    assert [p.level for p in decompose(VAN_DER_POL_SIGNED, {})] == [GRID, GAUSS_NEWTON]
    assert [(p.states, p.level) for p in decompose(ROESSLER, {})] == [
        ((1, 2), LQ),
        ((0,), LQ),
        ((0,), GAUSS_NEWTON),
    ]
    assert describe(VAN_DER_POL, (first, second)) == [
        "x1: controls x2, v; follows y; solved by lq, as its equation is affine",
        "x2: controls x1; follows the last iterate of x2; solved by gauss_newton, as its equation is smooth",
    ]


def friction(**bounds: float) -> Model:
    """A mass with dry friction: a kink in the speed's equation."""
    return Model(
        name="friction",
        states=[Variable("place"), Variable("speed", start=1.0, **bounds)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.speed, -ca.fabs(x.speed) - ca.if_else(t > 1, 1, 0) * x.place],
        output=lambda x, u, p, t: [x.place],
    )


def test_a_kink_in_an_unknown_needs_the_grid_and_one_in_time_does_not() -> None:
    assert [p.level for p in decompose(friction(min=-2.0, max=2.0), {})] == [LQ, GRID]
    with pytest.raises(ValueError, match=r"grid for 'speed' lacks a bound: min = -inf"):
        decompose(friction(), {})


@pytest.mark.parametrize(
    ("model", "options", "words"),
    [
        (VAN_DER_POL, {"N": 2}, "N = 2"),
        (VAN_DER_POL, {"K": 0}, "K = 0"),
        (VAN_DER_POL, {"levels": {"x3": "lq"}}, "'x3'"),
        (VAN_DER_POL, {"levels": {"x1": "exact"}}, "'exact'"),
        (VAN_DER_POL_SIGNED, {"levels": {"x1": "lq"}}, "does not suffice: grid is needed, as v is bounded"),
        (VAN_DER_POL, {"q": {"x3": 1.0}}, "q of 'x3'"),
        (VAN_DER_POL, {"r": {"x2": {"v": 1.0}}}, "r of 'x2.v'"),
        (VAN_DER_POL, {"r": {"x1": {"v": -1.0}}}, "'x1.v' = -1"),
        (VAN_DER_POL, {"weights": {"v": {"x2": 1.0}}}, "weights of 'v.x2'"),
        (VAN_DER_POL, {"guess": {"z": 1.0}}, "'z'"),
        (VAN_DER_POL, {"first_guess": ROESSLER}, "different variables"),
    ],
)
def test_what_cannot_be_is_refused_by_name(model: Model, options: dict[str, Any], words: str) -> None:
    with pytest.raises((ValueError, ModelError), match=words):
        elementary(model, **{"sample_time": 0.05, "N": 21} | options)


def test_a_state_that_no_output_sees_is_refused() -> None:
    hidden = Model(
        name="hidden",
        states=[Variable("a"), Variable("b")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-x.a, -x.b],
        output=lambda x, u, p, t: [x.a],
    )
    with pytest.raises(ModelError, match="no output ever sees b"):
        elementary(hidden, sample_time=0.1, N=11)


@pytest.mark.parametrize(
    ("rate", "output", "words"),
    [
        (lambda x, u, p, t: [-x.a], lambda x, u, p, t: [x.a], "disturbance 'w' acts on no state and no output"),
        (lambda x, u, p, t: [-x.a], lambda x, u, p, t: [x.a + u.w], "output 'a', .* has the name of a state"),
    ],
)
def test_a_disturbance_without_a_problem_of_its_own_is_refused(rate: Any, output: Any, words: str) -> None:
    model = Model(
        name="disturbed",
        states=[Variable("a")],
        unknown_disturbances=[Variable("w")],
        outputs=[Variable("a")],
        ode=rate,
        output=output,
    )
    with pytest.raises(ModelError, match=words):
        elementary(model, sample_time=0.1, N=11)


@pytest.mark.parametrize("level", [LQ, GRID])
def test_a_problem_without_controls_is_one_for_its_initial_state_alone(level: str) -> None:
    model = Model(
        name="cascade",
        states=[Variable("a", start=1.0, min=-3.0, max=3.0), Variable("b", start=1.0, min=-3.0, max=3.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.b - x.a, -0.5 * x.b],
        output=lambda x, u, p, t: [x.a],
    )
    observer = Instance(
        elementary(model, sample_time=0.1, N=11, K=10, levels={"b": level}, r={"a": {"b": 1e-3}}), {"guess.b": 0.0}
    )
    true = Instance(plant(model))
    for k in range(40):
        observer.set("y", true.get("y"))
        for one in (true, observer):
            one.step(0.1 * k, 0.1)
    for state in ("a", "b"):
        assert abs(observer.get(f"estimate.{state}") - true.get(f"x.{state}")) <= 3e-8


def window(model: Model, N: int, s: float, W: np.ndarray) -> list[Any]:
    """X to p of a window along the model's motion with u = sin t, mu = 0.1 sin t and the disturbance W."""
    times = s * np.arange(N)
    run = Instance(plant(model))
    X, Y = [], []
    for k, t in enumerate(times):
        run.set("u", np.sin(t))
        run.set("mu", 0.1 * np.sin(t))
        if W.size:
            run.set("v", W[0, min(k, N - 2)])
        X.append([run.get("x.x1"), run.get("x.x2")])
        Y.append(run.get("y"))
        run.step(t, s)
    u = np.vstack([np.sin(times), 0.1 * np.sin(times)])
    active = np.ones((1, N - 1))
    return [np.array(X).T, W, np.array([Y]), np.ones((1, N)), u[:, :-1], u[:, :-1], u, active, times[-1], s, []]


def test_the_truth_is_a_fixed_point_of_the_iterations() -> None:
    data = window(VAN_DER_POL, 41, 0.05, np.full((1, 40), 0.3))
    X, W, change = iteration(VAN_DER_POL, decompose(VAN_DER_POL, {}), 41, 81)(*data, TUNING)
    assert float(change) <= 1e-6
    assert np.abs(X.full() - data[0]).max() <= 1e-6 and np.abs(W.full() - 0.3).max() <= 1e-4


def test_the_null_direction_of_the_example_is_found_and_named() -> None:
    assert describe_null(VAN_DER_POL, 41, 0.05) == "x2 + c, v - c"
    assert describe_null(VAN_DER_POL_KNOWN, 41, 0.05) == ""
    assert "x2 + c, v - c" in FMUS["van_der_pol_elementary"][0]().documentation
    visibility, direction = least_visible(VAN_DER_POL, 41)(*window(VAN_DER_POL, 41, 0.05, np.full((1, 40), 0.3)))
    assert float(visibility) <= 1e-4
    x1, x2, v = direction.full().ravel()
    assert abs(x1) <= 1e-6 and v == pytest.approx(-x2, rel=5e-3)  # v: the mean over the last interval


def test_along_the_null_direction_the_output_does_not_change() -> None:
    """Independent of the linearisation: the model moved with the direction's v gives the same y for another x2."""
    N, s, c = 41, 0.05, 0.05
    W = np.full((1, N - 1), 0.3)
    straight = window(VAN_DER_POL, N, s, W)
    shifted = replace(VAN_DER_POL, states=[VAN_DER_POL.states[0], replace(VAN_DER_POL.states[1], start=-0.3 + c)])
    moved = window(shifted, N, s, W - c)
    # mu makes the shift move a little: 0.1 sin t (1 - x1^2) c.
    assert np.abs(moved[2] - straight[2]).max() <= 0.05 * c
    assert np.abs(moved[0][1] - straight[0][1]).min() >= 0.9 * c


def test_a_disturbance_at_its_bound_is_no_longer_free() -> None:
    inside, at_bound = (window(VAN_DER_POL_SIGNED, 41, 0.05, np.full((1, 40), v)) for v in (0.25, 0.5))
    see = least_visible(VAN_DER_POL_SIGNED, 41)
    assert float(see(*inside)[0]) <= 1e-4 < 1e-2 <= float(see(*at_bound)[0])


def test_without_disturbances_the_visibility_is_the_gramians() -> None:
    """Against scipy's generalised eigenvalues of the observability Gramian over the window, for a linear model."""
    A, s, N = np.array([[0.0, 1.0], [-4.0, -0.3]]), 0.1, 31
    model = Model(
        name="oscillator",
        states=[Variable("a", start=1.0), Variable("b")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.b, -4 * x.a - 0.3 * x.b],
        output=lambda x, u, p, t: [x.a],
    )
    Phi = expm(A * s)
    powers = [np.linalg.matrix_power(Phi, i) for i in range(N)]
    gramian = sum(power[:1].T @ power[:1] for power in powers)
    expected = np.sqrt(eigh(gramian, powers[-1].T @ powers[-1])[0][0] / N)
    blank = [np.zeros((2, N)), np.zeros((0, N - 1)), np.zeros((1, N)), np.ones((1, N))]
    inputs = [np.zeros((0, N - 1))] * 2 + [np.zeros((0, N)), np.ones((1, N - 1)), 3.0, s, []]
    assert float(least_visible(model, N)(*blank, *inputs)[0]) == pytest.approx(expected, rel=3e-4)


def test_tuning_has_a_weight_for_every_problem_control_and_average() -> None:
    names = [p.name.removeprefix("tuning.") for p in elementary(VAN_DER_POL, sample_time=0.1, N=11).parameters]
    assert [n for n in names if n.split(".")[0] in ("q", "r", "weight")] == [
        "q.x1", "q.x2", "r.x1.x2", "r.x1.v", "r.x2.x1",
        "weight.x1.x1", "weight.x1.x2", "weight.x2.x1", "weight.x2.x2", "weight.v.x1",
    ]  # fmt: skip
    assert tuning_layout(VAN_DER_POL, decompose(VAN_DER_POL, {})).total == len(TUNING)


def known_horizon() -> tuple[Instance, Instance]:
    options: dict[str, Any] = {"sample_time": 0.05, "N": 21, "guess": {"x2": 0.0}}
    return Instance(elementary(VAN_DER_POL_KNOWN, **options, **WEIGHTS_WITHOUT_V)), Instance(plant(VAN_DER_POL))


def feed(observer: Instance, true: Instance, k: int, y: float | None = None) -> None:
    for name, gain in (("u", 1.0), ("mu", 0.1)):
        for one in (observer, true):
            one.set(name, gain * np.sin(0.05 * k))
    observer.set("y", true.get("y") if y is None else y)
    for one in (true, observer):
        one.step(0.05 * k, 0.05)


def test_a_rejected_sample_leaves_the_prediction_and_does_not_disturb_those_after() -> None:
    observer, true = known_horizon()
    for k in range(60):
        feed(observer, true, k, np.nan if k in (30, 31, 45) else None)
        if k in (30, 31, 45):
            assert observer.get("diagnostics.status") == CODE.sample_rejected
        if k >= 20:
            assert abs(observer.get("estimate.x2") - true.get("x.x2")) <= 8e-6, k
    assert observer.get("diagnostics.rejected_samples") == 3
    assert observer.get("diagnostics.solver_failures") == 0


def test_a_solve_that_is_not_finite_starts_a_new_window() -> None:
    observer, true = known_horizon()
    for k in range(80):
        feed(observer, true, k, 1e149 if 30 <= k <= 33 else None)
        assert np.all(np.isfinite(observer.outputs()))
        if 30 <= k <= 33:  # three outliers in a row are none any more
            assert observer.get("diagnostics.status") == (CODE.outlier if k < 33 else CODE.solver_failed)
    assert observer.get("diagnostics.solver_failures") >= 1
    assert abs(observer.get("estimate.x2") - true.get("x.x2")) <= 4e-6


def test_with_noise_the_weights_decide_how_much_is_believed() -> None:
    """Noise of 0.01 in y: the smaller r makes x2 follow the noise's slope, a larger one smooths it."""
    errors = []
    for r in (1e-3, 10.0):
        observer, true = known_horizon()
        observer.set("tuning.r.x1.x2", r)
        noise = np.random.default_rng(0).normal(scale=0.01, size=200)
        gaps = []
        for k in range(200):
            feed(observer, true, k, true.get("y") + noise[k])
            gaps.append(observer.get("estimate.x2") - true.get("x.x2"))
        errors.append(np.sqrt(np.mean(np.square(gaps[50:]))))
    assert errors[1] < errors[0]


def test_a_known_sign_is_enough_where_the_disturbance_rests_at_it() -> None:
    """v >= 0 and no upper bound: with v = 0 the shift is resolved from above, in a window that grows."""
    model = replace(VAN_DER_POL, unknown_disturbances=[Variable("v", min=0.0, nominal=0.5)])
    options: dict[str, Any] = {"sample_time": 0.1, "N": 11, "nodes": 41, "guess": {"x2": 0.0}}
    observer, true = Instance(elementary(model, **options, **WEIGHTS)), Instance(plant(VAN_DER_POL))
    for k in range(25):
        for name, gain in (("u", 1.0), ("mu", 0.1)):
            for one in (observer, true):
                one.set(name, gain * np.sin(0.1 * k))
        observer.set("y", true.get("y"))
        for one in (true, observer):
            one.step(0.1 * k, 0.1)
        assert observer.get("estimate.v") >= 0.0
    assert abs(observer.get("estimate.x2") - true.get("x.x2")) <= 3e-4
    assert observer.get("diagnostics.status") == CODE.estimating


def test_the_iteration_limit_bounds_a_sample_and_the_next_one_goes_on() -> None:
    """What a deadline allows: fewer iterations a sample, said by the status, and over the samples the same fixed point."""
    component = FMUS["van_der_pol_known_elementary"][0]()
    free, bound = (
        Instance(component, {"tuning.epsilon": 1e-9}),
        Instance(component, {"tuning.epsilon": 1e-9, "tuning.measurement_noise.y": 1e-7, "tuning.iteration_limit": 1}),
    )
    truth = Instance(plant(VAN_DER_POL_KNOWN))
    for k in range(60):
        for run in (free, bound):
            run.set("y", truth.get("y"))
            run.step(0.05 * k, 0.05)
        truth.step(0.05 * k, 0.05)
        assert bound.get("diagnostics.iterations") <= 1
        if k > 1:
            assert free.get("diagnostics.iterations") > 1
            assert bound.get("diagnostics.status") in (CODE.iterating, CODE.inconsistent)
    assert abs(bound.get("filtered.x2") - free.get("filtered.x2")) < 2e-7


@pytest.mark.parametrize("N", [3, 8, 41])
@pytest.mark.parametrize(
    ("rates", "mixed"),
    [
        (lambda x, u, p, t: [u.a, u.b], np.eye(2)),
        (lambda x, u, p, t: [u.a + u.b, u.a - u.b], np.array([[1.0, 1.0], [1.0, -1.0]])),
    ],
)
def test_measured_states_with_a_disturbance_each_are_found_exactly(rates: Any, mixed: np.ndarray, N: int) -> None:
    """v and w are straight lines within an interval: closed form. Whatever they were, one sample later it is forgotten."""
    model = Model(
        name="two_disturbances",
        states=[Variable("v", start=1.0), Variable("w", start=-0.5)],
        unknown_disturbances=[Variable("a"), Variable("b")],
        outputs=[Variable("y1"), Variable("y2")],
        ode=rates,
        output=lambda x, u, p, t: [x.v, x.w],
    )
    r = {state: {"a": 1e-6, "b": 1e-6} if mixed[0, 1] else {d: 1e-6} for state, d in (("v", "a"), ("w", "b"))}
    component = elementary(model, sample_time=0.1, N=N, K=60, r=r)
    assert not describe_null(model, N, 0.1)
    observer = Instance(component, {"tuning.epsilon": 0.0, "guess.v": 0.0, "guess.w": 3.0})
    forces = np.random.default_rng(4).normal(size=(60, 2))
    true = np.vstack([[1.0, -0.5], [1.0, -0.5] + 0.1 * np.cumsum(forces @ mixed.T, axis=0)])
    for k in range(60):
        observer.set("y1", true[k, 0])
        observer.set("y2", true[k, 1])
        observer.step(0.1 * k, 0.1)
        assert np.all(np.isfinite(observer.outputs()))
        if k < N:
            continue
        found = [observer.get(f"filtered.{name}") for name in ("v", "w", "a", "b")]
        assert_allclose(found, [*true[k], *forces[k - 1]], rtol=0, atol=5e-11, err_msg=str(k))
        assert observer.get("diagnostics.visibility") > 1
