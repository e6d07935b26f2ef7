"""The trade-off between the rate and the radius of convergence, James & Baras 1987, remark to Theorem 2.1: designs over a grid.

The rate that is guaranteed for a guess d off is r0 / (2 q) (1 - d / rho), or where delta > 0 at least q delta / 2 from anywhere
(`certificates`). Multiplying N and R by c, and Q0 by c^2, changes none of them, nor the estimate: of the three scales two are left, and R
stays. Of Q0 only its size beside q counts, the bound of Q that N and R give by themselves: beyond it q grows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from observers.arguments import checked
from observers.linearisation import linearisation
from observers.model import Model, ModelError
from observers.refusal import refuse
from observers.riccati.certificates import Certificate, certificate_of
from observers.riccati.design import UNKNOWN, Given, design
from observers.riccati.suprema import suprema_of

N_SCALES = np.geomspace(1e-3, 1e3, 25)
Q0_PARTS = np.geomspace(1e-6, 1, 61)  # of q
SMALLEST = 1e-150  # |Q0| that has no part in q


@dataclass(frozen=True)
class Tried:
    """A design, and its certificate. `design`: N, R and Q0 as `riccati` takes them, N and Q0 over the states and unknown parameters."""

    design: dict[str, np.ndarray]
    certificate: Certificate

    def rate(self, distance: float) -> float:
        """The guaranteed rate [1/s] of a guess at most `distance` off; infinite: anywhere. 0 where there is no guarantee."""
        return float(self.certificate.rate(min(distance, UNKNOWN)))

    def radius(self, rate: float) -> float:
        """How far off a guess may be for the error to decay at least with `rate` [1/s]; 0 where none decays that fast for certain."""
        if 0 < self.rate(math.inf) >= rate:
            return math.inf
        near = self.rate(0.0)
        return self.certificate.rho * (1 - rate / near) if rate < near else 0.0


@checked
def trade_off(model: Model, *, N: Given = 1.0, R: Given = 1.0, Q0: Given = 1.0) -> tuple[Tried, ...]:
    """The designs of a grid of which no other guarantees more, the slowest and widest first.

    N is multiplied by each of N_SCALES, and Q0 so that |Q0| is each of Q0_PARTS of q. The certificates are those of the model's bounds and
    of its parameters' start values, for the continuous-time observer.

    Args:
        model: as for `riccati`.
        N, R, Q0: the paper's design matrices that are scaled, as for `riccati`.

    Raises:
        ModelError: algebraic variables or unknown disturbances; a name that is none of the model's; no design has a certificate, and why.
        ValueError: a design matrix of a wrong shape or singular, a Q0 that is not symmetric positive definite.
    """
    refuse(model, "trade_off", "algebraic", "unknown_disturbances")
    line = linearisation(model)
    none = dict.fromkeys(("process_noise", "measurement_noise", "initial_std"))
    given = design(model, line.variables, 1.0, {"N": N, "R": R, "Q0": Q0}, none)
    unit = given.Q0.start / np.linalg.norm(given.Q0.start, 2)
    over, tried, obstacle = suprema_of(model, line), [], ""
    for scale in N_SCALES:
        certificate = certificate_of(over, scale * given.N.start, given.R.start)
        least = certificate(SMALLEST * unit)
        if not least.exists:
            obstacle = least.obstacle
            continue
        for part in Q0_PARTS:
            matrices = {"N": scale * given.N.start, "R": given.R.start, "Q0": part * least.q * unit}
            tried.append(Tried({k: _plain(M) for k, M in matrices.items()}, certificate(matrices["Q0"])))
    if not tried:
        raise ModelError(f"trade_off: no design of model '{model.name}' has a certificate: {obstacle}")
    return _front(tried)


def fastest(front: Sequence[Tried], radius: float) -> Tried:
    """The design that guarantees the highest rate for a guess at most `radius` off; infinite: from anywhere.

    Raises:
        ValueError: none guarantees any.
    """
    best = max(front, key=lambda one: one.rate(radius))
    if not best.rate(radius) > 0:
        widest_ = max(one.radius(0.0) for one in front)
        raise ValueError(f"fastest: no design converges for certain from {radius:g} off; the farthest is {widest_:.4g}")
    return best


def widest(front: Sequence[Tried], rate: float) -> Tried:
    """The design that guarantees the decay `rate` [1/s] from the farthest guesses.

    Raises:
        ValueError: none guarantees it.
    """
    best = max(front, key=lambda one: one.radius(rate))
    if not best.radius(rate) > 0:
        fastest_ = max(one.rate(0.0) for one in front)
        raise ValueError(
            f"widest: no design decays for certain with {rate:g} 1/s; the fastest decays with {fastest_:.4g} 1/s"
        )
    return best


def _front(tried: Sequence[Tried]) -> tuple[Tried, ...]:
    """Those that no other equals or exceeds in the rate close by, the radius and the rate from anywhere; of equals the first."""
    found: list[tuple[tuple[float, float, float], Tried]] = []
    for one in sorted(tried, key=lambda one: (-one.rate(0.0), -one.radius(0.0), -one.rate(math.inf))):
        measures = (one.rate(0.0), one.radius(0.0), one.rate(math.inf))
        if not any(all(a >= b for a, b in zip(other, measures, strict=True)) for other, _ in found):
            found.append((measures, one))
    return tuple(one for _, one in reversed(found))


def _plain(M: np.ndarray) -> np.ndarray:
    """The diagonal of a matrix that is one: `riccati` then has n parameters for it, and not n^2."""
    diagonal = np.diag(M)
    return diagonal if np.array_equal(M, np.diag(diagonal)) else M
