"""A correction or a motion that fails leaves no trace but a count, and the next sample starts clean: against the Kalman filter."""

from __future__ import annotations

import math
from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from linear_filters import GUESS, KINDS, TS, R, Reference, made

from observers.canonical_dae import canonical_dae
from observers.component import Component
from observers.elementary import elementary
from observers.instance import Instance
from observers.least_squares import least_squares
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral
from observers.riccati import riccati
from observers.status import CODE
from observers.ukf import ukf


@pytest.mark.parametrize("kind", KINDS)
def test_a_correction_that_overflows_keeps_the_prediction_and_what_comes_next_is_the_kalman_filter(kind: str) -> None:
    """Of 1e140, before the gate is in force. The unscented filter keeps its covariance, and after a second failure in a row starts at its
    guess; the others keep the estimate and start with their first covariance."""
    run, reference = Instance(made(kind)), Reference(kind)
    for k in range(12):
        failed = k in (2, 3)
        run.set("y", 1e140 if failed else math.sin(k))
        run.step(k * TS, TS)
        if not failed:
            reference.sample(math.sin(k))
        elif kind != "ukf" or k == 3:
            reference.start()
            reference.x = GUESS if kind == "ukf" else reference.x
        assert (run.get("diagnostics.status") == CODE.solver_failed) == failed
        found = [run.get(f"filtered.{name}") for name in "ab"]
        np.testing.assert_allclose(found, reference.x, rtol=0, atol=1e-12, err_msg=str(k))
        reference.move()
        found = [run.get(f"diagnostics.std.{name}") for name in "ab"]
        np.testing.assert_allclose(found, np.sqrt(np.diag(reference.S)), rtol=1e-12, err_msg=str(k))
        assert run.get("diagnostics.solver_failures") == min(max(k - 1, 0), 2)
    assert run.get("diagnostics.restarts") == 0


CLIFF = Model(
    name="cliff",
    states=[Variable("a", start=0.4)],
    outputs=[Variable("y")],
    ode=lambda x, u, p, t: [ca.if_else(ca.logic_and(t > 0.105, t < 0.195), ca.exp(800 + x.a), 0)],
    output=lambda x, u, p, t: [x.a],
)
TOLD = {"measurement_noise": {"y": 0.2}, "initial_std": {"a": 1.0}}
ALL: dict[str, Callable[[], Component]] = {
    "ukf": lambda: ukf(CLIFF, sample_time=TS, **TOLD, process_noise={"a": 0.5}),
    "riccati": lambda: riccati(CLIFF, sample_time=TS, **TOLD, process_noise={"a": 0.5}),
    "least_squares": lambda: least_squares(CLIFF, sample_time=TS, T=100.0, linearise=True, max_step=TS, **TOLD),
    "canonical_dae": lambda: canonical_dae(CLIFF, sample_time=TS, max_step=TS),
    "elementary": lambda: elementary(CLIFF, sample_time=TS, N=4),
    "pseudospectral": lambda: pseudospectral(CLIFF, sample_time=TS, N=4),
}


@pytest.mark.parametrize("kind", ALL)
def test_a_motion_that_escapes_undoes_the_last_sample_and_one_that_escapes_again_starts_from_the_guess(
    kind: str,
) -> None:
    """The model has no motion from 0.105 to 0.195 s; before and after, its state is constant."""
    run = Instance(ALL[kind]())
    run.set("y", 1.0)
    run.step(0.0, TS)
    predicted = run.get("estimate.a")
    run.set("y", 3.0)
    for k, back in enumerate((predicted, 0.4)):
        run.step(0.1 + 0.05 * k, 0.05)
        assert run.get("estimate.a") == back and run.get("diagnostics.trusted") == 0
        assert kind == "elementary" or run.get("filtered.a") == back
        assert run.get("diagnostics.status") == CODE.solver_failed
        assert run.get("diagnostics.solver_failures") == k + 1
    run.set("y", 2.0)
    run.step(0.2, TS)
    assert run.get("diagnostics.solver_failures") == 2 and run.get("diagnostics.status") != CODE.solver_failed


@pytest.mark.parametrize("kind", KINDS)
def test_after_an_escape_the_first_covariance_counts(kind: str) -> None:
    """Of a state that does not move: closed form. `half`: the part of a weight that the first sample of an interval has."""
    rate, half = 0.25 * (kind != "least_squares"), 0.5 if kind == "least_squares" else 1.0
    late = kind == "ukf"  # which takes its noise in at the next sample
    run = Instance(ALL[kind]())

    def correction(P: float, x: float, y: float) -> tuple[float, float]:
        K = P / (P + R / half)
        return x + K * (y - x), (1 - K) ** 2 * P + K**2 * R

    run.set("y", 1.0)
    run.step(0.0, TS)
    x, P = correction(1 + TS * rate * late, 0.4, 1.0)
    assert run.get("estimate.a") == pytest.approx(x, rel=1e-14)
    assert run.get("diagnostics.std.a") == pytest.approx(math.sqrt(P + TS * rate), rel=1e-14)
    for k in range(2):
        run.step(0.1 + 0.05 * k, 0.05)
        gone = 0.05 * (k + 1) * rate * late
        assert run.get("diagnostics.std.a") == pytest.approx(math.sqrt(1 + gone), rel=1e-14)
    run.set("y", 2.0)
    run.step(0.2, TS)
    x, P = correction(1 + TS * rate * late, 0.4, 2.0)
    assert run.get("filtered.a") == pytest.approx(x, rel=1e-14)
    assert run.get("diagnostics.std.a") == pytest.approx(math.sqrt(P + TS * rate), rel=1e-14)
