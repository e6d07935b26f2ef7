"""Gamma of the canonical DAE observer by extended linearisation: Nikoukhah 1995, section 3.

Both methods find K such that A Pi - K M' C has the wanted eigenvalues on the space that is left beside the unknown disturbances; then

    Gamma = K M' C C' M - A Pi C' M,      without disturbances (3.7): Gamma = (J C - A) C'.

A = f_x, C = h_x are taken at the estimate itself, not at an equilibrium nearby (section 5 does so too).
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from observers.canonical_dae.care import care
from observers.canonical_dae.dae import Dae
from observers.canonical_dae.placement import ackermann
from observers.canonical_dae.region import Region
from observers.canonical_dae.tuning import SLOWEST, poles, weight
from observers.component import Port
from observers.model import Model, ModelError, Names
from observers.numerics.exact import product
from observers.numerics.rank import unobservable

Design = Callable[..., Iterable[Iterable[Any]]]  # (x, u, p, t) or (x, u, p, t, lambda) -> the rows of Gamma

SMALLEST_GUARD = 1e-9
INJECTIONS = 6  # preliminary output injections that are tried


def _guard(description: str, start: float) -> Port:
    return Port("tuning.singularity_guard", description, start=start, min=SMALLEST_GUARD, variability="tunable")


@dataclass(frozen=True)
class Gain:
    """gamma(x, u, p, t, lambda, tuning) -> (Gamma (n x p - q), valid: 1 where the gain is what was asked for, else 0).

    `iterated`: Gamma is the result of an iteration, not of a formula.
    """

    gamma: ca.Function
    tuning: tuple[Port, ...]
    description: str
    iterated: bool = False


def choose(
    model: Model,
    dae: Dae,
    region: Region,
    gain: str | Design,
    poles: Sequence[complex] | None,
    alpha: float,
    X: ArrayLike | None,
) -> Gain:
    """The gain that the options of `canonical_dae` ask for.

    Raises:
        ModelError, ValueError: as below; an unknown name, options without a relaxation that they could tune.
    """
    if dae.n_lambda == 0:
        if poles or X is not None or gain not in ("exact", "regional"):
            raise ValueError(
                f"canonical_dae: model '{model.name}' has as many unknown disturbances as outputs: no relaxation is left for poles, X or a "
                "gain of one's own"
            )
        return _nothing_to_place(dae)
    if gain == "exact":
        return exact(dae, region, poles if poles is not None else [-10.0] * (dae.n - dae.n_disturbances))
    if gain == "regional":
        return regional(dae, alpha, X if X is not None else [1.0] * dae.n_lambda)
    if isinstance(gain, str):
        raise ValueError(f"canonical_dae: gain = {gain!r} must be 'exact', 'regional' or a function (x, u, p, t)")
    return given(dae, model, gain)


def exact(dae: Dae, region: Region, wanted: Sequence[complex]) -> Gain:
    """Exact placement (3.17)-(3.21): Ackermann's formula on (v M'C, A - J_p M'C), v and J_p (3.22) chosen over the region.

    The division by the determinant of the observability matrix is guarded; the gain is valid where |det| > eps.

    Raises:
        ModelError: no v and J_p make the pair observable over the region.
        ValueError: poles that `tuning` refuses.
    """
    A, C = reduced_pair(dae)
    placed = poles(wanted, A.shape[0])
    v, J_p = _single_output(dae, region, A, C)
    eps = ca.SX.sym("eps")
    cyclic = A - ca.mtimes(ca.DM(J_p), C)
    J_1, determinant = ackermann(cyclic, ca.mtimes(ca.DM(v), C), placed.polynomial_at(cyclic), eps)
    K = ca.mtimes(J_1, ca.DM(v)) + ca.DM(J_p)
    # A constant determinant is never near 0: what the guard takes off, eps^2 / det^2 of the gain, would be taken off for nothing.
    moves = ca.depends_on(determinant, ca.vertcat(dae.x, dae.u, dae.t))
    guard = _guard(
        "determinant of the observability matrix below which the gain is reduced instead of growing further",
        1e-2 if moves else SMALLEST_GUARD,
    )
    used = f"v = {_row(v)}" + (f", J_p = {J_p.tolist()}" if J_p.any() else "")
    tuning = ca.vertcat(placed.values, eps)
    return _gain(dae, K, ca.fabs(determinant) > eps, tuning, (*placed.ports, guard), f"exact placement, {used}")


def regional(dae: Dae, alpha: float, X: ArrayLike) -> Gain:
    """Regional placement: K = P C' X / 2 (3.26) with P of the Riccati equation (3.25).

    eps^2 I is added to C' X C, which bounds P by 2 (alpha + ||A||) / eps^2 where the pair is not observable. The gain is valid
    where that changes the equation's C' X C term by less than its I.

    Raises:
        ValueError: alpha below SLOWEST, an X that `tuning` refuses.
    """
    A, C = reduced_pair(dae)
    if not SLOWEST <= alpha < math.inf:
        raise ValueError(f"canonical_dae: alpha = {alpha:g} must be at least {SLOWEST:g} and finite")
    weighing = weight(X, C.shape[0])
    rate, eps = ca.SX.sym("alpha"), ca.SX.sym("eps")
    identity = ca.SX.eye(A.shape[0])
    shifted = A + rate * identity
    weighted = ca.mtimes(C.T, weighing.matrix)
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
            min=SLOWEST,
            variability="tunable",
        ),
        *weighing.ports,
        guard,
    )
    valid = eps**2 * ca.sumsqr(P) < ca.fmax(1, 1e-2 * rate * ca.trace(P))
    tuning = ca.vertcat(rate, weighing.values, eps)
    return _gain(dae, K, valid, tuning, ports, "regional placement by a Riccati equation", iterated=True)


def _nothing_to_place(dae: Dae) -> Gain:
    """The gain beside as many unknown disturbances as outputs: no lambda is left, what is left of the states decays by itself."""
    gamma = ca.Function("gamma", [*dae.arguments, _lambda(dae), ca.SX(0, 1)], [ca.SX(dae.n, 0), ca.SX(1)])
    return Gain(gamma, (), "no relaxation left to place eigenvalues with")


def given(dae: Dae, model: Model, design: Design) -> Gain:
    """The user's own Gamma(x, u), written with names like the model's equations: rows for the states, then the unknown parameters.

    A design of five arguments is given lambda (p - q x 1) too. Gamma(x, u, lambda, t) lambda is then any v of (2.4) that is differentiable
    in lambda and satisfies (2.8): v = (the integral of v_lambda(s lambda) over s from 0 to 1) lambda.

    Raises:
        ModelError: an unknown name, or not n x (p - q) entries.
    """
    eq = model.equations

    def names(group: str, variables: Sequence[Any], column: ca.SX) -> Names:
        return Names(group, {v.name: column[i] for i, v in enumerate(variables)})

    relaxation = _lambda(dae)
    rows = design(
        names("state", model.states, eq.x),
        names("input", model.inputs, eq.u),
        names("parameter", (*model.parameters, *model.unknown_parameters), ca.vertcat(eq.p, eq.theta)),
        eq.t,
        *([relaxation] if _takes_lambda(design) else []),
    )
    table = [[ca.SX(entry) for entry in row] for row in rows]
    if len(table) != dae.n or any(len(row) != dae.n_lambda for row in table):
        raise ModelError(
            f"canonical_dae: gain of model '{model.name}' has rows of lengths {[len(row) for row in table]}, "
            f"expected {dae.n} rows of {dae.n_lambda}"
        )
    Gamma = ca.vertcat(*[ca.horzcat(*row) for row in table])
    arguments = [*dae.arguments, relaxation, ca.SX(0, 1)]
    return Gain(
        ca.Function("gamma", arguments, [ca.densify(Gamma), ca.SX(1)], {"cse": True}),
        (),
        "a given gain",
    )


def _takes_lambda(design: Design) -> bool:
    try:
        inspect.signature(design).bind(*range(5))
    except TypeError:
        return False
    return True


def _lambda(dae: Dae) -> ca.SX:
    return ca.SX.sym("lambda", dae.n_lambda)


def reduced_pair(dae: Dae) -> tuple[ca.SX, ca.SX]:
    """(T A Pi R, M' C R): the pair (A, C) on the space that is left beside the disturbances; (A, C) itself without."""
    A = ca.jacobian(dae.f, dae.x)
    if dae.n_disturbances == 0:
        return A, dae.C
    T, R = ca.DM(dae.rest.T), ca.DM(dae.rest.R)
    return ca.mtimes(T, ca.mtimes(A, ca.DM(product(dae.Pi, dae.rest.R)))), ca.mtimes(
        ca.mtimes(ca.DM(dae.M.T), dae.C), R
    )


def _gain(
    dae: Dae, K: ca.SX, valid: ca.SX, tuning: ca.SX, ports: tuple[Port, ...], description: str, iterated: bool = False
) -> Gain:
    """Gamma of K, (3.7)."""
    A = ca.jacobian(dae.f, dae.x)
    if dae.n_disturbances == 0:
        Gamma = ca.mtimes(ca.mtimes(K, dae.C) - A, dae.C.T)
    else:
        M, R, Pi = ca.DM(dae.M), ca.DM(dae.rest.R), ca.DM(dae.Pi)
        CM = ca.mtimes(dae.C.T, M)
        Gamma = ca.mtimes(ca.mtimes(R, K), ca.mtimes(CM.T, CM)) - ca.mtimes(A, ca.mtimes(Pi, CM))
    gamma = ca.Function("gamma", [*dae.arguments, _lambda(dae), tuning], [ca.densify(Gamma), valid], {"cse": True})
    return Gain(gamma, ports, description, iterated)


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
                if len(unobservable(A_at - J_p @ C_at, v @ C_at)):
                    failed = point
                    break
            else:
                return v, J_p
    raise ModelError(
        f"canonical_dae: no v and J_p of (3.20)-(3.22) make (v C, A - J_p C) observable over the region, "
        f"for example at {region.describe(failed)}; use gain='regional'"
    )


def _row(v: np.ndarray) -> str:
    return "(" + ", ".join(f"{x:g}" for x in v.ravel()) + ")"
