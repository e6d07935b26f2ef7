"""A correction or a motion that fails leaves no trace but a count, and the next sample starts clean: against the Kalman filter."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

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


def cliff(*begins: float, rate: float = 0.0, length: float = 0.09) -> Model:
    """Its state moves evenly, but for `length` seconds from each of `begins` on, in which it has no motion."""

    def gone(t: Any) -> Any:
        cliffs = [ca.logic_and(t > begin, t < begin + length) for begin in begins]
        return functools.reduce(ca.logic_or, cliffs)

    return Model(
        name="cliff",
        states=[Variable("a", start=0.4)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [ca.if_else(gone(t), ca.exp(800 + x.a), rate)],
        output=lambda x, u, p, t: [x.a],
    )


TOLD = {"measurement_noise": {"y": 0.2}, "initial_std": {"a": 1.0}}
ALL: dict[str, Callable[[Model], Component]] = {
    "ukf": lambda model: ukf(model, sample_time=TS, **TOLD, process_noise={"a": 0.5}),
    "riccati": lambda model: riccati(model, sample_time=TS, **TOLD, process_noise={"a": 0.5}),
    "least_squares": lambda model: least_squares(model, sample_time=TS, T=100.0, linearise=True, max_step=TS, **TOLD),
    "canonical_dae": lambda model: canonical_dae(model, sample_time=TS, max_step=TS),
    "elementary": lambda model: elementary(model, sample_time=TS, N=4),
    "pseudospectral": lambda model: pseudospectral(model, sample_time=TS, N=4),
}


@pytest.mark.parametrize("kind", ALL)
def test_a_motion_that_escapes_undoes_the_last_sample_and_one_that_escapes_again_starts_from_the_guess(
    kind: str,
) -> None:
    """After eight samples at the truth and one that is a little off it. The pseudospectral observer starts from the guess at once."""
    run = Instance(ALL[kind](cliff(0.805, rate=0.3)))
    for k in range(8):
        run.set("y", 1 + 0.03 * k)
        run.step(0.1 * k, TS)
    predicted = run.get("estimate.a")
    assert abs(predicted - 1.24) < 0.01
    run.set("y", 1.245)
    for k, back in enumerate((0.4 if kind == "pseudospectral" else predicted, 0.4)):
        run.step(0.8 + 0.05 * k, 0.05)
        assert run.get("estimate.a") == back
        if kind in ("elementary", "pseudospectral"):  # of the sample, whatever became of it
            assert 1.24 < run.get("filtered.a") < 1.245
        else:
            assert run.get("filtered.a") == back
        assert run.get("diagnostics.status") == CODE.solver_failed and run.get("diagnostics.trusted") == 0
        assert run.get("diagnostics.solver_failures") == k + 1
    run.set("y", 1.0)
    run.step(0.9, TS)
    assert run.get("diagnostics.solver_failures") == 2 and run.get("diagnostics.status") != CODE.solver_failed


@pytest.mark.parametrize("kind", ["elementary", "canonical_dae"])
def test_the_sample_after_an_undone_one_is_no_place_to_go_back_to(kind: str) -> None:
    """What escapes once more after it starts from the guess, and what escapes after the one that follows goes back again."""
    run = Instance(ALL[kind](cliff(0.805, 0.905, rate=0.3, length=0.04)))
    for k in range(10):
        before = run.get("estimate.a")
        run.set("y", 1 + 0.03 * k)
        run.step(0.1 * k, 0.05)
        if k >= 8:
            assert run.get("estimate.a") == (before if k == 8 else 0.4)
        run.step(0.1 * k + 0.05, 0.05)
    assert abs(before - 1.255) < 0.01  # half a sample time after the sample before the escape
    assert run.get("diagnostics.solver_failures") == 2


@pytest.mark.parametrize("kind", KINDS)
def test_after_an_escape_the_first_covariance_counts(kind: str) -> None:
    """Of a state that does not move: closed form. `half`: the part of a weight that the first sample of an interval has."""
    rate, half = 0.25 * (kind != "least_squares"), 0.5 if kind == "least_squares" else 1.0
    late = kind == "ukf"  # which takes its noise in at the next sample
    run = Instance(ALL[kind](cliff(0.105)))

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
