"""The measured Silverbox: the model and its fitted values explain the record, the evaluation is exact on exact estimates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import reference_models
from cosim.replay.log import read_log
from cosim.replay.replay import replay
from cosim.results import Result as Record
from fmu_src import export
from observers.component import Component
from observers.numerics.runge_kutta import runge_kutta
from observers.pseudospectral import pseudospectral
from observers.status import CODE
from once import compiled_once, plotted_briefly
from reference_models.silverbox import FMUS, GUESS, K1, K3, LEAST, MOST, OFF, SAMPLE_TIME, SILVERBOX
from reference_models.silverbox_evaluation import AHEAD, Evaluation, evaluate, predict

LOG = Path(reference_models.__file__).parent / "data" / "silverbox.csv.gz"


@pytest.fixture(scope="module")
def measured() -> tuple[np.ndarray, np.ndarray]:
    log = read_log(LOG)
    return log.numbers("u"), log.numbers("y")


def test_the_record_is_30_000_samples_without_an_offset(measured: tuple[np.ndarray, np.ndarray]) -> None:
    u, y = measured
    assert len(u) == len(y) == 30000
    assert abs(u.mean()) < 1e-6 and abs(y.mean()) < 1e-5
    assert 0.053 < y.std() < 0.057


def test_the_fitted_values_explain_a_free_run(measured: tuple[np.ndarray, np.ndarray]) -> None:
    """0.88 mV rms over the 2,000 samples that they were fitted to."""
    u, y = (signal[10000:12000] for signal in measured)
    eq, p = SILVERBOX.equations, [variable.start for variable in SILVERBOX.parameters]
    rate = ca.Function("rate", [eq.x, eq.u, eq.p, eq.theta, eq.t], [eq.ode])
    x, now, after = ca.SX.sym("x", 2), ca.SX.sym("now"), ca.SX.sym("after")
    moved = runge_kutta(
        lambda z, t: rate(z, now + (after - now) * t / SAMPLE_TIME, p, [K1, K3], t), x, ca.SX(0), ca.SX(SAMPLE_TIME)
    )
    simulate = ca.Function("step", [x, now, after], [moved]).mapaccum(1999)

    def gap(first: np.ndarray, count: int) -> np.ndarray:
        return np.r_[first[0], simulate(first, u[:-1], u[1:]).full()[0]][:count] - y[:count]

    # The first state is not in the record: it is what explains the first 40 samples.
    found = least_squares(gap, [y[0], (y[1] - y[0]) / SAMPLE_TIME], x_scale=[0.1, 43.0], args=(40,), diff_step=1e-4).x
    assert np.sqrt(np.mean(gap(found, 2000) ** 2)) < 1.0e-3


def test_the_evaluation_is_exact_on_exact_estimates_and_sees_wrong_ones() -> None:
    n = 2000
    time = np.arange(n) * SAMPLE_TIME
    u = 0.1 * np.sin(300 * time) + 0.05 * np.cos(750 * time)
    d, c = (variable.start for variable in SILVERBOX.parameters)

    def rhs(t: float, z: np.ndarray) -> list[float]:
        return [z[1], -d * z[1] - K1 * z[0] - K3 * z[0] ** 3 + c * np.interp(t, time, u)]

    x = solve_ivp(rhs, (0.0, time[-1]), [0.05, 3.0], t_eval=time, max_step=SAMPLE_TIME / 4, rtol=1e-9, atol=1e-12).y.T
    exact = np.column_stack([x, np.full(n, K1), np.full(n, K3)])
    found = evaluate(exact, u, x[:, 0])
    assert found.k1_deviation == found.k3_deviation == 0 and found.prediction_rms < 1e-7
    assert predict(exact, u).shape == (n - AHEAD,)
    wrong = evaluate(exact * [1, 1, 1.05, 0.9], u, x[:, 0])
    assert wrong.k1_deviation == pytest.approx(0.05) and wrong.k3_deviation == pytest.approx(-0.1)
    assert wrong.prediction_rms > 1e-3


def exported(component: Component, folder: Path) -> Path:
    """The FMU, optimised: over 30,000 samples that takes less time than it saves."""
    with compiled_once(), plotted_briefly():
        return export(component, folder)


@pytest.mark.long
def test_the_filter_finds_the_stiffness_in_the_measurement_30_percent_off(
    measured: tuple[np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    """To the accuracy that its documentation states: with the input linear between samples, as the model says."""
    made = replay(exported(FMUS["silverbox_ukf"][0](), tmp_path), LOG, sample_time=SAMPLE_TIME)
    filtered = np.column_stack([made.result[f"observer.filtered.{v}"][1:] for v in ("x1", "x2", "k1", "k3")])
    assert filtered[0, 2] == pytest.approx(0.7 * K1, rel=0.02)
    found = evaluate(filtered, *measured)
    assert abs(found.k1_deviation) < 0.003 and abs(found.k3_deviation) < 0.02 and found.prediction_rms < 1.1e-3
    assert made.result["observer.diagnostics.solver_failures"][-1] == 0


def replayed(fmu: Path, **options: Any) -> Record:
    """The whole measurement, through the FMU."""
    return replay(fmu, LOG, sample_time=SAMPLE_TIME, **options).result


def rated(result: Record, measured: tuple[np.ndarray, np.ndarray]) -> Evaluation:
    filtered = np.column_stack([result[f"observer.filtered.{v}"][1:] for v in ("x1", "x2", "k1", "k3")])
    assert np.isfinite(filtered).all()
    k1, k3 = filtered[:, 2] / K1, filtered[:, 3] / K3
    assert np.all((k1 >= LEAST) & (k1 <= MOST) & (k3 >= LEAST) & (k3 <= MOST))
    assert k1[0] == pytest.approx(OFF, rel=0.02)
    return evaluate(filtered, *measured)


@pytest.mark.long
def test_a_window_of_200_samples_finds_the_stiffness_in_the_measurement(
    measured: tuple[np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    result = replayed(exported(FMUS["silverbox_pseudospectral"][0](), tmp_path))
    found = rated(result, measured)
    assert abs(found.k1_deviation) <= 0.005 and abs(found.k3_deviation) <= 0.05
    assert found.prediction_rms <= 1.2e-3  # of a signal of 55 mV
    assert result["observer.diagnostics.solver_failures"][-1] == 0
    status = result["observer.diagnostics.status"][1:]
    # Three samples do not suffice for four unknowns, and few more do not determine k3.
    assert set(status[:3]) == {CODE.propagated_guess} and set(status[3:6]) == {CODE.undetermined}
    assert CODE.undetermined not in status[20:]


@pytest.mark.long
def test_a_window_of_50_samples_does_so_with_an_arrival_cost(
    measured: tuple[np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    result = replayed(exported(FMUS["silverbox_pseudospectral_short"][0](), tmp_path))
    found = rated(result, measured)
    assert abs(found.k1_deviation) <= 0.005 and abs(found.k3_deviation) <= 0.05
    assert found.prediction_rms <= 1.5e-3
    assert result["observer.diagnostics.solver_failures"][-1] == 0


@pytest.mark.long
def test_a_window_of_50_samples_alone_does_not_determine_k3_and_says_so(
    measured: tuple[np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    """By its conditioning: the less of it, the worse k3; and by its status, where that has a limit to go by."""
    component = pseudospectral(
        SILVERBOX, sample_time=SAMPLE_TIME, N=6, L=50, segments=25, guess=GUESS, name="silverbox_alone"
    )
    fmu = exported(component, tmp_path)
    result = replayed(fmu)
    found = rated(result, measured)
    assert found.prediction_rms > 1.8e-3 and abs(found.k3_deviation) > 0.05
    settled = np.arange(len(measured[0])) > 300
    conditioning, status, k3 = (
        result[f"observer.{name}"][1:] for name in ("diagnostics.conditioning", "diagnostics.status", "filtered.k3")
    )
    solved = settled & np.isin(status, [CODE.estimating, CODE.uncertain])
    error = np.abs(k3 / K3 - 1)
    certain = settled & (status == CODE.estimating)
    assert 0.1 < np.mean(status == CODE.uncertain) < 0.5
    assert np.quantile(error[certain], 0.9) < 0.8 * np.quantile(error[solved], 0.9)
    poor, fair, good = (
        np.median(error[solved & (low <= conditioning) & (conditioning < high)])
        for low, high in ((0, 1e-5), (1e-5, 1e-4), (1e-4, 1))
    )
    assert poor > 2 * fair > 4 * good, (poor, fair, good)

    limited = replayed(fmu, overrides={"tuning.conditioning_limit": 1e-5})
    status, k3 = limited["observer.diagnostics.status"][1:], limited["observer.filtered.k3"][1:]
    assert 0.1 < np.mean(status == CODE.undetermined) < 0.5
    trusted = settled & (status == CODE.estimating)
    assert np.quantile(np.abs(k3[trusted] / K3 - 1), 0.9) < 0.8 * np.quantile(error[solved], 0.9)
