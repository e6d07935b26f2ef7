"""What places the error dynamics of the canonical DAE observer, as tuning parameters: the poles of (3.17) and the weight X of (3.25).

Both are parametrised so that every value within a parameter's own bounds is a legal choice, whatever the others are: a tool sets them one
by one. Poles are real or come in conjugate pairs; X = L L' is positive definite for every L with a positive diagonal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from observers.component import Port

SLOWEST = 1e-6  # [1/s]: a pole's real part is at most its negative
SMALLEST = 1e-9  # a diagonal entry of X or of L


@dataclass(frozen=True)
class Poles:
    """Wanted eigenvalues: `ports`, and `values`, their symbols (n x 1): the real poles, then (real, imaginary) of each pair."""

    ports: tuple[Port, ...]
    values: ca.SX
    n_real: int

    def polynomial_at(self, A: ca.SX) -> ca.SX:
        """omega(A) (n x n) of (3.17): the factors (A - r I) of real poles, ((A - a I)^2 + b^2 I) of pairs a +- b i."""
        identity = ca.SX.eye(A.shape[0])
        product = identity
        for i in range(self.n_real):
            product = ca.mtimes(A - self.values[i] * identity, product)
        for i in range(self.n_real, self.values.numel(), 2):
            shifted = A - self.values[i] * identity
            product = ca.mtimes(ca.mtimes(shifted, shifted) + self.values[i + 1] ** 2 * identity, product)
        return product


def poles(wanted: Sequence[complex], n: int) -> Poles:
    """The parameters `tuning.pole[i]`, `tuning.pole_pair[i].real` and `.imaginary` for `wanted` [1/s], n of them.

    Raises:
        ValueError: not n poles, one that is not left of the imaginary axis, one without its conjugate.
    """
    given = [complex(pole) for pole in wanted]
    shown = "(" + ", ".join(_text(pole) for pole in given) + ")"
    if len(given) != n or not all(pole.real <= -SLOWEST and math.isfinite(abs(pole)) for pole in given):
        raise ValueError(
            f"canonical_dae: poles = {shown} must be {n} numbers with real parts of at most {-SLOWEST:g}, one for each state"
        )
    above = [pole for pole in given if pole.imag > 0]
    below = [pole for pole in given if pole.imag < 0]
    for pole in (*above, *below):
        if given.count(pole) != given.count(pole.conjugate()):
            raise ValueError(f"canonical_dae: poles = {shown}: {_text(pole)} is there without its conjugate")
    real = [pole.real for pole in given if pole.imag == 0]
    what = "eigenvalue of the linearised error dynamics"
    ports = [
        Port(
            _indexed("tuning.pole", i, len(real)),
            what,
            "1/s",
            pole,
            nominal=abs(pole),
            max=-SLOWEST,
            variability="tunable",
        )
        for i, pole in enumerate(real, start=1)
    ]
    for i, pole in enumerate(above, start=1):
        name, size = _indexed("tuning.pole_pair", i, len(above)), abs(pole)
        ports.append(
            Port(
                f"{name}.real",
                f"real part of a pair: {what}",
                "1/s",
                pole.real,
                nominal=size,
                max=-SLOWEST,
                variability="tunable",
            )
        )
        ports.append(
            Port(
                f"{name}.imaginary",
                f"imaginary part of a pair: {what}",
                "1/s",
                pole.imag,
                nominal=size,
                min=0.0,
                variability="tunable",
            )
        )
    return Poles(tuple(ports), ca.SX.sym("poles", n), len(real))


@dataclass(frozen=True)
class Weight:
    """X of (3.25): `ports`, `values`, their symbols, and `matrix`, X (p x p) as an expression of these."""

    ports: tuple[Port, ...]
    values: ca.SX
    matrix: ca.SX


def weight(X: ArrayLike, p: int) -> Weight:
    """The parameters of X (p x p): `tuning.X[i]` where the diagonal is given, `tuning.X_root[i,j]`, L's lower triangle, where all of X is.

    Raises:
        ValueError: a wrong shape, an X that is not symmetric and positive definite.
    """
    given = np.asarray(X, dtype=float)
    if given.shape not in ((p,), (p, p)) or not np.all(np.isfinite(given)):
        raise ValueError(f"canonical_dae: X = {given.tolist()} must be {p} numbers or a {p} x {p} matrix")
    if given.ndim == 1:
        if not np.all(given >= SMALLEST):
            raise ValueError(f"canonical_dae: X = {given.tolist()} must be positive, at least {SMALLEST:g}")
        diagonal = ca.SX.sym("X", p)
        ports = tuple(
            Port(_indexed("tuning.X", i, p), "weight X", start=float(x), min=SMALLEST, variability="tunable")
            for i, x in enumerate(given, start=1)
        )
        return Weight(ports, diagonal, ca.diag(diagonal))
    root = _cholesky(given)
    if root is None or not np.array_equal(given, given.T):
        raise ValueError(f"canonical_dae: X = {given.tolist()} must be symmetric and positive definite")
    places = [(i, j) for i in range(p) for j in range(i + 1)]
    values, L = ca.SX.sym("X_root", len(places)), ca.SX(p, p)
    made = []
    for k, (i, j) in enumerate(places):
        L[i, j] = values[k]
        name, text = f"tuning.X_root[{i + 1},{j + 1}]", f"entry {i + 1}, {j + 1} of L, X = L L'"
        low = SMALLEST if i == j else -math.inf
        made.append(Port(name, text, start=float(root[i, j]), min=low, variability="tunable"))
    return Weight(tuple(made), values, ca.mtimes(L, L.T))


def _cholesky(X: np.ndarray) -> np.ndarray | None:
    """L of X = L L'; None where a diagonal entry falls below SMALLEST. Entry by entry: LAPACK's last bits depend on the machine."""
    p = len(X)
    L = np.zeros((p, p))
    for i in range(p):
        for j in range(i + 1):
            rest = float(X[i, j]) - sum(float(L[i, k]) * float(L[j, k]) for k in range(j))
            if i == j:
                if not rest >= SMALLEST**2:
                    return None
                L[i, i] = math.sqrt(rest)
            else:
                L[i, j] = rest / float(L[j, j])
    return L


def _indexed(name: str, i: int, count: int) -> str:
    return f"{name}[{i}]" if count > 1 else name


def _text(pole: complex) -> str:
    return f"{pole.real:g}" if pole.imag == 0 else f"{pole.real:g}{pole.imag:+g}j"
