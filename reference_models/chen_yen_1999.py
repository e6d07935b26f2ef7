"""The example of Chen & Yen, "Application of the least squares algorithm to the observer design for linear time-varying systems", 1999.

Beside it `alternating`, of several outputs, for what the paper says of observability indices.
"""

from __future__ import annotations

from functools import cache

from observers.component import Component
from observers.least_squares import least_squares
from reference_models.alternating import ALTERNATING
from reference_models.chen_yen import CHEN_YEN
from reference_models.plant import plant
from reference_models.recipe import Recipe, Source


@cache
def time_varying() -> Component:
    return plant(CHEN_YEN, stop_time=20.0, step_size=0.01)


@cache
def seen_in_turn() -> Component:
    return plant(ALTERNATING, stop_time=40.0, step_size=0.01)


FMUS: dict[str, Source] = {
    "chen_yen": (time_varying, None),
    "chen_yen_least_squares": (
        lambda: least_squares(CHEN_YEN, sample_time=0.01, T=0.25, gamma=20.0, p0=0.1, guess={"x1": 0.0, "x2": 0.0}),
        time_varying,
    ),
    "alternating": (seen_in_turn, None),
    "alternating_least_squares": (
        lambda: least_squares(
            ALTERNATING,
            sample_time=0.01,
            T=4.0,
            gamma=200.0,
            p0=1.0,
            guess={"x1": 0.0, "x2": 0.0, "x3": 0.0, "x4": 0.0},
            stop_time=40.0,
        ),
        seen_in_turn,
    ),
}


def _example(T: float, figure: int) -> Recipe:
    """The paper's Figure 1 or 2: the error starts at (5, -5), the plant is unstable."""
    return Recipe(
        f"Figure {figure}: reset every {T:g} s",
        {"plant": "chen_yen", "observer": "chen_yen_least_squares"},
        {"observer": {"tuning.T": T}},
        20.0,
        0.01,
    )


SYSTEMS: dict[str, Recipe] = {
    "chen_yen_short": _example(0.25, 1),
    "chen_yen_long": _example(2.0, 2),
    "chen_yen_alternating": Recipe(
        "Two outputs whose observability indices are 3, 1 and 1, 3 in turn, reset every 4 s",
        {"plant": "alternating", "observer": "alternating_least_squares"},
        {},
        40.0,
        0.01,
        (("plant.y1", "observer.y1"), ("plant.y2", "observer.y2")),
    ),
}
