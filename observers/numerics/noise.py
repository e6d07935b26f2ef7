"""Measurement noise that is the same in every tool: a Lehmer generator whose integers are exact in doubles."""

from __future__ import annotations

from typing import Any

import casadi as ca

MODULUS = 2147483647.0  # 2^31 - 1
MULTIPLIER = 16807.0
LARGEST_SEED = 2**20  # (seed + 1)^2 times the scrambling prime stays below 2^53

_UNIFORM_PRIME = 7919.0
_GAUSSIAN_PRIME = 7907.0


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


def draw(states: Any, count: int, bound: Any, deviation: Any) -> tuple[Any, Any]:
    """(states after it, noise (count x 1)): uniform in [-bound, bound] plus Gaussian with standard deviation `deviation` (Box-Muller)."""
    uniform, gaussian = states[0], states[1]
    values = []
    for _ in range(count):
        uniform = advance(uniform)
        radius = gaussian = advance(gaussian)
        angle = gaussian = advance(gaussian)
        normal = ca.sqrt(-2 * ca.log(radius / MODULUS)) * ca.cos(2 * ca.pi * angle / MODULUS)
        values.append(bound * (2 * uniform / MODULUS - 1) + deviation * normal)
    return ca.vertcat(uniform, gaussian), ca.vertcat(*values)
