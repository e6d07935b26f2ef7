"""Tuning finds the noises that the data hold: the exact maximum of the likelihood, the true noises, the smallest error ahead."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize

from cosim.fmu import read_description
from cosim.system.parameter_set import write_parameter_set
from cosim.tuning import tune
from cosim.tuning.trial import HELD_BACK
from simulated import TS, F, added, diffusion, swing, write_log

Build = Callable[[str], Path]
NAMES = ("tuning.process_noise.v", "tuning.measurement_noise.y", "tuning.initial_std.s", "tuning.initial_std.v")
STILL = {"tuning.process_noise.s": "1e-9"}  # the record has none of it
TRUE = (0.4, 0.1)  # intensity of the speed, deviation of a sample


def log_densities(y: np.ndarray, noises: np.ndarray) -> np.ndarray:
    """Of each sample given those before it, (n,), by the textbook's Kalman filter from the guess 0."""
    intensity, sensor, *initial = noises
    x, P, Q, found = np.zeros(2), np.diag(np.square(initial)), added(intensity), np.empty(len(y))
    for k, measured in enumerate(y):
        S = P[0, 0] + sensor**2
        found[k] = -0.5 * (math.log(2 * math.pi * S) + (measured - x[0]) ** 2 / S)
        K = P[:, 0] / S
        x, P = F @ (x + K * (measured - x[0])), F @ (P - np.outer(K, P[0])) @ F.T + Q
    return found


@pytest.fixture(scope="module")
def y() -> np.ndarray:
    return swing(480, 2, *TRUE)


@pytest.fixture(scope="module")
def log(y: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("logs") / "swing.csv", TS, y=y)


def test_it_finds_the_maximum_of_the_likelihood_and_judges_by_what_was_held_back(
    built: Build, log: Path, y: np.ndarray
) -> None:
    made = tune(built("moved_riccati"), [log], overrides=STILL)
    fitted = y[: len(y) - round(HELD_BACK * len(y))]
    start = np.log([p.start for p in made.parameters])
    near = np.log([*TRUE, 1.0, 0.5])
    exact = minimize(lambda x: -log_densities(fitted, np.exp(x)).sum(), near, method="BFGS", options={"gtol": 1e-3})
    assert tuple(made.values) == NAMES
    assert made.fitted.after.value == pytest.approx(-exact.fun, abs=0.02)
    found = np.array(list(made.values.values()))
    np.testing.assert_allclose(np.log(found[:2]), exact.x[:2], rtol=0, atol=0.01)
    np.testing.assert_allclose(found[:2], TRUE, rtol=0.2)
    for noises, part in ((np.exp(start), made.held_back.before), (found, made.held_back.after)):
        assert part.value == pytest.approx(log_densities(y, noises)[len(fitted) :].sum(), rel=1e-6)
    # The deviations are those of the likelihood's curvature, which BFGS estimates too.
    deviations = [made.deviations[name] for name in NAMES[:2]]
    assert deviations == pytest.approx(np.sqrt(np.diag(exact.hess_inv))[:2], rel=0.3)
    low, high = made.fitted.consistent_after.band
    assert low < made.fitted.consistent_after.nis < high and made.fitted.consistent_after.whiteness > 0.01


def test_a_noise_that_is_set_is_not_tuned_and_one_that_the_data_do_not_tell_is_named(built: Build, log: Path) -> None:
    held = {**STILL, "tuning.measurement_noise.y": "0.1", "tuning.initial_std.s": "1"}
    made = tune(built("moved_riccati"), [log], overrides=held)
    assert tuple(made.values) == ("tuning.process_noise.v", "tuning.initial_std.v")
    assert made.given == {name: float(value) for name, value in held.items()}
    # One start is one draw: its deviation has a curvature of 2, and so is known to a factor of two at the best.
    assert any("tuning.initial_std.v is not determined" in warning for warning in made.warnings)


