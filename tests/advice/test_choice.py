"""The choice: on a linear model as good as the Kalman filter, none where nothing applies, and none that is wrong in silence."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from advice.advise import MOTIONS, STAGES, advise
from advice.candidates import METHODS, Candidate, Refused, Task, candidate
from advice.choice import choose, unfit, why
from advice.region import AdviceError
from advice.trial import Outcome
from observers.model import Model, Variable
from observers.ports import STATE_PART

A = np.array([[0.0, 1.0], [-1.0, -0.4]])
NOISE, TS = 0.02, 0.2


def oscillator(**more) -> Model:
    return Model(
        name="oscillator",
        states=[Variable("a"), Variable("b")],
        inputs=[Variable("u")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.b, -x.a - 0.4 * x.b + u.u],
        output=lambda x, u, p, t: [x.a],
        **more,
    )


@pytest.fixture(scope="module")
def advice():
    told: list[str] = []
    made = advise(oscillator(), noise={"y": NOISE}, sample_time=TS, progress=told.append)
    assert 0 < len(told) <= STAGES
    return made


def kalman_error() -> float:
    """The rms of the stationary one-step prediction with the observers' own process noise, on a plant without any."""
    F, H, Q = expm(A * TS), np.array([[1.0, 0.0]]), STATE_PART**2 * np.eye(2)
    P = solve_discrete_are(F.T, H.T, Q, [[NOISE**2]])
    K = F @ P @ H.T / (H @ P @ H.T + NOISE**2)
    covariance = np.zeros((2, 2))
    for _ in range(2000):
        covariance = (F - K @ H) @ covariance @ (F - K @ H).T + NOISE**2 * K @ K.T
    return float(np.sqrt(np.trace(covariance) / 2))


@pytest.mark.long
def test_on_a_linear_model_the_choice_is_as_good_as_the_kalman_filter(advice) -> None:
    assert advice.choice.total <= 1.3 * kalman_error()
    assert advice.choice.silent <= 0.05
    assert advice.choice.settled == MOTIONS


@pytest.mark.long
def test_every_observer_is_in_the_advice_once(advice) -> None:
    tried = [o.candidate.method for o in advice.outcomes]
    assert sorted([*tried, *(r.method for r in advice.refused)]) == sorted(METHODS)


@pytest.mark.long
def test_the_line_makes_the_observer_that_was_tried(advice) -> None:
    chosen = advice.choice.candidate
    made = eval(chosen.line("MODEL"), dict(METHODS) | {"MODEL": oscillator()})
    assert made.parameters == chosen.component.parameters and made.sample_time == chosen.component.sample_time


def test_an_observer_that_does_not_apply_says_why_in_its_builders_words() -> None:
    model = oscillator(unknown_disturbances=[Variable("w")])
    found = candidate("ukf", Task(model, TS, {"y": NOISE}, 10))
    assert isinstance(found, Refused)
    assert found.reason == "ukf: model 'oscillator' has unknown disturbances (w), which this method does not treat"


def test_a_long_sample_has_few_steps_of_the_prediction() -> None:
    found = candidate("riccati", Task(oscillator(), 30.0, {"y": NOISE}, 10))
    assert isinstance(found, Candidate) and found.arguments["max_step"] == 3.0
    assert "max_step" not in candidate("pseudospectral", Task(oscillator(), 30.0, {"y": NOISE}, 10)).arguments


def test_no_motion_within_the_bounds_is_one_message() -> None:
    model = Model(
        name="rocket",
        states=[Variable("h", start=1.0, min=0.0, max=2.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [5.0],
        output=lambda x, u, p, t: [x.h],
    )
    with pytest.raises(AdviceError, match=r"model 'rocket': no motion from around the start values .* 'h' leaves its"):
        advise(model, sample_time=1.0)


def outcome(method: str, total: float, per_sample: float = 1e-5, **more) -> Outcome:
    made = Outcome(None, {}, total, None, None, 1.0, 4, per_sample, 100, 0.0, "")  # type: ignore[arg-type]
    return replace(made, candidate=method, **more)


def test_the_choice_is_the_least_error_that_is_not_silent_settles_and_ends() -> None:
    good, better = outcome("good", 1.0), outcome("better", 0.5)
    assert choose([good, better]) is better
    for fault in ({"silent": 0.06}, {"settled": 3}, {"ended": "no"}, {"total": np.inf}):
        bad = replace(better, **fault)
        assert unfit(bad, [good, bad]) and choose([good, bad]) is good
    assert choose([replace(good, silent=1.0)]) is None
    assert choose([]) is None


def test_an_observer_that_is_lost_after_a_jump_is_not_the_choice() -> None:
    stiff, alert = outcome("stiff", 1.0, after_jump=3.0), outcome("alert", 1.2, after_jump=1.0)
    assert choose([stiff, alert]) is alert
    assert choose([replace(stiff, after_jump=1.1), alert]) is not alert
    assert choose([stiff, replace(alert, total=1.5)]) is stiff  # too far off until the parameter jumps


def test_of_equals_the_cheaper_is_taken() -> None:
    slow, fast, worse = outcome("slow", 1.0, 1e-4), outcome("fast", 1.02, 1e-6), outcome("worse", 1.1, 1e-7)
    assert choose([slow, fast, worse]) is fast


def named(method: str, total: float, after_jump: float | None = None, per_sample: float = 1e-5) -> Outcome:
    made = outcome(method, total, per_sample, after_jump=after_jump)
    return replace(made, candidate=SimpleNamespace(method=method))  # type: ignore[arg-type]


def test_the_reason_of_the_choice_is_said_in_one_sentence() -> None:
    alone = [named("ukf", 1.0)]
    assert why(alone[0], alone) == "The only one that settles and is not wrong in silence."
    best, alert = named("stiff", 1.0, after_jump=3.0), named("alert", 1.2, after_jump=1.0)
    assert why(alert, [best, alert]) == (
        "It has an error on clean streams of 1.20 times that of stiff, the least after a jump."
    )
    slow, quick = named("slow", 1.0, per_sample=1e-5), named("quick", 1.01, per_sample=1e-6)
    assert choose([slow, quick]) is quick
    assert why(quick, [slow, quick]) == (
        "It has an error on clean streams of 1.01 times that of slow, the quickest of the 2 that are equal to 3%."
    )
