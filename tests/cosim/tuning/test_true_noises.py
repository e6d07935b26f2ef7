"""Tuning finds the noises of nonlinear systems within 20 %, from a start that is wrong by factors of 5 to 500."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cosim.tuning import tune
from fmu_src import export
from observers.riccati import riccati
from observers.ukf import ukf
from once import compiled_once
from reference_models.cell import CELL
from reference_models.duffing import DUFFING
from simulated import diffusion, write_log

Build = Callable[[str], Path]
WITHIN = 0.2


def duffing_log(path: Path) -> Path:
    """Noise on velocity and forcing, samples with a deviation of 0.02 m."""
    rng = np.random.default_rng(1)

    def rate(x: np.ndarray, t: float) -> np.ndarray:
        return np.array([x[1], -0.25 * x[1] + x[0] * (1 - x[0] ** 2) + x[2] * np.cos(t), 0.0])

    x = diffusion(rate, (2.0, 1.0, 0.4), (0.0, 0.1, 0.05), 0.1, 3000, rng, substeps=5)
    return write_log(path, 0.1, y=x[:, 0] + 0.5 * x[:, 1] + 0.02 * rng.normal(size=len(x)))


def check(found: dict[str, float], true: dict[str, float]) -> None:
    assert {name: found[f"tuning.{name}"] for name in true} == pytest.approx(true, rel=WITHIN)


HELD = {"u": "0", "tuning.process_noise.x1": "1e-5", "tuning.initial_std.x1": "2", "tuning.initial_std.x2": "2"}
HELD |= {"tuning.initial_std.theta": "1"}
DUFFINGS_TRUE = {"process_noise.x2": 0.1, "process_noise.theta": 0.05, "measurement_noise.y": 0.02}


@pytest.mark.long
def test_of_the_duffing_system_by_the_unscented_filter_of_the_catalogue(catalogue_fmu: Build, tmp_path: Path) -> None:
    log = duffing_log(tmp_path / "duffing.csv")
    check(dict(tune(catalogue_fmu("duffing_ukf"), [log], overrides=HELD).values), DUFFINGS_TRUE)


@pytest.mark.long
def test_of_the_duffing_system_by_the_riccati_observer_with_everything_at_its_default(tmp_path: Path) -> None:
    with compiled_once(optimised=False):
        fmu = export(riccati(DUFFING, sample_time=0.1), tmp_path)
    log = duffing_log(tmp_path / "duffing.csv")
    check(dict(tune(fmu, [log], overrides=HELD).values), DUFFINGS_TRUE)


@pytest.mark.long
def test_of_a_lithium_ion_cell(tmp_path: Path) -> None:
    """Noise on the voltage of the RC branch and on the series resistance, which wanders from 30 to 10 mOhm; samples of 2 mV."""
    n, rng = 3000, np.random.default_rng(1)
    t = np.arange(n)
    pulses = np.where(t % 120 < 20, 1.5, 0.0) - np.where((t % 120 > 60) & (t % 120 < 70), 1.2, 0.0)
    i = 2.9 * (0.4 + 1.2 * np.sin(0.2 * t) * np.sin(0.037 * t) + pulses)

    def rate(x: np.ndarray, time: float) -> np.ndarray:
        u = i[int(time)]  # held
        return np.array([-u / 10440.0, -x[1] / 40.0 + u / 2000.0, 0.0])

    x = diffusion(rate, (0.9, 0.0, 0.03), (0.0, 5e-4, 2e-4), 1.0, n, rng, substeps=5)
    soc = x[:, 0]
    ocv = -1.031 * np.exp(-35 * soc) + 3.685 + 0.2156 * soc - 0.1178 * soc**2 + 0.3201 * soc**3
    log = write_log(tmp_path / "cell.csv", 1.0, i=i, v=ocv - x[:, 1] - x[:, 2] * i + 2e-3 * rng.normal(size=n))
    cell = ukf(
        CELL,
        sample_time=1.0,
        process_noise={"soc": 1e-7, "v1": 1e-4, "R0": 1e-5},
        measurement_noise={"v": 0.01},
        initial_std={"soc": 0.1, "v1": 0.02, "R0": 0.02},
        guess={"soc": 0.8, "R0": 0.02},
    )
    with compiled_once(optimised=False):
        fmu = export(cell, tmp_path)
    held = {"tuning.process_noise.soc": "1e-7"} | {f"tuning.initial_std.{name}": "0.02" for name in ("v1", "R0")}
    made = tune(fmu, [log], overrides={**held, "tuning.initial_std.soc": "0.1"})
    check(dict(made.values), {"process_noise.v1": 5e-4, "process_noise.R0": 2e-4, "measurement_noise.v": 2e-3})
    assert made.held_back.after.value > made.held_back.before.value
    assert made.held_back.consistent_before.whiteness < 1e-6 < 0.01 < made.held_back.consistent_after.whiteness
