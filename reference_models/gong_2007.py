"""The experiments of Gong, Ross & Kang, "A pseudospectral observer for nonlinear systems", 2007: Examples 1 to 6."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from observers.component import Component
from observers.pseudospectral import pseudospectral
from observers.ukf import ukf
from reference_models.duffing import DUFFING, DUFFING_KNOWN
from reference_models.plant import plant
from reference_models.recipe import Recipe, Source
from reference_models.rlc import RLC
from reference_models.sine import sine

# The paper's first guess (0, 0, 0.1), of a plant that starts at (2, 1, 0.4).
GUESS = {"x1": 0.0, "x2": 0.0, "theta": 0.1}
# The paper's window of 5 s. While it fills with noisy samples its one polynomial of order 50 fails 13 times as often as five of order 13,
# which join in as the samples arrive and take a quarter of the time.
LONG_WINDOW: dict[str, Any] = {"N": 13, "L": 50, "segments": 5}
RLC_GUESS = {"x1": 4.1, "x2": 0.0, "x3": 2.8}  # of a plant that starts at (4, 1.5, 2.7)


@cache
def duffing() -> Component:
    return plant(DUFFING, jumps={"theta": 2})


@cache
def rlc() -> Component:
    """Ends before the trajectory from its start values reaches the singularity at 4.095 s."""
    return plant(RLC, max_step=1e-3, stop_time=4.0, step_size=0.05)


FMUS: dict[str, Source] = {
    "duffing": (duffing, None),
    "duffing_pseudospectral": (lambda: pseudospectral(DUFFING, sample_time=0.1, N=15, L=8, guess=GUESS), duffing),
    "duffing_pseudospectral_spline": (
        lambda: pseudospectral(
            DUFFING, sample_time=0.1, N=15, L=8, cost="spline", guess=GUESS, name="duffing_pseudospectral_spline"
        ),
        duffing,
    ),
    "duffing_pseudospectral_3a": (
        lambda: pseudospectral(
            DUFFING, sample_time=0.01, N=15, L=80, guess=GUESS, name="duffing_pseudospectral_3a", stop_time=50.0
        ),
        duffing,
    ),
    "duffing_pseudospectral_3b": (
        lambda: pseudospectral(
            DUFFING, sample_time=0.5, N=50, L=10, guess=GUESS, name="duffing_pseudospectral_3b", stop_time=50.0
        ),
        duffing,
    ),
    "duffing_ukf": (
        lambda: ukf(
            DUFFING,
            sample_time=0.1,
            process_noise={"x1": 1e-4, "x2": 1e-4, "theta": 0.03},
            measurement_noise={"y": 1e-3},
            guess=GUESS,
        ),
        duffing,
    ),
    "duffing_pseudospectral_5": (
        lambda: pseudospectral(DUFFING, sample_time=0.1, **LONG_WINDOW, guess=GUESS, name="duffing_pseudospectral_5"),
        duffing,
    ),
    "duffing_known_pseudospectral": (
        lambda: pseudospectral(
            DUFFING_KNOWN, sample_time=0.1, **LONG_WINDOW, guess={"x1": 0.0, "x2": 0.0}, stop_time=60.0
        ),
        duffing,
    ),
    "rlc": (rlc, None),
    "duffing_known_pseudospectral_tube": (
        lambda: pseudospectral(
            DUFFING_KNOWN,
            sample_time=0.1,
            **LONG_WINDOW,
            noise_bound=1.0,
            guess={"x1": 0.0, "x2": 0.0},
            name="duffing_known_pseudospectral_tube",
            stop_time=60.0,
        ),
        duffing,
    ),
    "rlc_pseudospectral": (
        lambda: pseudospectral(RLC, sample_time=0.2, N=15, L=5, guess=RLC_GUESS, stop_time=4.0),
        rlc,
    ),
    "sine": (sine, None),
}


START = {"start.x1": 2.0, "start.x2": 1.0}
JUMPS = {
    "parameter.theta": 0.4,
    "parameter.theta_jump_time[1]": 10.0,
    "parameter.theta_jump_value[1]": 0.1,
    "parameter.theta_jump_time[2]": 20.0,
    "parameter.theta_jump_value[2]": 0.3,
}


NOISY_JUMPS = {
    "start.x1": 0.5,
    "start.x2": -0.5,
    "parameter.theta": 0.4,
    "parameter.theta_jump_time[1]": 15.0,
    "parameter.theta_jump_value[1]": 0.1,
    "parameter.theta_jump_time[2]": 35.0,
    "parameter.theta_jump_value[2]": 0.6,
    "sensor.noise_bound": 0.1,
    "sensor.sample_time": 0.1,
}


def _gong(
    description: str,
    fmu: str = "duffing_pseudospectral",
    *,
    stop: float = 50.0,
    step: float = 0.1,
    plant: Mapping[str, float] | None = None,
    observer: Mapping[str, float] | None = None,
) -> Recipe:
    """An example of Gong, Ross & Kang 2007: the Duffing plant from (2, 1) and an observer that starts at (0, 0, 0.1)."""
    parameters = {"plant": START | dict(plant or {}), "observer": dict(observer or {})}
    return Recipe(description, {"plant": "duffing", "observer": fmu}, parameters, stop, step)


SYSTEMS: dict[str, Recipe] = {
    "gong_example_1": _gong("Example 1: chaotic Duffing system with unknown theta"),
    "gong_example_1_spline": _gong("Example 1 with the paper's spline cost", "duffing_pseudospectral_spline"),
    "gong_example_1_input": Recipe(
        "Example 1 with a known input u = sin t",
        {"source": "sine", "plant": "duffing", "observer": "duffing_pseudospectral"},
        {"plant": START},
        50.0,
        0.1,
        (("source.y", "plant.u"), ("source.y", "observer.u"), ("plant.y", "observer.y")),
    ),
    "gong_example_2": _gong(
        "Example 2: theta jumps at t = 10 and t = 20", stop=30.0, plant=JUMPS, observer={"tuning.residual_limit": 1e-6}
    ),
    "gong_example_2_ukf": _gong("Example 2 with an unscented Kalman filter", "duffing_ukf", stop=30.0, plant=JUMPS),
    "gong_example_3a": _gong("Example 3: sampled every 0.01 s, L = 80, N = 15", "duffing_pseudospectral_3a", step=0.01),
    "gong_example_3b": _gong("Example 3: sampled every 0.5 s, L = 10, N = 50", "duffing_pseudospectral_3b", step=0.5),
    "gong_example_4_plain": _gong(
        "Example 4: theta known, noise in [-1, 1], L = 50, without bounds on the noise",
        "duffing_known_pseudospectral",
        stop=60.0,
        plant={"start.x1": 1.0, "start.x2": 2.0, "sensor.noise_bound": 1.0, "sensor.sample_time": 0.1},
    ),
    "gong_example_4_tube": _gong(
        "Example 4 with the tube (38) around the output and Problem 3",
        "duffing_known_pseudospectral_tube",
        stop=60.0,
        plant={"start.x1": 1.0, "start.x2": 2.0, "sensor.noise_bound": 1.0, "sensor.sample_time": 0.1},
    ),
    "gong_example_6": Recipe(
        "Example 6: RLC circuit with a nonlinear capacitor, a DAE",
        {"plant": "rlc", "observer": "rlc_pseudospectral"},
        {},
        4.0,
        0.2,
    ),
    "gong_example_5": _gong(
        "Example 5: theta jumps at t = 15 and t = 35, noise in [-0.1, 0.1], L = 50",
        "duffing_pseudospectral_5",
        plant=NOISY_JUMPS,
        observer={"tuning.residual_limit": 0.1},
    ),
    "gong_example_5_ukf": _gong(
        "Example 5 with an unscented Kalman filter",
        "duffing_ukf",
        plant=NOISY_JUMPS,
        observer={"tuning.process_noise.theta": 0.03, "tuning.measurement_noise.y": 0.0577},
    ),
}
