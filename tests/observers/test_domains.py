"""Nothing that a model meets ends a run: no measurement, no iterate and no parameter in its range is an error of the step."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from domain_models import MODELS, SAMPLE_TIMES
from observers.canonical_dae import canonical_dae
from observers.component import Component, bounds
from observers.elementary import elementary
from observers.instance import Instance
from observers.least_squares import least_squares
from observers.model import Model, ModelError
from observers.pseudospectral import pseudospectral
from observers.riccati import riccati
from observers.ukf import ukf
from reference_models.plant import plant

Make = Callable[[Model, float], Component]
KINDS: dict[str, Make] = {
    "pseudospectral": lambda m, Ts: pseudospectral(m, sample_time=Ts, N=6, L=8),
    "segments": lambda m, Ts: pseudospectral(m, sample_time=Ts, N=4, L=8, segments=4),
    "arrival": lambda m, Ts: pseudospectral(m, sample_time=Ts, N=6, L=8, arrival_cost=True),
    "tube": lambda m, Ts: pseudospectral(m, sample_time=Ts, N=5, L=6, noise_bound=0.1),
    "spline": lambda m, Ts: pseudospectral(m, sample_time=Ts, N=6, L=8, cost="spline"),
    "ukf": lambda m, Ts: ukf(m, sample_time=Ts),
    "riccati": lambda m, Ts: riccati(m, sample_time=Ts),
    "least_squares": lambda m, Ts: least_squares(m, sample_time=Ts, T=20 * Ts, linearise=True),
    "canonical_dae": lambda m, Ts: canonical_dae(m, sample_time=Ts),
    "elementary": lambda m, Ts: elementary(m, sample_time=Ts, N=8, K=3),
}
# What a sensor can come out with instead of a measurement.
ABSURD = (math.nan, math.inf, -math.inf, 1e4, -1e4, 0.0, -1.0, 1e30, -1e30, 1e200, -1e300)
SHORT = 16  # samples of a run: twice a window
BUILDS_NOT = {  # each with the reason that its message names
    ("canonical_dae", "two_tanks"): "not observable",
    ("canonical_dae", "diode"): "not observable",
}


PAIRS = [(kind, name) for kind in KINDS for name in MODELS if (kind, name) not in BUILDS_NOT]


@cache
def made(kind: str, name: str) -> tuple[Component, float]:
    sample_time = SAMPLE_TIMES.get(name, 0.1)
    return KINDS[kind](MODELS[name], sample_time), sample_time


def measurements(name: str, sample_time: float, count: int) -> list[dict[str, float]]:
    """What the plant, excited and with a noisy sensor, gives its observer: up to 120 samples."""
    return [dict(row) for row in longest(name, sample_time)[:count]]


@cache
def longest(name: str, sample_time: float) -> list[dict[str, float]]:
    model = MODELS[name]
    component = plant(model, max_step=0.01)
    noise = {port.name: 0.02 for port in component.parameters if port.name.startswith("sensor.noise_std")}
    truth = Instance(component, {**noise, "sensor.sample_time": sample_time})
    rows = []
    for k in range(120):
        swing = 1 + 0.3 * math.sin(0.2 * k)
        held = {v.name: v.start * swing for v in model.inputs}
        for input_name, value in held.items():
            truth.set(input_name, value)
        rows.append(held | {v.name: truth.get(v.name) for v in model.outputs})
        truth.step(k * sample_time, sample_time)
    return rows


def run(instance: Instance, rows: list[dict[str, float]], sample_time: float) -> None:
    """Steps through `rows`; every output is finite after each step, and no step is refused."""
    for k, row in enumerate(rows):
        for name, value in row.items():
            instance.set(name, value)
        instance.step(k * sample_time, sample_time)
        values = instance.outputs()
        assert np.all(np.isfinite(values)), (k, row, values)


@pytest.mark.parametrize(("kind", "name"), PAIRS)
def test_no_measurement_ends_the_run(kind: str, name: str) -> None:
    component, sample_time = made(kind, name)
    rows = measurements(name, sample_time, 120)
    random = np.random.default_rng(1)
    outputs = [v.name for v in MODELS[name].outputs]
    for k in range(15, 90):  # one in five, in bursts too
        if random.random() < (0.8 if 60 < k < 70 else 0.2):
            rows[k][random.choice(outputs)] = random.choice(ABSURD)
    run(Instance(component), rows, sample_time)


@pytest.mark.parametrize(("kind", "name"), PAIRS)
def test_no_guess_ends_the_run(kind: str, name: str) -> None:
    """A first guess outside the equations' domain, far away, or at the edge."""
    component, sample_time = made(kind, name)
    rows = measurements(name, sample_time, SHORT)
    guesses = [port for port in component.parameters if port.name.startswith("guess.")]
    for port in guesses:
        low, high = bounds(port)
        for value in (-1.0, 0.0, 1e4, 1e60, -1e100, low, high):
            if low <= value <= high and math.isfinite(value):
                run(Instance(component, {port.name: value}), rows, sample_time)


