"""What the observer chooses where nothing is said: the window's structure, and the noises, from the model.

With an arrival cost a short window does: what it no longer holds still counts. It is cut into segments that follow the model:

- one segment for each sample where held inputs drive nonlinear rates: their kinks then lie between the polynomials. One polynomial over
  several samples would be wrong there, and nothing would say so.
- otherwise as many samples a segment as the model's fastest rate, looked at near its start values, allows: at most 1 / rate long.

The paper's own structure, one polynomial of order 15 over 8 samples and no arrival cost, holds where a part of a structure is given, and
for the spline cost and the tube.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from observers import ports
from observers.linearisation import fastest_rate
from observers.model import Model
from observers.numerics.semilinear import lift_inputs, split

PAPER = {"N": 15, "L": 8, "segments": 1}
SHORTEST = 10  # samples of a window
# Of a segment up to 2 and 10 of the fastest time constants long, and beyond.
ORDER, STIFF_ORDER, STIFFEST_ORDER = 4, 6, 8
# Noise over a sample in units of nominal values: states, unknown parameters. A parameter may wander faster, so that one that has jumped is
# found again: of four models from the literature none has more than three times the error of a Kalman filter that knows all noises.
STATE_NOISE, PARAMETER_NOISE = 1e-3, 2.5e-3


@dataclass(frozen=True)
class Structure:
    """N, L, segments, whether there is an arrival cost, and `why` they were chosen: empty where they were given."""

    N: int
    L: int
    segments: int
    arrival: bool
    why: str = ""


def structure(
    model: Model,
    sample_time: float,
    given: Mapping[str, int | None],
    arrival: bool | None,
    plain: bool,
) -> Structure:
    """`given`: N, L and segments, None where they are not; `plain`: the paper's spline cost or its tube is asked for."""
    if plain or any(value is not None for value in given.values()):
        chosen = {name: PAPER[name] if value is None else value for name, value in given.items()}
        return Structure(chosen["N"], chosen["L"], chosen["segments"], bool(arrival))
    rate = fastest_rate(model)
    unknowns = len(model.states) + len(model.unknown_parameters)
    kinks = _kinks(model)
    L = max(SHORTEST, 2 * math.ceil(unknowns / len(model.outputs)))
    allowed = [m for m in range(1, L + 1) if L % m == 0 and (m == 1 or (not kinks and m * sample_time * rate <= 1))]
    samples = max(allowed)
    length = samples * sample_time * rate
    N = ORDER if length <= 2 else STIFF_ORDER if length <= 10 else STIFFEST_ORDER
    cause = (
        "a segment a sample, since held inputs put kinks into nonlinear rates"
        if kinks
        else f"{samples} {'sample' if samples == 1 else 'samples'} a segment by the fastest rate near the start values, {rate:.2g} 1/s"
    )
    return Structure(
        N,
        L,
        L // samples,
        True if arrival is None else arrival,
        f", chosen by the model with an arrival cost: {cause}"
        if arrival is not False
        else f", chosen by the model: {cause}",
    )


def process_noise(model: Model, sample_time: float) -> dict[str, float]:
    """Intensities by name, in the variable's unit per sqrt(s)."""
    return ports.intensities(model, sample_time, STATE_NOISE, PARAMETER_NOISE)


def longest_step(sample_time: float) -> float:
    """Of the prediction [s]: at most ten a sample, and none shorter than 0.1 s for length's sake."""
    return max(0.1, sample_time / 10)


def _kinks(model: Model) -> bool:
    """Whether held inputs put kinks into the rates' nonlinear part, directly or through the states."""
    eq, _ = lift_inputs(model.equations)
    return bool(model.inputs) and model.input_between_samples == "held" and split(eq.ode, eq.x, eq.u).phi.numel() > 0
