"""The covariance of the estimate: from the window's end, where the fit gives it, to the current time."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from observers.numerics import linear, tiles
from observers.numerics.finite import HUGE
from observers.pseudospectral.method import Method


def initial(method: Method, q: SimpleNamespace) -> Any:
    """That of the guess, stacked (ns^2): by `tuning.initial_std` where there is one, else the nominal values."""
    std = q.initial_std if method.arrival else ca.DM(method.problem.scale)
    return ca.vec(ca.densify(ca.diag(std**2)))


def standard_deviations(covariance: Any, unit: np.ndarray | None = None) -> Any:
    """Square roots of the diagonal (ns) of a stacked covariance, in `unit` (ns)."""
    ns = round(covariance.numel() ** 0.5)
    diagonal = ca.vertcat(*[covariance[i * (ns + 1)] for i in range(ns)])
    std = ca.sqrt(ca.fmax(diagonal, 0))
    return std / ca.DM(unit) if unit is not None else std


def moved(method: Method) -> ca.Function:
    """moved(P, x, z, u, p, theta, t, h, q) -> P a time h later, with the model linearised at (x, z, theta, t), half way.

    P' = A P + P A' + diag(q^2) by the (1, 2) Pade approximation of the exponential: third order, and it damps as stiff a model as there is.
    Its denominator D can lack pivots: few states are solved for by rotations, many by the tiles of D'D.
    A prediction whose linearisation is not finite leaves P as it was.
    """
    eq, ns, nx = method.model.equations, len(method.problem.scale), method.problem.nx
    kind = tiles.kind(ns)
    P, h, q = kind.sym("P", ns * ns), kind.sym("h"), kind.sym("q", ns)
    at = [eq.x, eq.z, eq.u, eq.p, eq.theta, eq.t]
    m = ca.vertcat(eq.x, eq.theta)
    slope = ca.jacobian(eq.ode, m)
    if eq.z.numel():
        through = linear.qr_solve(ca.jacobian(eq.algebraic, eq.z), ca.densify(ca.jacobian(eq.algebraic, m)))
        slope = slope - ca.mtimes(ca.jacobian(eq.ode, eq.z), through)
    arguments: list[Any] = at
    if kind is ca.MX:
        arguments = [ca.MX.sym(f"at{i}", part.numel()) for i, part in enumerate(at)]
        slope = ca.Function("slope", at, [slope], {"cse": True})(*arguments)
    hA = h * ca.vertcat(slope, kind(ns - nx, ns))
    unit = kind.eye(ns)
    D = unit - 2 * hA / 3 + ca.mtimes(hA, hA) / 6  # its lower rows are those of the unit matrix
    driven = method.settings.sizes["process_noise"] > 0
    right = ca.horzcat(unit + hA / 3, unit - hA / 6) if driven else unit + hA / 3
    corner, upper = D[:nx, :nx], ca.densify(right[:nx, :] - ca.mtimes(D[:nx, nx:], right[nx:, :]))
    if kind is ca.SX:
        upper = linear.qr_solve(corner, upper)
    else:
        corner = ca.densify(corner)
        # A column of zeros more: the window's solves have as many, and so the same kernels.
        solved, _ = tiles.solve(corner.T @ corner, ca.horzcat(corner.T @ upper, kind(ca.DM.zeros(nx, 1))))
        upper = solved[:, : upper.shape[1]]
    Phi = ca.vertcat(upper[:, :ns], right[nx:, :ns])
    after = ca.mtimes([Phi, ca.reshape(P, ns, ns), Phi.T])
    if driven:
        # Over h a rate is held; a parameter jumps at the end, as in the window.
        held = ca.mtimes(upper[:, ns : ns + nx], ca.diag(q[:nx]))
        after = after + h * ca.diagcat(ca.mtimes(held, held.T), ca.diag(q[nx:] ** 2))
    column = ca.vec(ca.densify(after))
    kept = ca.if_else(ca.sumsqr(column) < HUGE, column, P)
    return ca.Function("moved_covariance", [P, *arguments, h, q], [kept], {"cse": True})
