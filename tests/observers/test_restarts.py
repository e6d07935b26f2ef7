"""The filters' second chances on a linear model: against the Kalman filter that starts again, and the scale that the innovations give."""

from __future__ import annotations

import math

import numpy as np
import pytest
from linear_filters import GUESS, KINDS, LINEAR, TS, F, Reference, made

from observers.instance import Instance
from observers.least_squares import least_squares
from observers.model import Model, Variable
from observers.riccati import riccati
from observers.status import CODE
from observers.ukf import ukf


@pytest.mark.parametrize("kind", KINDS)
def test_ten_outliers_start_the_covariance_again_and_twenty_more_the_estimate(kind: str) -> None:
    """At the prediction, then at the guess; in between and afterwards it is the Kalman filter that started there."""
    run, reference = Instance(made(kind)), Reference(kind)
    true, rng, restarts = np.array([0.9, 0.2]), np.random.default_rng(1), 0
    for k in range(50):
        far = 6 <= k < 16 or 22 <= k < 42
        y = true[0] + 0.2 * rng.normal()
        run.set("y", y + 1000.0 * far)
        run.step(k * TS, TS)
        if not far:
            reference.sample(y)
        elif k in (15, 41):
            restarts += 1
            reference.start()
            reference.x = GUESS if k == 41 else reference.x
            assert run.get("diagnostics.status") == CODE.inconsistent
        found = [run.get(f"filtered.{name}") for name in "ab"]
        np.testing.assert_allclose(found, reference.x, rtol=0, atol=1e-12, err_msg=str(k))
        reference.move()
        found = [run.get(f"diagnostics.std.{name}") for name in "ab"]
        np.testing.assert_allclose(found, np.sqrt(np.diag(reference.S)), rtol=1e-12, err_msg=str(k))
        assert run.get("diagnostics.restarts") == restarts
        true = F @ true
    assert run.get("diagnostics.solver_failures") == 0


GAMMA, R_PAPER = 7.0, 0.4


@pytest.mark.parametrize("kind", ["riccati", "least_squares"])
def test_the_deviations_of_a_papers_design_are_in_the_scale_of_the_innovations(kind: str) -> None:
    """P times the mean of nu' S^-1 nu so far: of a sample's variance 1 / (gamma Ts), or R^2 / Ts."""
    if kind == "riccati":
        run = Instance(riccati(LINEAR, sample_time=TS, N=0.3, R=R_PAPER, Q0=[1.0, 4.0]))
        reference = Reference(kind, np.eye(2) * 0.3**2, R_PAPER**2 / TS)
    else:
        run = Instance(least_squares(LINEAR, sample_time=TS, T=100.0, gamma=GAMMA, p0=2.5))
        reference = Reference(kind, np.zeros((2, 2)), 1 / (GAMMA * TS), 2.5 * np.eye(2))
    squares = []
    for k in range(25):
        y = math.sin(1.3 * k)
        run.set("y", y)
        run.step(k * TS, TS)
        squares.append((y - reference.x[0]) ** 2 / (reference.S[0, 0] + reference.variance))
        reference.sample(y)
        reference.move()
        found = [run.get(f"diagnostics.std.{name}") for name in "ab"]
        np.testing.assert_allclose(found, np.sqrt(np.mean(squares) * np.diag(reference.S)), rtol=1e-11, err_msg=str(k))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("part", [0.999, -0.999, 1.001, -1.001])
def test_a_sample_acts_within_ten_deviations_of_its_innovation_and_not_beyond(kind: str, part: float) -> None:
    """Of the innovation's own variance: that of the prediction and that of the noise."""
    run, reference = Instance(made(kind)), Reference(kind)
    for k in range(12):
        # A sample that is its own prediction leaves the estimate where the model takes it.
        spread = math.sqrt(reference.S[0, 0] + reference.variance)
        y = reference.x[0] + (10 * part * spread if k == 11 else 0)
        run.set("y", y)
        run.step(k * TS, TS)
        if k < 11 or abs(part) < 1:
            reference.sample(y)
        np.testing.assert_allclose(run.get("filtered.a"), reference.x[0], rtol=0, atol=1e-12)
        reference.move()
    assert (run.get("diagnostics.status") == CODE.outlier) == (abs(part) > 1)


def pushed() -> Model:
    """A state that moves as its known input says."""
    return Model(
        name="pushed",
        states=[Variable("a", start=0.4)],
        inputs=[Variable("push")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [u.push],
        output=lambda x, u, p, t: [x.a],
    )


TOLD = {"measurement_noise": {"y": 0.2}, "initial_std": {"a": 1.0}}
PUSHED = {
    "ukf": lambda: ukf(pushed(), sample_time=TS, **TOLD, process_noise={"a": 0.1}),
    "riccati": lambda: riccati(pushed(), sample_time=TS, **TOLD, process_noise={"a": 0.1}),
    "least_squares": lambda: least_squares(pushed(), sample_time=TS, T=100.0, max_step=TS, **TOLD),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("escape", [15, 41], ids=["the covariance", "the estimate"])
def test_what_escapes_right_after_a_restart_goes_back_to_what_the_restart_began_with(kind: str, escape: int) -> None:
    """The prediction where only the covariance started again, the guess where the estimate did, and what lies before it is forgotten."""
    run = Instance(PUSHED[kind]())
    for k in range(escape + 1):
        far = 6 <= k < 16 or 22 <= k < 42
        before = run.get("estimate.a")
        run.set("y", 1000.0 * far + 1.0 + 0.1 * math.sin(k))
        run.set("push", 1e300 if k == escape else 0.0)
        run.step(k * TS, TS)
    assert run.get("diagnostics.restarts") == (1 if escape == 15 else 2)
    assert run.get("diagnostics.solver_failures") == 1
    assert abs(before - 1) < 0.2
    assert run.get("estimate.a") == pytest.approx(before if escape == 15 else 0.4, rel=1e-14, abs=0)
