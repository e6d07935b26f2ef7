"""Gamma of the canonical DAE observer by extended linearisation: Nikoukhah 1995, section 3.

Both methods find K such that A Pi - K M' C has the wanted eigenvalues on the space that is left beside the unknown disturbances; then

    Gamma = K M' C C' M - A Pi C' M,      without disturbances (3.7): Gamma = (J C - A) C'.

A = f_x, C = h_x are taken at the estimate itself, not at an equilibrium nearby (section 5 does so too).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from observers.component import Port
from observers.dae import Dae
from observers.model import Model, ModelError, Names
from observers.numerics.care import care
from observers.numerics.exact import product
from observers.numerics.placement import ackermann, observability_matrix
from observers.region import Region

Design = Callable[..., Iterable[Iterable[Any]]]  # (x, u, p, t) -> the rows of Gamma

PAIR_TOLERANCE = 1e-8  # smallest over largest singular value of an observability matrix that counts as regular
INJECTIONS = 6  # preliminary output injections that are tried


def _guard(description: str, start: float) -> Port:
    return Port("tuning.singularity_guard", description, start=start, min=1e-9, variability="tunable")


@dataclass(frozen=True)
class Gain:
    """gamma(x, u, p, t, tuning) -> (Gamma (n x p - q), valid: 1 where the gain is what was asked for, else 0)."""

    gamma: ca.Function
    tuning: tuple[Port, ...]
    description: str


def exact(dae: Dae, region: Region, poles: Sequence[float]) -> Gain:
    """Exact placement (3.17)-(3.21): Ackermann's formula on (v M'C, A - J_p M'C), v and J_p (3.22) chosen over the region.

    The division by the determinant of the observability matrix is guarded; the gain is valid where |det| > eps.

    Raises:
        ModelError: no v and J_p make the pair observable over the region.
        ValueError: the number of poles.
    """
    A, C = _reduced(dae)
    n = A.shape[0]
    if len(poles) != n or not all(pole < 0 for pole in poles):
        raise ValueError(f"nikoukhah: poles = {tuple(poles)} must be {n} negative numbers, one for each state")
    v, J_p = _single_output(dae, region, A, C)
    roots, eps = ca.SX.sym("poles", n), ca.SX.sym("eps")
    J_1, determinant = ackermann(A - ca.mtimes(ca.DM(J_p), C), ca.mtimes(ca.DM(v), C), roots, eps)
    K = ca.mtimes(J_1, ca.DM(v)) + ca.DM(J_p)
    several = n > 1
    ports = tuple(
        Port(
            f"tuning.pole[{i}]" if several else "tuning.pole",
            "eigenvalue of the linearised error dynamics",
            "1/s",
            float(pole),
            nominal=abs(float(pole)),
            max=-1e-6,
            variability="tunable",
        )
        for i, pole in enumerate(poles, start=1)
    )
    guard = _guard(
        "determinant of the observability matrix below which the gain is reduced instead of growing further", 1e-2
    )
    used = f"v = {_row(v)}" + (f", J_p = {J_p.tolist()}" if J_p.any() else "")
    return _gain(
        dae, K, ca.fabs(determinant) > eps, ca.vertcat(roots, eps), (*ports, guard), f"exact placement, {used}"
    )


def regional(dae: Dae, alpha: float, X: Sequence[float]) -> Gain:
    """Regional placement: K = P C' X / 2 (3.26) with P of the Riccati equation (3.25), X diagonal.

    eps^2 I is added to C' X C, which bounds P by 2 (alpha + ||A||) / eps^2 where the pair is not observable. The gain is valid
    where that changes the equation's C' X C term by less than its I.

    Raises:
        ValueError: alpha or X not positive, or the number of X's entries.
    """
    A, C = _reduced(dae)
    n, p = A.shape[0], C.shape[0]
    if not alpha > 0 or len(X) != p or not all(x > 0 for x in X):
        raise ValueError(f"nikoukhah: alpha = {alpha:g} and X = {tuple(X)} must be positive, X with {p} entries")
    rate, weights, eps = ca.SX.sym("alpha"), ca.SX.sym("X", p), ca.SX.sym("eps")
    identity = ca.SX.eye(n)
    shifted = A + rate * identity
    weighted = ca.mtimes(C.T, ca.diag(weights))
    # The Cayley transform wants more than ||A||, and about the closed loop's rates: sqrt(||C' X C||) is their scale.
    shift = 2 * (ca.norm_fro(shifted) + ca.sqrt(ca.norm_fro(ca.mtimes(weighted, C))))
    P = care(shifted, ca.mtimes(weighted, C) + eps**2 * identity, identity, shift)
    K = ca.mtimes(P, weighted) / 2
    guard = _guard("its square is added to C' X C, so that P stays bounded where the pair is not observable", 1e-3)
    ports = (
        Port(
            "tuning.alpha",
            "eigenvalues of the linearised error dynamics have real parts below -alpha",
            "1/s",
            alpha,
            nominal=alpha,
            min=1e-6,
            variability="tunable",
        ),
        *(
            Port(f"tuning.X[{i}]" if p > 1 else "tuning.X", "weight X", start=float(x), min=1e-9, variability="tunable")
            for i, x in enumerate(X, start=1)
        ),
        guard,
    )
    valid = eps**2 * ca.sumsqr(P) < ca.fmax(1, 1e-2 * rate * ca.trace(P))
    return _gain(dae, K, valid, ca.vertcat(rate, weights, eps), ports, "regional placement by a Riccati equation")


def given(dae: Dae, model: Model, design: Design) -> Gain:
    """The user's own Gamma(x, u), written with names like the model's equations: rows for the states, then the unknown parameters.

    Raises:
        ModelError: an unknown name, or not n x (p - q) entries.
    """
    eq = model.equations

    def names(group: str, variables: Sequence[Any], column: ca.SX) -> Names:
        return Names(group, {v.name: column[i] for i, v in enumerate(variables)})

    rows = design(
        names("state", model.states, eq.x),
        names("input", model.inputs, eq.u),
        names("parameter", (*model.parameters, *model.unknown_parameters), ca.vertcat(eq.p, eq.theta)),
        eq.t,
    )
    table = [[ca.SX(entry) for entry in row] for row in rows]
    if len(table) != dae.n or any(len(row) != dae.n_lambda for row in table):
        raise ModelError(
            f"nikoukhah: gain of model '{model.name}' has rows of lengths {[len(row) for row in table]}, "
            f"expected {dae.n} rows of {dae.n_lambda}"
        )
    Gamma = ca.vertcat(*[ca.horzcat(*row) for row in table])
    nothing = ca.SX(0, 1)
    return Gain(
        ca.Function("gamma", [*dae.arguments, nothing], [ca.densify(Gamma), ca.SX(1)], {"cse": True}),
        (),
        "a given gain",
    )


def _reduced(dae: Dae) -> tuple[ca.SX, ca.SX]:
    """(T A Pi R, M' C R): the pair (A, C) on the space that is left beside the disturbances; (A, C) itself without."""
    A = ca.jacobian(dae.f, dae.x)
    if dae.n_disturbances == 0:
        return A, dae.C
    T, R = ca.DM(dae.rest.T), ca.DM(dae.rest.R)
    return ca.mtimes(T, ca.mtimes(A, ca.DM(product(dae.Pi, dae.rest.R)))), ca.mtimes(
        ca.mtimes(ca.DM(dae.M.T), dae.C), R
    )


def observable_pair(dae: Dae) -> tuple[ca.SX, ca.SX]:
    """(observability matrix of the reduced pair, C): what is checked over the region."""
    A, C = _reduced(dae)
    return observability_matrix(C, A), dae.C


def _gain(dae: Dae, K: ca.SX, valid: ca.SX, tuning: ca.SX, ports: tuple[Port, ...], description: str) -> Gain:
    """Gamma of K, (3.7)."""
    A = ca.jacobian(dae.f, dae.x)
    if dae.n_disturbances == 0:
        Gamma = ca.mtimes(ca.mtimes(K, dae.C) - A, dae.C.T)
    else:
        M, R, Pi = ca.DM(dae.M), ca.DM(dae.rest.R), ca.DM(dae.Pi)
        CM = ca.mtimes(dae.C.T, M)
        Gamma = ca.mtimes(ca.mtimes(R, K), ca.mtimes(CM.T, CM)) - ca.mtimes(A, ca.mtimes(Pi, CM))
    gamma = ca.Function("gamma", [*dae.arguments, tuning], [ca.densify(Gamma), valid], {"cse": True})
    return Gain(gamma, ports, description)


def _single_output(dae: Dae, region: Region, A: ca.SX, C: ca.SX) -> tuple[np.ndarray, np.ndarray]:
    """The first (v (1 x p), J_p (n x p)) for which (v C, A - J_p C) is observable over the region; J_p = 0 if it can be."""
    p, n = C.shape
    at = ca.Function("pair", dae.arguments, [ca.densify(A), ca.densify(C)])
    pairs = [tuple(value.full() for value in at(*point)) for point in region.points]
    directions = [np.eye(p)[i : i + 1] for i in range(p)]
    if p > 1:
        directions += [np.ones((1, p)), np.arange(1.0, p + 1).reshape(1, p)]
    injections = [np.zeros((n, p))]
    injections += [
        np.array([[(3 * i + 5 * j + k) % 7 - 3.0 for j in range(p)] for i in range(n)]) for k in range(INJECTIONS)
    ]
    failed = region.points[0]
    for J_p in injections:
        for v in directions:
            for point, (A_at, C_at) in zip(region.points, pairs, strict=True):
                if not _regular(v @ C_at, A_at - J_p @ C_at):
                    failed = point
                    break
            else:
                return v, J_p
    raise ModelError(
        f"nikoukhah: no v and J_p of (3.20)-(3.22) make (v C, A - J_p C) observable over the region, "
        f"for example at {region.describe(failed)}; use gain='regional'"
    )


def _regular(c: np.ndarray, A: np.ndarray) -> bool:
    rows = [c]
    for _ in range(len(A) - 1):
        rows.append(rows[-1] @ A)
    # Rows grow like ||A||^k: each is measured by its own length.
    O = np.vstack([row / max(float(np.linalg.norm(row)), 1e-300) for row in rows])
    singular = np.linalg.svd(O, compute_uv=False)
    return bool(singular[-1] > PAIR_TOLERANCE * singular[0])


def _row(v: np.ndarray) -> str:
    return "(" + ", ".join(f"{x:g}" for x in v.ravel()) + ")"
