"""The unscented Kalman filter against the Kalman filter, its own covariance, and the paper's comparison."""

import math
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

from build_fmus import FMUS
from cosim.master import run
from observers.instance import Instance
from observers.model import Model, ModelError, Variable
from observers.status import CODE
from observers.ukf import ukf
from reference_models.duffing import DUFFING

A = np.array([[0.0, 1.0], [-2.0, -0.3]])
C = np.array([[1.0, 0.0], [1.0, 1.0]])
Q, R, P0, TS = np.diag([0.1, 0.3]) ** 2, np.diag([0.2, 0.1]) ** 2, np.diag([1.0, 4.0]), 0.1
F = expm(A * TS)
G = expm(np.block([[A, np.array([[0.0], [1.0]])], [np.zeros((1, 3))]]) * TS)[:2, 2]
LINEAR = Model(
    name="linear",
    states=[Variable("x1"), Variable("x2")],
    inputs=[Variable("u")],
    outputs=[Variable("y1"), Variable("y2")],
    ode=lambda x, u, p, t: [x.x2, -2 * x.x1 - 0.3 * x.x2 + u.u],
    output=lambda x, u, p, t: [x.x1, x.x1 + x.x2],
)
TUNED = dict(
    process_noise={"x1": 0.1, "x2": 0.3}, measurement_noise={"y1": 0.2, "y2": 0.1}, initial_std={"x1": 1.0, "x2": 2.0}
)


@pytest.mark.parametrize("missing", [0.0, 0.3])
@pytest.mark.parametrize("kappa", [0.0, 1.0, 3.0])
def test_on_a_linear_model_it_is_the_kalman_filter_with_missing_samples_too(missing: float, kappa: float) -> None:
    run_ukf = Instance(ukf(LINEAR, sample_time=TS, **TUNED), {"tuning.kappa": kappa, "tuning.gate": 1e9})
    rng = np.random.default_rng(1)
    x, P = np.zeros(2), P0
    for k in range(150):
        y, u = rng.normal(size=2), rng.normal()
        y[rng.random(2) < missing] = np.nan
        for name, value in (("y1", y[0]), ("y2", y[1]), ("u", u)):
            run_ukf.set(name, value)
        run_ukf.step(k * TS, TS)
        P = P + Q * TS
        here = np.isfinite(y)
        H, noise = C[here], R[np.ix_(here, here)]
        if here.any():
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + noise)
            x, P = x + K @ (y[here] - H @ x), (np.eye(2) - K @ H) @ P
        np.testing.assert_allclose([run_ukf.get("filtered.x1"), run_ukf.get("filtered.x2")], x, rtol=0, atol=1e-13)
        x, P = F @ x + G * u, F @ P @ F.T
        np.testing.assert_allclose([run_ukf.get("estimate.x1"), run_ukf.get("estimate.x2")], x, rtol=0, atol=1e-13)
        found = [run_ukf.get("diagnostics.std.x1"), run_ukf.get("diagnostics.std.x2")]
        np.testing.assert_allclose(found, np.sqrt(np.diag(P + Q * TS)), rtol=0, atol=1e-13)


def test_its_errors_are_as_large_as_its_covariance_says() -> None:
    """Normalised squared errors of 60 runs on a nonlinear pendulum: 1 on average for an honest filter."""
    model = Model(
        name="pendulum",
        states=[Variable("angle"), Variable("rate")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.rate, -4 * ca.sin(x.angle) - 0.2 * x.rate],
        output=lambda x, u, p, t: [ca.sin(x.angle)],
    )
    observer = ukf(
        model,
        sample_time=0.1,
        process_noise={"angle": 1e-9, "rate": 0.2},
        measurement_noise={"y": 0.05},
        initial_std={"angle": 0.2, "rate": 0.2},
    )
    rng = np.random.default_rng(8)
    squares = []
    for _ in range(60):
        x, o = rng.normal(0, 0.2, 2), Instance(observer)
        for k in range(30):
            x = x + np.array([0.0, rng.normal(0, 0.2 * np.sqrt(0.1))])
            o.set("y", np.sin(x[0]) + rng.normal(0, 0.05))
            o.step(0.1 * k, 0.1)
            if k == 29:
                break
            for _ in range(20):  # small steps: only the filter's own integrator is of high order
                middle = x + 0.0025 * np.array([x[1], -4 * np.sin(x[0]) - 0.2 * x[1]])
                x = x + 0.005 * np.array([middle[1], -4 * np.sin(middle[0]) - 0.2 * middle[1]])
        # The filter's deviation is of the step's end, 0.1 s after the sample: close to that of the sample instant.
        squares.append(((o.get("filtered.angle") - x[0]) / o.get("diagnostics.std.angle")) ** 2)
        squares.append(((o.get("filtered.rate") - x[1]) / o.get("diagnostics.std.rate")) ** 2)
    assert 0.5 < np.mean(squares) < 1.6, np.mean(squares)


