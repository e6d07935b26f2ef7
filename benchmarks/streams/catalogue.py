"""The observers that are put to the test, each with its scenario: those of the papers' systems, and three methods on six models from the
literature.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from advice.streams.inputs import bands, waves
from advice.streams.streams import Scenario, Values
from benchmarks.streams import literature
from benchmarks.streams.entry import Entry, scenario
from build_fmus import FMUS
from observers.least_squares import least_squares
from observers.pseudospectral import pseudospectral
from observers.riccati import riccati
from reference_models.duffing import DUFFING
from reference_models.gong_2007 import GUESS
from reference_models.silverbox import SAMPLE_TIME as SILVERBOX_TIME

_made = {
    name: cache(FMUS[name][0])
    for name in ("duffing", "van_der_pol", "roessler", "rlc", "motor", "chen_yen", "silverbox")
}
_made |= {name: cache(FMUS[name][0]) for name in ("james_baras_5_1", "james_baras_5_2")}
DUFFING_SCENARIO = scenario(
    "duffing",
    _made["duffing"],
    0.1,
    300,
    noise={"y": 1e-3},
    settled=60,
    jump=("theta", 0.25),
    mismatch=("damping", 1.6),
)
ROESSLER_SCENARIO = scenario("roessler", _made["roessler"], 0.05, 400, noise={"y": 1e-3}, settled=100)
SILVERBOX_SCENARIO = scenario(
    "silverbox",
    _made["silverbox"],
    SILVERBOX_TIME,
    1000,
    noise={"y": 1e-3},
    settled=150,
    inputs=lambda seed, samples: bands(seed, samples, SILVERBOX_TIME, 100.0, u=0.02),
    linear=True,
    jump=("k1", 0.8),
    mismatch=("c", 1.6),
)
MOTOR_SCENARIO = scenario(
    "motor",
    _made["motor"],
    1e-3,
    3000,
    noise={"y1": 1e-4, "y2": 1e-4},
    settled=1150,
    inputs=lambda seed, samples: waves(1e-3, samples, u=lambda t: 2 + 2 * np.sin(2 * t)),
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
            DUFFING, sample_time=0.1, T=4.0, linearise=True, measurement_noise={"y": 1e-3}, initial_std={}, guess=GUESS
        ),
        DUFFING_SCENARIO,
    ),
    **{name: Entry(FMUS[name][0], ROESSLER_SCENARIO) for name in ("roessler_pseudospectral", "roessler_elementary")},
    "van_der_pol_known_elementary": Entry(
        FMUS["van_der_pol_known_elementary"][0],
        scenario(
            "van_der_pol",
            _made["van_der_pol"],
            0.05,
            300,
            noise={"y": 1e-3},
            settled=80,
            inputs=lambda seed, samples: waves(0.05, samples, u=np.sin, mu=lambda t: 0.1 * np.sin(t)),
        ),
    ),
    "rlc_pseudospectral": Entry(
        FMUS["rlc_pseudospectral"][0],
        scenario(
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
        scenario("chen_yen", _made["chen_yen"], 0.01, 3000, noise={"y": 1e-3}, settled=1200),
    ),
    "james_baras_5_1_riccati": Entry(
        FMUS["james_baras_5_1_riccati"][0],
        scenario(
            "james_baras_5_1",
            _made["james_baras_5_1"],
            0.01,
            4000,
            noise={"y": 1e-2},
            settled=1600,
            inputs=lambda seed, samples: waves(
                0.01, samples, u1=lambda t: np.sin(1.3 * t), u2=lambda t: np.cos(0.7 * t)
            ),
        ),
    ),
    "james_baras_5_2_riccati": Entry(
        FMUS["james_baras_5_2_riccati"][0],
        scenario("james_baras_5_2", _made["james_baras_5_2"], 0.01, 1000, noise={"y": 1e-3}, settled=400),
    ),
    **{name: Entry(FMUS[name][0], SILVERBOX_SCENARIO) for name in ("silverbox_pseudospectral_short", "silverbox_ukf")},
}


def _plant(name: str, sample_time: float, samples: int, settled: int, **more: Any) -> Callable[[], Scenario]:
    """The scenario of a plant of the catalogue."""
    return scenario(name, cache(FMUS[name][0]), sample_time, samples, settled=settled, **more)


def _uniform(bound: float) -> dict[str, Any]:
    """The paper's noise, of the plant's own sensor."""
    return {"noise": {"y": 0.0}, "start": {"sensor.noise_bound": bound, "sensor.sample_time": 0.1}}


def _sines(sample_time: float, **more: Callable[[np.ndarray], np.ndarray]) -> Callable[[int, int], Values]:
    return lambda seed, samples: waves(sample_time, samples, u=np.sin, mu=lambda t: 0.1 * np.sin(t), **more)


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
        "modulated", 0.01, 2000, 500, noise={"y": 1e-3}, inputs=lambda seed, n: waves(0.01, n, u=np.sin)
    ),
    "chua_canonical_dae": _plant("chua", 0.01, 1000, 300, noise={"y": 1e-3}),
    "double_integrator_canonical_dae": _plant("double_integrator", 0.01, 500, 150, noise={"y": 1e-3}),
    "pushed_mass_canonical_dae": _plant("pushed_mass", 0.01, 500, 150, noise={"y1": 1e-3, "y2": 1e-3}),
    "van_der_pol_elementary": _plant(
        "van_der_pol", 0.05, 500, 201, noise={"y": 1e-3}, inputs=_sines(0.05, v=lambda t: 0.5 * np.clip(t - 1, 0, 1))
    ),
    # A batch of 101 samples, whose first solution alone takes a minute under callgrind.
    "van_der_pol_signed_elementary": _plant(
        "van_der_pol", 0.1, 106, 101, noise={"y": 1e-3}, inputs=_sines(0.1, v=lambda t: 0.5 * np.clip(t - 1, 0, 1))
    ),
    "alternating_least_squares": _plant("alternating", 0.01, 3000, 1200, noise={"y1": 1e-3, "y2": 1e-3}),
    "silverbox_pseudospectral": SILVERBOX_SCENARIO,
}
CATALOGUE = PAPERS | {name: Entry(FMUS[name][0], scenario) for name, scenario in OTHERS.items()}
ENTRIES = PAPERS | literature.ENTRIES
