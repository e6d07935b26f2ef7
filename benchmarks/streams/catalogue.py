"""The observers that are put to the test, each with its scenario: those of the papers' systems, and three methods on six models from the
literature, with everything left at its default and with the true noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

import numpy as np

from benchmarks.streams.streams import Scenario, Values
from build_fmus import FMUS
from observers.component import Component
from observers.least_squares import least_squares
from observers.model import Model
from observers.pseudospectral import pseudospectral
from observers.riccati import riccati
from observers.ukf import ukf
from reference_models.cell import CELL
from reference_models.chemostat import CHEMOSTAT
from reference_models.cstr import CSTR
from reference_models.duffing import DUFFING
from reference_models.gong_2007 import GUESS
from reference_models.igniting_reactor import IGNITING_REACTOR
from reference_models.lotka_volterra import LOTKA_VOLTERRA
from reference_models.plant import plant
from reference_models.quadruple_tank import QUADRUPLE_TANK
from reference_models.silverbox import SAMPLE_TIME as SILVERBOX_TIME


@dataclass(frozen=True)
class Entry:
    """An observer: how it is made, what it is tried on, and its guess."""

    make: Callable[[], Component]
    scenario: Callable[[], Scenario]
    parameters: Mapping[str, float] = field(default_factory=dict)


def _steps(seed: int, samples: int, every: int, **bounds: tuple[float, float]) -> Values:
    """Inputs that jump to random values between their bounds every so many samples."""
    rng = np.random.default_rng([seed, 9])
    return {
        name: np.repeat(rng.uniform(low, high, samples // every + 1), every)[:samples]
        for name, (low, high) in bounds.items()
    }


def _waves(sample_time: float, samples: int, **waves: Callable[[np.ndarray], np.ndarray]) -> Values:
    """Inputs as functions of time."""
    return {name: wave(sample_time * np.arange(samples)) for name, wave in waves.items()}


def _scenario(
    name: str, plant_of: Callable[[], Component], sample_time: float, samples: int, **more: Any
) -> Callable[[], Scenario]:
    """A scenario that is made when it is wanted, once."""
    return cache(lambda: Scenario(name, plant_of(), sample_time, samples, **more))


_made = {
    name: cache(FMUS[name][0])
    for name in ("duffing", "van_der_pol", "roessler", "rlc", "motor", "chen_yen", "silverbox")
}
_made |= {name: cache(FMUS[name][0]) for name in ("james_baras_5_1", "james_baras_5_2")}
DUFFING_SCENARIO = _scenario(
    "duffing",
    _made["duffing"],
    0.1,
    300,
    noise={"y": 1e-3},
    settled=60,
    jump=("theta", 0.25),
    mismatch=("damping", 1.6),
)
ROESSLER_SCENARIO = _scenario("roessler", _made["roessler"], 0.05, 400, noise={"y": 1e-3}, settled=100)
SILVERBOX_SCENARIO = _scenario(
    "silverbox",
    _made["silverbox"],
    SILVERBOX_TIME,
    400,
    noise={"y": 1e-3},
    settled=150,
    inputs=lambda seed, samples: _steps(seed, samples, 4, u=(-0.3, 0.3)),
    linear=True,
    jump=("k1", 0.8),
    mismatch=("c", 1.6),
)
MOTOR_SCENARIO = _scenario(
    "motor",
    _made["motor"],
    1e-3,
    3000,
    noise={"y1": 1e-4, "y2": 1e-4},
    settled=1150,
    inputs=lambda seed, samples: _waves(1e-3, samples, u=lambda t: 2 + 2 * np.sin(2 * t)),
    jump=("B1", 1.2),
    mismatch=("A2", 1.6),
)
PAPERS = {
    **{
        name: Entry(FMUS[name][0], DUFFING_SCENARIO)
        for name in ("duffing_pseudospectral", "duffing_pseudospectral_spline", "duffing_ukf")
    },
    "duffing_pseudospectral_arrival": Entry(
        lambda: pseudospectral(
            DUFFING,
            sample_time=0.1,
            N=15,
            L=8,
            arrival_cost=True,
            measurement_noise={"y": 1e-3},
            process_noise={"x1": 1e-4, "x2": 1e-4, "theta": 0.03},
            guess=GUESS,
        ),
        DUFFING_SCENARIO,
    ),
    "duffing_riccati": Entry(
        lambda: riccati(
            DUFFING,
            sample_time=0.1,
            process_noise={"x1": 1e-4, "x2": 1e-4, "theta": 0.03},
            measurement_noise={"y": 1e-3},
            guess=GUESS,
        ),
        DUFFING_SCENARIO,
    ),
    "duffing_least_squares": Entry(
        lambda: least_squares(
            DUFFING, sample_time=0.1, T=2.0, linearise=True, measurement_noise={"y": 1e-3}, initial_std={}, guess=GUESS
        ),
        DUFFING_SCENARIO,
    ),
    **{name: Entry(FMUS[name][0], ROESSLER_SCENARIO) for name in ("roessler_pseudospectral", "roessler_elementary")},
    "van_der_pol_known_elementary": Entry(
        FMUS["van_der_pol_known_elementary"][0],
        _scenario(
            "van_der_pol",
            _made["van_der_pol"],
            0.05,
            300,
            noise={"y": 1e-3},
            settled=80,
            inputs=lambda seed, samples: _waves(0.05, samples, u=np.sin, mu=lambda t: 0.1 * np.sin(t)),
        ),
    ),
    "rlc_pseudospectral": Entry(
        FMUS["rlc_pseudospectral"][0],
        _scenario(
            "rlc",
            _made["rlc"],
            0.2,
            19,
            noise={"y": 1e-4},
            settled=6,
            spread=0.0,
            start={"start.x1": 4.0, "start.x2": 1.5, "start.x3": 2.7},
        ),
    ),
    "motor_canonical_dae": Entry(
        FMUS["motor_canonical_dae"][0],
        MOTOR_SCENARIO,
        # Poles at which the hidden field is found, and the detector armed, before the streams are corrupted.
        {
            **{f"tuning.pole[{i}]": -20.0 for i in (1, 2, 3)},
            "tuning.fault_threshold": 0.02,
            "tuning.fault_settling": 0.25,
        },
    ),
    "chen_yen_least_squares": Entry(
        FMUS["chen_yen_least_squares"][0],
        _scenario("chen_yen", _made["chen_yen"], 0.01, 3000, noise={"y": 1e-3}, settled=1200),
    ),
    "james_baras_5_1_riccati": Entry(
        FMUS["james_baras_5_1_riccati"][0],
        _scenario(
            "james_baras_5_1",
            _made["james_baras_5_1"],
            0.01,
            4000,
            noise={"y": 1e-2},
            settled=1600,
            inputs=lambda seed, samples: _waves(
                0.01, samples, u1=lambda t: np.sin(1.3 * t), u2=lambda t: np.cos(0.7 * t)
            ),
        ),
    ),
    "james_baras_5_2_riccati": Entry(
        FMUS["james_baras_5_2_riccati"][0],
        _scenario("james_baras_5_2", _made["james_baras_5_2"], 0.01, 1000, noise={"y": 1e-3}, settled=400),
    ),
    **{name: Entry(FMUS[name][0], SILVERBOX_SCENARIO) for name in ("silverbox_pseudospectral_short", "silverbox_ukf")},
}


def _plant(name: str, sample_time: float, samples: int, settled: int, **more: Any) -> Callable[[], Scenario]:
    """The scenario of a plant of the catalogue."""
    return _scenario(name, cache(FMUS[name][0]), sample_time, samples, settled=settled, **more)


def _uniform(bound: float) -> dict[str, Any]:
    """The paper's noise, of the plant's own sensor."""
    return {"noise": {"y": 0.0}, "start": {"sensor.noise_bound": bound, "sensor.sample_time": 0.1}}


def _sines(sample_time: float, **more: Callable[[np.ndarray], np.ndarray]) -> Callable[[int, int], Values]:
    return lambda seed, samples: _waves(sample_time, samples, u=np.sin, mu=lambda t: 0.1 * np.sin(t), **more)


# What is left of the catalogue: other structures of observers that are above, whose trust those stand for.
OTHERS = {
    "duffing_pseudospectral_3a": _plant("duffing", 0.01, 1000, 200, noise={"y": 1e-3}),
    "duffing_pseudospectral_3b": _plant("duffing", 0.5, 150, 30, noise={"y": 1e-3}),
    "duffing_pseudospectral_5": _plant("duffing", 0.1, 300, 100, **_uniform(0.1)),
    **{
        name: _plant("duffing", 0.1, 300, 100, **_uniform(1.0))
        for name in ("duffing_known_pseudospectral", "duffing_known_pseudospectral_tube")
    },
    "duffing_pseudospectral_loop": DUFFING_SCENARIO,
    # What they make of their estimate acts on no plant here: the measurements are those of the loop that the true state closes.
    **{
        f"duffing_{method}_controller": _plant("duffing_with_controller", 0.1, 300, 60, noise={"y": 0.006})
        for method in ("pseudospectral", "ukf")
    },
    "motor_canonical_dae_controller": _plant(
        "motor_with_controller", 1e-3, 3000, 1150, noise={"y1": 0.006, "y2": 0.006}
    ),
    **{f"motor_canonical_dae_{form}": MOTOR_SCENARIO for form in ("regional", "bdf")},
    "modulated_canonical_dae": _plant(
        "modulated", 0.01, 2000, 500, noise={"y": 1e-3}, inputs=lambda seed, n: _waves(0.01, n, u=np.sin)
    ),
    "double_integrator_canonical_dae": _plant("double_integrator", 0.01, 500, 150, noise={"y": 1e-3}),
    "pushed_mass_canonical_dae": _plant("pushed_mass", 0.01, 500, 150, noise={"y1": 1e-3, "y2": 1e-3}),
    "van_der_pol_elementary": _plant(
        "van_der_pol", 0.05, 500, 201, noise={"y": 1e-3}, inputs=_sines(0.05, v=lambda t: 0.5 * np.clip(t - 1, 0, 1))
    ),
    # A batch of 101 samples, whose first solution alone takes a minute under callgrind.
    "van_der_pol_signed_elementary": _plant(
        "van_der_pol", 0.1, 106, 101, noise={"y": 1e-3}, inputs=_sines(0.1, v=lambda t: 0.5 * np.clip(t - 1, 0, 1))
    ),
    "silverbox_pseudospectral": SILVERBOX_SCENARIO,
}
CATALOGUE = PAPERS | {name: Entry(FMUS[name][0], scenario) for name, scenario in OTHERS.items()}


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
    scenario = _scenario(
        model.name,
        cache(lambda: plant(model, max_step=sample_time / 100)),
        sample_time,
        samples,
        noise=noises,
        settled=settled,
        **more,
    )
    guess, std, intensity = ({name: row[i] for name, row in estimated.items()} for i in range(3))
    return Literature(model, scenario, noises, intensity, std, guess)


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
        inputs=lambda seed, samples: _steps(
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
        inputs=lambda seed, samples: _steps(seed, samples, 15, v1=(2.5, 3.8), v2=(2.5, 3.8)),
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
        inputs=lambda seed, samples: _steps(seed, samples, 20, dilution=(0.1 / HOUR, 0.3 / HOUR)),
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
        inputs=lambda seed, samples: _waves(5.0, samples, Tj=lambda t: 300 + 4 * np.sin(2 * np.pi * t / 500)),
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
        inputs=lambda seed, samples: _steps(seed, samples, 10, i=(-2.0, 5.0)),
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


ENTRIES: dict[str, Entry] = dict(PAPERS)
for _case in MODELS:
    for _method in METHODS:
        _guess = {f"guess.{name}": value for name, value in _case.guess.items()}
        _name = f"{_case.model.name}_{_method}"
        ENTRIES[_name] = Entry(partial(_default, _case, _method), _case.scenario, _guess)
        ENTRIES[f"{_name}_told"] = Entry(partial(_told, _case, _method), _case.scenario, _guess)
