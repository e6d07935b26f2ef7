"""Three methods on six models from the literature, with everything left at its default and with the true noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np

from advice.streams.inputs import steps, waves
from advice.streams.streams import Scenario
from benchmarks.streams.entry import Entry, scenario
from observers.component import Component
from observers.model import Model
from observers.pseudospectral import pseudospectral
from observers.riccati import riccati
from observers.ukf import ukf
from reference_models.cell import CELL
from reference_models.chemostat import CHEMOSTAT
from reference_models.cstr import CSTR
from reference_models.igniting_reactor import IGNITING_REACTOR
from reference_models.lotka_volterra import LOTKA_VOLTERRA
from reference_models.plant import plant
from reference_models.quadruple_tank import QUADRUPLE_TANK


@dataclass(frozen=True)
class Literature:
    """A model with what a well-tuned observer is told: noise, intensities, deviations of the guess; and the guess."""

    model: Model
    scenario: Callable[[], Scenario]
    measurement_noise: Mapping[str, float]
    process_noise: Mapping[str, float]
    initial_std: Mapping[str, float]
    guess: Mapping[str, float]


def _literature(
    model: Model,
    sample_time: float,
    samples: int,
    settled: int,
    noise: float,
    estimated: Mapping[str, tuple[float, float, float]],
    **more: Any,
) -> Literature:
    """`estimated`: (guess, its standard deviation, intensity) by name."""
    noises = {v.name: noise for v in model.outputs}
    made = scenario(
        model.name,
        cache(lambda: plant(model, max_step=sample_time / 100)),
        sample_time,
        samples,
        noise=noises,
        settled=settled,
        **more,
    )
    guess, std, intensity = ({name: row[i] for name, row in estimated.items()} for i in range(3))
    return Literature(model, made, noises, intensity, std, guess)


HOUR = 3600.0
MODELS = (
    _literature(
        CSTR,
        18.0,
        200,
        60,
        0.1,
        {
            "cA": (0.6, 0.5, 2e-4),
            "cB": (1.2, 0.3, 2e-4),
            "T": (131.0, 3.0, 2e-4),
            "Tj": (128.0, 3.0, 2e-4),
            "activity": (0.8, 0.2, 2e-4),
        },
        inputs=lambda seed, samples: steps(
            seed, samples, 10, dilution=(10 / HOUR, 40 / HOUR), heating=(-6000 / HOUR, -1000 / HOUR)
        ),
        jump=("activity", 1.4),
        mismatch=("transfer", 1.6),
        spread=0.02,
    ),
    _literature(
        QUADRUPLE_TANK,
        2.0,
        300,
        100,
        0.1,
        {
            **{f"h{i}": (guess, 2.0, 1e-3) for i, guess in ((1, 10.0), (2, 10.0), (3, 3.0), (4, 3.0))},
            "valve": (0.6, 0.1, 1e-4),
        },
        inputs=lambda seed, samples: steps(seed, samples, 15, v1=(2.5, 3.8), v2=(2.5, 3.8)),
        jump=("valve", 0.8),
        mismatch=("a1", 1.6),
    ),
    _literature(
        CHEMOSTAT,
        900.0,
        300,
        120,
        0.05,
        {"X": (2.5, 1.0, 1.7e-5), "S": (3.0, 1.0, 1.7e-5), "mu": (0.3 / HOUR, 0.1 / HOUR, 0.01 / HOUR**1.5)},
        inputs=lambda seed, samples: steps(seed, samples, 20, dilution=(0.1 / HOUR, 0.3 / HOUR)),
        jump=("mu", 0.8),
        mismatch=("half", 1.6),
    ),
    _literature(
        LOTKA_VOLTERRA,
        0.2,
        300,
        100,
        0.05,
        {
            "prey": (1.2, 0.3, 1e-3),
            "predators": (1.1, 0.3, 1e-3),
            **{name: (1.0, 0.4, 1e-3) for name in ("birth", "loss", "death", "gain")},
        },
        jump=("death", 1.4),
    ),
    _literature(
        IGNITING_REACTOR,
        5.0,
        400,
        120,
        0.2,
        {"c": (0.5, 0.2, 1e-4), "T": (345.0, 1.0, 1e-2), "cooling": (0.02, 0.02, 2e-5)},
        inputs=lambda seed, samples: waves(5.0, samples, Tj=lambda t: 300 + 4 * np.sin(2 * np.pi * t / 500)),
        jump=("cooling", 0.9),
        mismatch=("k0", 1.6),
        spread=0.02,
    ),
    _literature(
        CELL,
        1.0,
        500,
        200,
        0.002,
        {"soc": (0.6, 0.3, 1e-6), "v1": (0.0, 0.02, 1e-4), "R0": (0.02, 0.02, 1e-5)},
        inputs=lambda seed, samples: steps(seed, samples, 10, i=(-2.0, 5.0)),
        jump=("R0", 1.5),
        mismatch=("R1", 1.6),
        spread=0.05,
    ),
)
METHODS: dict[str, Callable[..., Component]] = {"pseudospectral": pseudospectral, "ukf": ukf, "riccati": riccati}


def _told(case: Literature, method: str) -> Component:
    noise = {name: dict(getattr(case, name)) for name in ("measurement_noise", "process_noise", "initial_std")}
    more = {"arrival_cost": True} if method == "pseudospectral" else {}
    return METHODS[method](case.model, **_steps_of(case), **noise, **more)


def _default(case: Literature, method: str) -> Component:
    return METHODS[method](case.model, **_steps_of(case))


def _steps_of(case: Literature) -> dict[str, float]:
    sample_time = case.scenario().sample_time
    return {"sample_time": sample_time, "max_step": sample_time}


ENTRIES: dict[str, Entry] = {}
for _case in MODELS:
    for _method in METHODS:
        _guess = {f"guess.{name}": value for name, value in _case.guess.items()}
        _name = f"{_case.model.name}_{_method}"
        ENTRIES[_name] = Entry(partial(_default, _case, _method), _case.scenario, _guess)
        ENTRIES[f"{_name}_told"] = Entry(partial(_told, _case, _method), _case.scenario, _guess)
