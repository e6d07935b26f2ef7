"""Nothing locks an observer out: once the stream is clean again, its estimate is back within what it reaches from the guess."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from domain_models import MODELS
from observers.canonical_dae import canonical_dae
from observers.component import Component
from observers.elementary import elementary
from observers.instance import Instance
from observers.model import Model
from reference_models.motor import MOTOR
from reference_models.plant import plant
from reference_models.roessler import ROESSLER

# (observer, model, sample time [s], wrong guesses, samples until the corruption)
CASES: dict[str, tuple[Callable[[], Component], Model, float, dict[str, float], int]] = {
    "elementary tank": (
        lambda: elementary(MODELS["tank"], sample_time=0.1, N=8, K=10),
        MODELS["tank"],
        0.1,
        {"h": 0.5},
        80,
    ),
    "elementary diode": (
        lambda: elementary(MODELS["diode"], sample_time=0.1, N=8, K=10),
        MODELS["diode"],
        0.1,
        {"i": 0.1},
        80,
    ),
    "elementary power": (
        lambda: elementary(MODELS["power"], sample_time=0.1, N=8, K=10),
        MODELS["power"],
        0.1,
        {"b": 1.5},
        80,
    ),
    "elementary roessler": (lambda: elementary(ROESSLER, sample_time=0.05, N=41), ROESSLER, 0.05, {}, 150),
    "canonical_dae tank": (lambda: canonical_dae(MODELS["tank"], sample_time=0.1), MODELS["tank"], 0.1, {"d": 0.2}, 80),
    "canonical_dae log": (
        lambda: canonical_dae(MODELS["log_sensor"], sample_time=0.1, poles=[-1.0, -1.0]),
        MODELS["log_sensor"],
        0.1,
        {"rate": 0.5},
        150,
    ),
    "canonical_dae motor": (
        lambda: canonical_dae(MOTOR, sample_time=0.001, poles=[-20.0] * 3),
        MOTOR,
        0.001,
        {"x3": 5.0},
        900,
    ),
    "canonical_dae motor bdf": (
        lambda: canonical_dae(MOTOR, sample_time=0.005, form="bdf"),
        MOTOR,
        0.005,
        {"x3": 5.0},
        300,
    ),
}
LONG = 30  # samples
CORRUPTIONS: dict[
    str, Callable[[float, int, float], float]
] = {  # (y, samples since it began, the last clean y) -> what arrives
    "outlier of 10": lambda y, k, last: y + 10 if k == 0 else y,
    "outlier of 1e4": lambda y, k, last: y + 1e4 if k == 0 else y,
    "outlier of -1e30": lambda y, k, last: -1e30 if k == 0 else y,
    "repeated outliers": lambda y, k, last: y + 1e3 if k < LONG and k % 3 == 0 else y,
    "divided by 1000": lambda y, k, last: y / 1000 if k < LONG else y,
    "times 1000": lambda y, k, last: 1000 * y if k < LONG else y,
    "missing": lambda y, k, last: math.nan if k < LONG else y,
    "stuck": lambda y, k, last: last if k < LONG else y,
    "another sign": lambda y, k, last: -y if k < LONG else y,
}
PART = 0.05  # of the truth's rms: nearer is right
SLACK = 10  # samples, until a lost estimate is seen to be one


@cache
def component(case: str) -> Component:
    return CASES[case][0]()


@cache
def stream(case: str) -> tuple[list[dict[str, float]], list[dict[str, float]], np.ndarray]:
    """Known inputs and measurements at each sample, and the states after it (samples, n)."""
    _, model, Ts, _, begin = CASES[case]
    truth = Instance(plant(model, max_step=min(0.01, Ts)))
    inputs, measured, states = [], [], []
    for k in range(begin + LONG + 3 * begin + 60):
        held = {v.name: (v.start or 0.5) * (1 + 0.3 * math.sin(0.02 * k)) for v in model.inputs}
        for name, value in held.items():
            truth.set(name, value)
        inputs.append(held)
        measured.append({v.name: truth.get(v.name) for v in model.outputs})
        truth.step(truth.time, Ts)
        states.append([truth.get(f"x.{v.name}") for v in model.states])
    return inputs, measured, np.array(states)


def errors(case: str, corrupt: Callable[[float, int, float], float]) -> tuple[np.ndarray, np.ndarray]:
    """Of the estimates in units of what makes one wrong, the largest of a sample, and whether it was trusted."""
    _, model, Ts, guess, begin = CASES[case]
    inputs, measured, states = stream(case)
    run = Instance(component(case), {f"guess.{name}": value for name, value in guess.items()})
    limit = PART * np.maximum(np.sqrt(np.mean(states**2, 0)), [0.2 * v.nominal for v in model.states])
    found, trusted = [], []
    for k, (held, y) in enumerate(zip(inputs, measured, strict=True)):
        for name, value in held.items():
            run.set(name, value)
        for name, value in y.items():
            run.set(name, corrupt(value, k - begin, measured[begin - 1][name]) if k >= begin else value)
        run.step(run.time, Ts)
        outputs = run.outputs()
        assert np.all(np.isfinite(outputs))
        found.append(
            max(
                abs(run.get(f"estimate.{v.name}") - x) / e
                for v, x, e in zip(model.states, states[k], limit, strict=True)
            )
        )
        trusted.append(run.get("diagnostics.trusted"))
    return np.array(found), np.array(trusted)


def settled(found: np.ndarray) -> int:
    """Samples until the estimate is right for good."""
    wrong = np.flatnonzero(~(found <= 1))
    return int(wrong[-1]) + 1 if len(wrong) else 0


@pytest.mark.parametrize("corruption", CORRUPTIONS)
@pytest.mark.parametrize(
    "case", [name if "tank" in name else pytest.param(name, marks=pytest.mark.long) for name in CASES]
)
def test_after_any_stream_the_estimate_comes_back(case: str, corruption: str) -> None:
    begin = CASES[case][4]
    clean, _ = errors(case, lambda y, k, last: y)
    from_guess = settled(clean)
    assert from_guess < begin
    found, trusted = errors(case, CORRUPTIONS[corruption])
    window = next((int(port.start) for port in component(case).constants if port.name == "structure.N"), 0)
    assert settled(found) - (begin + LONG) <= max(3 * from_guess, 2 * window) + SLACK
    assert trusted[-1]