@pytest.mark.parametrize("kind", KINDS)
def test_no_parameter_in_its_range_ends_the_run(kind: str) -> None:
    name = "tank" if kind in ("elementary", "canonical_dae") else "two_tanks"
    component, sample_time = made(kind, name)
    rows = measurements(name, sample_time, SHORT)
    for port in component.parameters:
        if port.name.startswith("guess.") or port.name == "sample_time":
            continue
        low, high = bounds(port)
        for value in {low, high, 0.0, 1e-300, 1e30, 1e100, 1e155, sys.float_info.max}:
            if low <= value <= high and math.isfinite(value) and (port.kind == "Real" or float(value).is_integer()):
                run(Instance(component, {port.name: value}), rows, sample_time)


DEVIATIONS = ("tuning.process_noise.", "tuning.measurement_noise.", "tuning.initial_std.")
WEIGHTS = ("tuning.gamma", "tuning.p0", "tuning.N.", "tuning.R.", "tuning.Q0.")
BY_DEVIATIONS: dict[str, Make] = {
    "ukf": KINDS["ukf"],
    "riccati": KINDS["riccati"],
    "arrival": KINDS["arrival"],
    "least_squares": lambda m, Ts: least_squares(
        m, sample_time=Ts, T=20 * Ts, linearise=True, measurement_noise={}, initial_std={}
    ),
}
BY_WEIGHTS: dict[str, Make] = {
    "riccati": lambda m, Ts: riccati(m, sample_time=Ts, N=1.0),
    "least_squares": KINDS["least_squares"],
}


@pytest.mark.parametrize(
    ("make", "prefixes"),
    [(make, DEVIATIONS) for make in BY_DEVIATIONS.values()] + [(make, WEIGHTS) for make in BY_WEIGHTS.values()],
    ids=[*BY_DEVIATIONS, *(f"{kind} by weights" for kind in BY_WEIGHTS)],
)
def test_what_is_squared_has_a_largest_value_that_the_message_names(make: Make, prefixes: tuple[str, ...]) -> None:
    component = make(MODELS["two_tanks"], 0.1)
    rows = measurements("two_tanks", 0.1, 30)
    limited = [port for port in component.parameters if port.name.startswith(prefixes)]
    assert limited
    for port in limited:
        assert math.isfinite(port.max)
        for value in (10 * port.max, 1e155, sys.float_info.max):
            with pytest.raises(ValueError, match=re.escape(f"{port.name} = {value:.10g}")) as refused:
                Instance(component, {port.name: value})
            assert f"{port.max:g}" in str(refused.value)
    run(Instance(component, {port.name: port.max for port in limited}), rows, 0.1)


@pytest.mark.parametrize(("kind", "name"), BUILDS_NOT)
def test_what_a_method_does_not_treat_is_refused_by_name(kind: str, name: str) -> None:
    with pytest.raises(ModelError, match=BUILDS_NOT[kind, name]):
        made(kind, name)
