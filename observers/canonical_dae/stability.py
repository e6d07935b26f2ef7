"""Stability of the linearised error dynamics over a model's region: Nikoukhah 1995, Corollary 2.1.

    nu' = (F + Gamma H) nu     (2.56),     H = -(h_x h_x')^-1 h_x,     F = f_x (I + h_x' H) - (d/dt h_x)' H

The corollary asks that this linear time-varying system be exponentially stable along the trajectory, of which nothing is known when the
observer is built. What can be computed then are its eigenvalues at points, x and u held: at an equilibrium they decide, elsewhere
they do where x and u move slowly. Where h_x is constant they are those that the gain places.

With unknown disturbances [E, h_x' M] and [0, Gamma] take the place of h_x' and Gamma, as in `dae`; the integrals of the disturbances, which
nothing moves back, are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from html import escape

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
            f"<p>Corollary 2.1: at {self.points} points of the model's region, x and u held, the eigenvalues of the linearised error "
            f"dynamics (2.56) have real parts from {self.fastest:.3g} to {self.slowest:.3g} 1/s, the last at {escape(self.where)}. "
            "Where x and u move fast they do not decide on stability.</p>"
        )


def error_dynamics(dae: Dae) -> ca.Function:
    """(x, u, p, t, Gamma) -> F + Gamma H, on the space beside the disturbances."""
    Gamma = ca.SX.sym("Gamma", dae.n, dae.n_lambda)
    beside = ca.horzcat(ca.SX(dae.n, dae.n_disturbances), Gamma)
    H = -ca.solve(ca.mtimes(dae.C, dae.G), dae.C)
    # d/dt G along x' = f, the inputs held.
    G = ca.vec(dae.G)
    moving = ca.reshape(ca.jtimes(G, dae.x, dae.f) + ca.jacobian(G, dae.t), *dae.G.shape)
    F = ca.mtimes(ca.jacobian(dae.f, dae.x), ca.SX.eye(dae.n) + ca.mtimes(dae.G, H)) - ca.mtimes(moving, H)
    M = ca.mtimes([ca.DM(dae.rest.T), F + ca.mtimes(beside, H), ca.DM(dae.rest.R)])
    return ca.Function("error_dynamics", [*dae.arguments, Gamma], [ca.densify(M)])


def spectrum(dae: Dae, gain: Gain, region: Region) -> Spectrum | None:
    """The spectrum over the region's points with the tuning's start values, at lambda = 0.

    None where the gain is valid at none, or no state is left.

    Raises:
        ModelError: an eigenvalue has no negative real part; the message names the one of the largest, and its point.
    """
    at = error_dynamics(dae)
    tuning, relaxation = [port.start for port in gain.tuning], [0.0] * dae.n_lambda
    found = []
    for point in region.points:
        Gamma, valid = gain.gamma(*point, relaxation, tuning)
        M = at(*point, Gamma).full()
        if M.size and valid and np.all(np.isfinite(M)):
            found.append((np.linalg.eigvals(M), point, ROUNDING * np.linalg.norm(M)))
    if not found:
        return None
    eigenvalues, point, rounding = max(found, key=lambda one: one[0].real.max())
    slowest = max(eigenvalues, key=lambda one: (one.real, one.imag))
    if slowest.real > -rounding:
        raise ModelError(
            f"canonical_dae: with {gain.description} the linearised error dynamics (2.56) of model '{region.model.name}' have the "
            f"eigenvalue {shown(slowest)} at {region.describe(point)}: an error does not decay there; take another "
            "gain, or narrower bounds of the model"
        )
    fastest = min(float(one.real.min()) for one, *_ in found)
    return Spectrum(len(found), float(slowest.real), fastest, region.describe(point))