def test_it_follows_the_papers_jumps_with_process_noise_and_starts_again_without(
    catalogue_system: Callable[[str], Path],
) -> None:
    """A theta that may not wander freezes, as in the paper; the filter says so within a sample and starts again within a second."""
    system = catalogue_system("gong_example_2_ukf")
    tracking = run(system)
    frozen = run(system, overrides={"observer.tuning.process_noise.theta": 0.0})
    for result, small in ((tracking, 1e-4), (frozen, 1e-3)):
        theta = np.abs(result["observer.estimate.theta"] - result["plant.x.theta"])
        x1 = np.abs(result["observer.estimate.x1"] - result["plant.x.x1"])
        for settled in (slice(95, 100), slice(150, 200), slice(250, 300)):
            assert theta[settled].max() < 10 * small and x1[settled].max() < small
    stuck = slice(103, 111)  # the first sample after the jump may be an outlier
    assert np.abs(frozen["observer.estimate.theta"] - 0.4)[stuck].max() < 1e-3
    assert not frozen["observer.diagnostics.trusted"][stuck].any()
    assert tracking["observer.diagnostics.restarts"][-1] == 0 and frozen["observer.diagnostics.restarts"][-1] == 2


def test_the_python_face_and_the_fmu_agree(catalogue_system: Callable[[str], Path]) -> None:
    noisy = {"plant.sensor.noise_bound": 0.05, "plant.sensor.sample_time": 0.1}
    result = run(catalogue_system("gong_example_2_ukf"), overrides=noisy)
    o = Instance(FMUS["duffing_ukf"][0]())
    names = [port.name for port in o.component.outputs]
    for k in range(len(result.time) - 1):
        o.set("y", result["plant.y"][k])
        o.step(result.time[k], result.step)
        expected = [result[f"observer.{name}"][k + 1] for name in names]
        np.testing.assert_allclose(o.outputs(), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e200])
def test_a_measurement_that_is_not_finite_is_rejected_and_counted(catalogue_slave: Callable, bad: float) -> None:
    o, p = catalogue_slave("duffing_ukf").initialize(), Instance(FMUS["duffing"][0]())
    for k in range(30):
        o.set("y", bad if k == 20 else p.get("y"))
        before = o.get("estimate.x1")
        p.step(0.1 * k, 0.1)
        o.step(0.1 * k, 0.1)
        if k == 20:
            assert o.get("diagnostics.status") == CODE.sample_rejected
            assert o.get("filtered.x1") == pytest.approx(before, abs=1e-14)
    assert o.get("diagnostics.rejected_samples") == 1 and o.get("diagnostics.status") == CODE.estimating
    assert all(np.isfinite(value) for value in o.outputs().values())


@pytest.mark.parametrize("outlier", [1e3, 1e9, 1e140])
def test_no_outlier_locks_the_filter_out(outlier: float) -> None:
    o = Instance(ukf(DUFFING, sample_time=0.1, process_noise={"theta": 0.1}, measurement_noise={"y": 0.01}))
    p = Instance(FMUS["duffing"][0]())
    for k in range(400):
        o.set("y", p.get("y") + (outlier if k in (20, 22) else 0.0))
        p.step(0.1 * k, 0.1)
        o.step(0.1 * k, 0.1)
        assert np.isfinite(o.outputs()).all()
    assert abs(o.get("estimate.x1") - p.get("x.x1")) < 1e-3


def test_a_tuning_of_something_unknown_is_refused_by_name() -> None:
    with pytest.raises(ModelError, match="process_noise of 'thetta'; known: x1, x2, theta"):
        ukf(DUFFING, sample_time=0.1, process_noise={"thetta": 1.0})
    with pytest.raises(ModelError, match="measurement_noise of 'u'; known: y"):
        ukf(DUFFING, sample_time=0.1, measurement_noise={"u": 1.0})
    with pytest.raises(ValueError, match="sample_time = 0 must be at least"):
        ukf(DUFFING, sample_time=0.0)


@pytest.mark.parametrize(("states", "words"), [(99, "no output ever sees"), (100, "101 states and unknown parameters")])
def test_more_than_a_hundred_estimates_are_refused_before_anything_is_built(states: int, words: str) -> None:
    """What is said of a hundred, of which the outputs see two, is another thing."""
    model = Model(
        name="wide",
        states=[Variable(f"x{i}") for i in range(states)],
        unknown_parameters=[Variable("a")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-p.a * getattr(x, f"x{i}") for i in range(states)],
        output=lambda x, u, p, t: [x.x0],
    )
    with pytest.raises(ModelError, match=words):
        ukf(model, sample_time=0.1)


@pytest.mark.parametrize("least", [0.0, -math.inf], ids=["bounded", "unbounded"])
@pytest.mark.parametrize("output", ["log", "sqrt"])
def test_a_first_covariance_wider_than_the_outputs_domain_loses_no_sample(output: str, least: float) -> None:
    """With everything at its default, sigma points of 0.8 +- 1.7 lie where a logarithm is none."""
    h, value = {"log": (ca.log, math.log), "sqrt": (ca.sqrt, math.sqrt)}[output]
    sensed = Model(
        name="sensed",
        states=[Variable("c", start=0.8, min=least)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [0.1 - 0.3 * x.c],
        output=lambda x, u, p, t: [h(x.c)],
    )
    run, c = Instance(ukf(sensed, sample_time=0.1, measurement_noise={"y": 0.02})), 0.5
    for k in range(200):
        run.set("y", value(c))
        run.step(0.1 * k, 0.1)
        c = 1 / 3 + (c - 1 / 3) * math.exp(-0.03)
    assert run.get("diagnostics.solver_failures") == 0 and run.get("diagnostics.trusted") == 1
    assert abs(run.get("estimate.c") - c) < 1e-4
