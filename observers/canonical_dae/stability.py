"""Stability of the linearised error dynamics over a model's region: Nikoukhah 1995, Corollary 2.1.

    nu' = (F + Gamma H) nu     (2.56),     H = -(h_x h_x')^-1 h_x,     F = f_x (I + h_x' H) - (d/dt h_x)' H

The corollary asks that this linear time-varying system be exponentially stable along the trajectory, of which nothing is known when the
observer is built. What can be computed then are its eigenvalues at points. With x and u held, d/dt h_x = 0, they are those of an
equilibrium there, where they decide (Theorem 3.1), or of a motion that is slow: they must be stable. Along a motion that moves h_x they
neither prove nor disprove it, and are shown. Where h_x is constant both are those that the gain places.

With unknown disturbances [E, h_x' M] and [0, Gamma] take the place of h_x' and Gamma, as in `dae`; the integrals of the disturbances, which
nothing moves back, are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import Any

import casadi as ca
import numpy as np

from observers.canonical_dae.dae import Dae
from observers.canonical_dae.gain import Gain
from observers.canonical_dae.region import Region, shown
from observers.model import ModelError

ROUNDING = 1e-9  # of the matrix' norm: an eigenvalue that is zero


@dataclass(frozen=True)
class Spectrum:
    """The real parts of the eigenvalues of (2.56) over `points` of the region at which the gain is what was asked for [1/s]."""

    points: int
    slowest: float
    fastest: float
    where: str

    def html(self) -> str:
        """What it says, as a paragraph."""
        return (
            f"<p>Corollary 2.1: at {self.points} points of the model's region the eigenvalues of the linearised error dynamics (2.56) "
            f"have real parts from {self.fastest:.3g} to {self.slowest:.3g} 1/s, the last at {escape(self.where)}. With x and u held all "
            "are negative; where they move fast the eigenvalues do not decide on stability.</p>"
        )


def error_dynamics(dae: Dae) -> ca.Function:
    """(x, u, p, t, Gamma) -> F + Gamma H along the motion, and with x and u held, on the space beside the disturbances."""
    Gamma = ca.SX.sym("Gamma", dae.n, dae.n_lambda)
    beside = ca.horzcat(ca.SX(dae.n, dae.n_disturbances), Gamma)
    H = -ca.solve(ca.mtimes(dae.C, dae.G), dae.C)
    # d/dt G along x' = f, the inputs held.
    G = ca.vec(dae.G)
    moving = ca.reshape(ca.jtimes(G, dae.x, dae.f) + ca.jacobian(G, dae.t), *dae.G.shape)
    held = ca.mtimes(ca.jacobian(dae.f, dae.x), ca.SX.eye(dae.n) + ca.mtimes(dae.G, H)) + ca.mtimes(beside, H)
    rest = [ca.mtimes([ca.DM(dae.rest.T), F, ca.DM(dae.rest.R)]) for F in (held - ca.mtimes(moving, H), held)]
    return ca.Function("error_dynamics", [*dae.arguments, Gamma], [ca.densify(M) for M in rest])


def spectrum(dae: Dae, gain: Gain, region: Region) -> Spectrum | None:
    """The spectrum over the region's points with the tuning's start values, at lambda = 0.

    None where the gain is valid at none, or no state is left.

    Raises:
        ModelError: with x and u held an eigenvalue has no negative real part; the message names the one of the largest, and its point.
    """
    at = error_dynamics(dae)
    tuning, relaxation = [port.start for port in gain.tuning], [0.0] * dae.n_lambda
    moving: list[tuple[np.ndarray, Any, float]] = []
    held: list[tuple[np.ndarray, Any, float]] = []
    for point in region.points:
        Gamma, valid = gain.gamma(*point, relaxation, tuning)
        matrices = [M.full() for M in at(*point, Gamma)]
        if valid and all(M.size and np.all(np.isfinite(M)) for M in matrices):
            for found, M in zip((moving, held), matrices, strict=True):
                found.append((np.linalg.eigvals(M), point, ROUNDING * float(np.linalg.norm(M))))
    if not moving:
        return None
    eigenvalues, point, rounding = max(held, key=lambda one: one[0].real.max())
    slowest = max(eigenvalues, key=lambda one: (one.real, one.imag))
    if slowest.real > -rounding:
        raise ModelError(
            f"canonical_dae: with {gain.description} the linearised error dynamics (2.56) of model '{region.model.name}' have the "
            f"eigenvalue {shown(slowest)} at {region.describe(point)}: an error does not decay there; take another "
            "gain, or narrower bounds of the model"
        )
    eigenvalues, point, _ = max(moving, key=lambda one: one[0].real.max())
    fastest = min(float(one.real.min()) for one, *_ in moving)
    return Spectrum(len(moving), float(eigenvalues.real.max()), fastest, region.describe(point))