def test_the_error_ahead_is_that_of_the_models_prediction_and_becomes_smaller(
    built: Build, log: Path, y: np.ndarray
) -> None:
    """The Kalman filter's estimates of every fifth sample, propagated by the model, against the sample five later."""
    ahead, sensor = 5, {"tuning.measurement_noise.y": "0.5"}
    made = tune(built("moved_riccati"), [log], ahead=ahead, overrides=STILL | sensor)
    assert tuple(made.values) == ("tuning.process_noise.v",)
    errors = {}
    for intensity in (0.3, made.values["tuning.process_noise.v"]):
        x, P, found = np.zeros(2), np.diag([4.0, 1.0]), []
        for k, measured in enumerate(y):
            if k % ahead == 0 and 48 <= k <= 360 - ahead:  # of which the first tenth tells of the guess
                found.append(y[k + ahead - 1] - (np.linalg.matrix_power(F, ahead - 1) @ x)[0])
            K = P[:, 0] / (P[0, 0] + 0.5**2)
            x, P = F @ (x + K * (measured - x[0])), F @ (P - np.outer(K, P[0])) @ F.T + added(intensity)
        errors[intensity] = math.sqrt(np.mean(np.square(found)))
    before, after = errors.values()
    assert (made.fitted.before.rms["y"], made.fitted.after.rms["y"]) == pytest.approx((before, after), rel=1e-6)
    assert after < before
    # With the gain of the true noises: their ratio counts, not their scale.
    assert made.values["tuning.process_noise.v"] / 0.5 == pytest.approx(TRUE[0] / TRUE[1], rel=0.7)


def test_two_logs_are_two_starts_of_one_observer(built: Build, tmp_path: Path) -> None:
    logs = [write_log(tmp_path / f"{seed}.csv", TS, y=swing(200, seed, *TRUE, start=(seed, 1.0))) for seed in (3, 4)]
    fmu = built("moved_riccati")
    held = {**STILL, "tuning.initial_std.s": "2", "tuning.initial_std.v": "1"}
    both = tune(fmu, logs, overrides=held)
    exact = minimize(
        lambda x: (
            -sum(
                log_densities(swing(200, seed, *TRUE, start=(seed, 1.0))[:150], np.array([*np.exp(x), 2.0, 1.0])).sum()
                for seed in (3, 4)
            )
        ),
        np.log([0.3, 0.2]),
        method="BFGS",
    )
    np.testing.assert_allclose(np.log(list(both.values.values())), exact.x, rtol=0, atol=0.01)


def test_samples_that_did_not_arrive_do_not_count(built: Build, y: np.ndarray, tmp_path: Path) -> None:
    """What stands in their place may be anything."""
    arrived = np.random.default_rng(6).random(len(y)) > 0.2
    held = {**STILL, "tuning.initial_std.s": "2", "tuning.initial_std.v": "1"}
    flags = {"measurement_valid.y": arrived.astype(int)}
    flagged = write_log(tmp_path / "flagged.csv", TS, y=np.where(arrived, y, 1e3), **flags)
    cells = (f"{k * TS!r},{repr(y[k].item()) if arrived[k] else ''}" for k in range(len(y)))
    empty = tmp_path / "empty.csv"
    empty.write_text("\n".join(["time,y", *cells, ""]))
    made = [tune(built("moved_riccati"), [log], overrides=held) for log in (flagged, empty)]
    assert made[0].values == made[1].values
    assert made[0].fitted.after.samples == arrived[:360].sum()
    np.testing.assert_allclose(list(made[0].values.values()), TRUE, rtol=0.25)


def test_an_observer_without_a_likelihood_is_tuned_by_its_error_ahead(built: Build, tmp_path: Path) -> None:
    """The pseudospectral observer's window, a model with process noise of one state: only its ratio to the measurement noise counts."""
    A = np.array([[0.0, 1.0, 0.0], [-2.0, -0.3, 1.0], [0.0, 0.0, -0.5]])
    rng = np.random.default_rng(1)
    x = diffusion(lambda x, t: A @ x, (0.0, 1.0, 0.0), (0.0, 0.9, 0.0), TS, 400, rng, substeps=5)
    log = write_log(
        tmp_path / "two.csv",
        TS,
        y1=x[:, 0] + 0.3 * rng.normal(size=400),
        y2=x[:, 0] + 0.5 * x[:, 2] + 0.5 * rng.normal(size=400),
    )
    description = read_description(built("linear_arrival"))
    start = tmp_path / "start.ssv"
    write_parameter_set(start, {"tuning.process_noise.x2": 0.3}, description)
    held = {"u": "0", "tuning.measurement_noise.y2": "0.5"}
    made = tune(built("linear_arrival"), [log], overrides=held, parameters=start)
    assert made.zeros == ("tuning.process_noise.x1", "tuning.process_noise.x3")
    assert tuple(made.values) == ("tuning.process_noise.x2",) and made.ahead == 1
    assert made.fitted.after.rms["y1"] < made.fitted.before.rms["y1"]
    assert made.values["tuning.process_noise.x2"] == pytest.approx(0.9, rel=0.4)
    assert math.isnan(made.fitted.consistent_after.nis)
