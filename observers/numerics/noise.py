"""Measurement noise that is the same in every tool: a Lehmer generator whose integers are exact in doubles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca

MODULUS = 2147483647.0  # 2^31 - 1
MULTIPLIER = 16807.0
LARGEST_SEED = 2**20  # (seed + 1)^2 times the scrambling prime stays below 2^53

_UNIFORM_PRIME = 7919.0
_GAUSSIAN_PRIME = 7907.0
_INPUT_PRIME = 7901.0


def advance(state: Any) -> Any:
    """The generator's next state, an integer in [1, MODULUS - 1]: s <- fmod(16807 s, 2^31 - 1), exact in doubles."""
    return ca.fmod(MULTIPLIER * state, MODULUS)


def seeded(seed: Any, prime: float) -> Any:
    """First state for `seed`, an integer from 0 to LARGEST_SEED.

    Scrambled and three draws in: the streams of plain seeds 1 and 2 correlate by 0.49.
    """
    state = 1 + ca.fmod(1 + (seed + 1) ** 2 * prime, MODULUS - 1)
    for _ in range(3):
        state = advance(state)
    return state


def start(seed: Any) -> Any:
    """States (2 x 1) of the two streams, uniform and Gaussian, before the first draw."""
    return ca.vertcat(seeded(seed, _UNIFORM_PRIME), seeded(seed, _GAUSSIAN_PRIME))


def start_inputs(seed: Any) -> Any:
    """State of the Gaussian stream for inputs, before the first draw."""
    return seeded(seed, _INPUT_PRIME)


def draw(states: Any, bounds: Sequence[Any], deviations: Sequence[Any]) -> tuple[Any, Any]:
    """(states after it, noise): for each of `bounds` uniform in [-bound, bound] plus Gaussian with its standard deviation."""
    uniform, gaussian = states[0], states[1]
    values = []
    for bound, deviation in zip(bounds, deviations, strict=True):
        uniform = advance(uniform)
        gaussian, normal = _normal(gaussian)
        values.append(bound * (2 * uniform / MODULUS - 1) + deviation * normal)
    return ca.vertcat(uniform, gaussian), ca.vertcat(*values)


def draw_gaussian(state: Any, deviations: Sequence[Any]) -> tuple[Any, Any]:
    """(state after it, noise): Gaussian, one number for each standard deviation."""
    values = []
    for deviation in deviations:
        state, normal = _normal(state)
        values.append(deviation * normal)
    return state, ca.vertcat(*values)


def _normal(state: Any) -> tuple[Any, Any]:
    """(state after it, a standard normal number), by Box and Muller."""
    radius = advance(state)
    angle = advance(radius)
    return angle, ca.sqrt(-2 * ca.log(radius / MODULUS)) * ca.cos(2 * ca.pi * angle / MODULUS)
