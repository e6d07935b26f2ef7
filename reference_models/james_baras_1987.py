"""The experiments of James & Baras, "An observer design for nonlinear control systems", 1987: Examples 5.1 and 5.2."""

from __future__ import annotations

import math
from functools import cache

from observers.component import Component
from observers.riccati import riccati
from reference_models.james_baras_5_1 import JAMES_BARAS_5_1
from reference_models.james_baras_5_2 import JAMES_BARAS_5_2
from reference_models.plant import plant
from reference_models.recipe import Recipe, Source


@cache
def bilinear() -> Component:
    return plant(JAMES_BARAS_5_1, stop_time=20.0, step_size=0.01)


@cache
def sine_output() -> Component:
    return plant(JAMES_BARAS_5_2, stop_time=10.0, step_size=0.01)


FMUS: dict[str, Source] = {
    "james_baras_5_1": (bilinear, None),
    "james_baras_5_2": (sine_output, None),
    "james_baras_5_1_riccati": (
        lambda: riccati(
            JAMES_BARAS_5_1,
            sample_time=0.01,
            N=1.0,
            R=1.0,
            Q0=1.0,
            guess={"x1": 0.0, "x2": 0.0, "x3": 0.0},
            expose=["Q"],
            stop_time=20.0,
        ),
        bilinear,
    ),
    "james_baras_5_2_riccati": (
        lambda: riccati(
            JAMES_BARAS_5_2,
            sample_time=0.01,
            N=math.sqrt(0.2),  # N = sqrt(r0) I, R = r I, Q0 = gamma^2 I with the paper's r0 = 0.2, r = 3, gamma = 0.1
            R=3.0,
            Q0=0.01,
            guess={"x1": 0.0, "x2": 0.0},
            expose=["Q"],
        ),
        sine_output,
    ),
}

SYSTEMS: dict[str, Recipe] = {
    "james_baras_5_1": Recipe(
        "Example 5.1: bilinear, u = (sin 1.3 t, cos 0.7 t)",
        {"control1": "sine", "control2": "sine", "plant": "james_baras_5_1", "observer": "james_baras_5_1_riccati"},
        {"control1": {"frequency": 1.3}, "control2": {"frequency": 0.7, "phase": math.pi / 2}},
        20.0,
        0.01,
        (
            ("control1.y", "plant.u1"),
            ("control1.y", "observer.u1"),
            ("control2.y", "plant.u2"),
            ("control2.y", "observer.u2"),
            ("plant.y", "observer.y"),
        ),
    ),
    "james_baras_5_2": Recipe(
        "Example 5.2: y = sin x1, from x0 = (1, -1), m0 = 0",
        {"plant": "james_baras_5_2", "observer": "james_baras_5_2_riccati"},
        {},
        10.0,
        0.01,
    ),
    "james_baras_5_2_far": Recipe(
        "Example 5.2 from x0 = (3, 2), m0 = (-3, -2)",
        {"plant": "james_baras_5_2", "observer": "james_baras_5_2_riccati"},
        {"plant": {"start.x1": 3.0, "start.x2": 2.0}, "observer": {"guess.x1": -3.0, "guess.x2": -2.0}},
        10.0,
        0.01,
    ),
}
