"""The example of Calvillo-Corona & Alamir, "Towards the construction of a robust optimal observer", section 5."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from observers.component import Component
from observers.elementary import elementary
from observers.pseudospectral import pseudospectral
from reference_models.plant import plant
from reference_models.ramp import ramp
from reference_models.recipe import Recipe, Source
from reference_models.roessler import ROESSLER
from reference_models.sine import sine
from reference_models.van_der_pol import (
    VAN_DER_POL,
    VAN_DER_POL_ERRONEOUS,
    VAN_DER_POL_KNOWN,
    VAN_DER_POL_SIGNED,
)

SAMPLE_TIME = 0.05  # [s]
# Section 5.2: x(0) is wrong in x2, v^(0) = 0.
GUESS = {"x1": 0.5, "x2": 0.0}
WEIGHTS: dict[str, Any] = {
    "q": {"x1": 10.0, "x2": 1e-3},
    "r": {"x1": {"x2": 1e-3, "v": 5e-4}, "x2": {"x1": 10.0}},
}
WEIGHTS_WITHOUT_V: dict[str, Any] = {
    "q": WEIGHTS["q"],
    "r": {"x1": {"x2": 1e-3}, "x2": {"x1": 10.0}},
}
# Any sample time from 0.01 to 0.1 gives the same result; the grid solver's time grows with N.
SIGNED_SAMPLE_TIME = 0.1  # [s]
ROESSLER_GUESS = {"x1": 0.0, "x2": 0.0, "x3": 0.0}
ROESSLER_WEIGHTS: dict[str, Any] = {
    "q": {"x1": 0.01, "x2": 10.0, "x3": 0.01},
    "r": {"x1": {"x2": 10.0, "x3": 1e-3}, "x2": {"x1": 1e-3}, "x3": {"x1": 10.0}},
}
BATCH: dict[str, Any] = {
    "first_guess": VAN_DER_POL_ERRONEOUS,
    "guess": GUESS,
}


@cache
def van_der_pol() -> Component:
    return plant(VAN_DER_POL, stop_time=20.0, step_size=SAMPLE_TIME)


@cache
def roessler() -> Component:
    return plant(ROESSLER, step_size=SAMPLE_TIME)


FMUS: dict[str, Source] = {
    "van_der_pol": (van_der_pol, None),
    "van_der_pol_elementary": (
        lambda: elementary(VAN_DER_POL, sample_time=SAMPLE_TIME, N=201, K=40, **BATCH, **WEIGHTS),
        van_der_pol,
    ),
    "van_der_pol_signed_elementary": (
        lambda: elementary(
            VAN_DER_POL_SIGNED,
            sample_time=SIGNED_SAMPLE_TIME,
            N=101,
            K=300,
            nodes=41,
            stop_time=10.0,
            **BATCH,
            **WEIGHTS,
        ),
        van_der_pol,
    ),
    "van_der_pol_known_elementary": (
        lambda: elementary(VAN_DER_POL_KNOWN, sample_time=SAMPLE_TIME, N=41, K=5, guess=GUESS, **WEIGHTS_WITHOUT_V),
        van_der_pol,
    ),
    "roessler": (roessler, None),
    "roessler_elementary": (
        lambda: elementary(ROESSLER, sample_time=SAMPLE_TIME, N=41, guess=ROESSLER_GUESS, **ROESSLER_WEIGHTS),
        roessler,
    ),
    "roessler_pseudospectral": (
        lambda: pseudospectral(ROESSLER, sample_time=SAMPLE_TIME, N=19, L=20, guess=ROESSLER_GUESS),
        roessler,
    ),
    "ramp": (ramp, None),
    "sine": (sine, None),
}


def _example(description: str, fmu: str, stop: float, v: Mapping[str, str], step: float = SAMPLE_TIME) -> Recipe:
    """Plant and observer, with u = sin t and mu = 0.1 sin t to both, and what drives v."""
    both = [(f"{name}.y", f"{element}.{name}") for name in ("u", "mu") for element in ("plant", "observer")]
    return Recipe(
        description,
        {"u": "sine", "mu": "sine", **v, "plant": "van_der_pol", "observer": fmu},
        {"mu": {"amplitude": 0.1}},
        stop,
        step,
        (*both, *((f"{name}.y", f"plant.{name}") for name in v), ("plant.y", "observer.y")),
    )


SYSTEMS: dict[str, Recipe] = {
    "calvillo_alamir_full": _example(
        "Section 5.2: one batch of 10 s, v of (11) unknown", "van_der_pol_elementary", 10.05, {"v": "ramp"}
    ),
    "calvillo_alamir_full_signed": _example(
        "One batch of 10 s, v of (11) unknown within 0 and 0.5",
        "van_der_pol_signed_elementary",
        10.1,
        {"v": "ramp"},
        SIGNED_SAMPLE_TIME,
    ),
    "calvillo_alamir_horizon": _example("Moving window of 2 s, v = 0 known", "van_der_pol_known_elementary", 20.0, {}),
    **{
        f"roessler_{method}": Recipe(
            f"Rössler's system, {text}",
            {"plant": "roessler", "observer": f"roessler_{method}"},
            {},
            30.0,
            SAMPLE_TIME,
        )
        for method, text in (("elementary", "elementary problems"), ("pseudospectral", "pseudospectral observer"))
    },
}
