"""The paper's Examples 4 and 5, under noise, through the built FMUs and the master."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cosim.master import run
from cosim.results import Result


def output_error(result: Result) -> np.ndarray:
    """Estimated minus true clean output at the sample instants after 15 s."""
    found = result["observer.filtered.x1"][1:] + 0.5 * result["observer.filtered.x2"][1:]
    true = result["plant.x.x1"][:-1] + 0.5 * result["plant.x.x2"][:-1]
    return (found - true)[result.time[:-1] >= 15]


def test_example_4_without_bounds_leaves_a_quarter_of_the_noise(catalogue_system: Callable[[str], Path]) -> None:
    """Noise of 0.577 rms; a long window averages it, as the paper's first rule says."""
    system = catalogue_system("gong_example_4_plain")
    rms = [
        np.sqrt(np.mean(output_error(run(system, overrides={"plant.sensor.seed": seed})) ** 2)) for seed in range(10)
    ]
    assert np.median(rms) <= 0.16 and max(rms) <= 0.2, rms


@pytest.mark.parametrize("name", ["gong_example_5", "gong_example_5_ukf"])
def test_example_5_finds_the_jumping_theta_under_noise(catalogue_system: Callable[[str], Path], name: str) -> None:
    """Both observers do: the paper's UKF, which fails, has no process noise on theta."""
    rng = np.random.default_rng(0)
    for seed in range(5):
        x1, x2 = rng.uniform(-1, 1, 2)
        overrides = {"plant.sensor.seed": seed, "plant.start.x1": x1, "plant.start.x2": x2}
        result = run(catalogue_system(name), overrides=overrides)
        assert np.isfinite(result.values).all()
        t = result.time[:-1]
        settled = ((t > 6) & (t <= 15)) | ((t > 21) & (t <= 35)) | (t > 41)
        error = result["observer.filtered.theta"][1:] - result["plant.x.theta"][:-1]
        assert np.sqrt(np.mean(error[settled] ** 2)) <= 0.03
