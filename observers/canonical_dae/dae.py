"""A model as the relaxed DAE of Nikoukhah 1995, (2.10)-(2.11), generalised to unknown inputs: what its observer integrates.

    x' = f(x, u) + G mu' + Gamma_bar mu        0 = y - h(x)

What a known input adds to an output, y = h(x) + r(u), is taken from the measurement at its own instant: y - r(u) is continuous even where
u jumps, and no derivative of u is needed. Where the input is inside, y = h(x, u), the DAE is the same with h_x(x, u); it has a meaning
while u is continuous.

Without unknown disturbances G = h_x', mu = lambda: the paper's canonical observer. With q disturbances d that enter as E d, mu holds
their integrals delta and p - q relaxations lambda, G = [E, h_x' M], Gamma_bar = [0, Gamma]; M' h_x E = 0. Differentiating h once
gives h_x G mu' = ..., so that the index is 1 where h_x G is invertible, as in Lemma 2.1: where h_x E has full column rank.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from observers.canonical_dae.complement import Complement, complement, exact_inverse
from observers.model import Model, ModelError
from observers.numerics.exact import product


@dataclass(frozen=True)
class Dae:
    """The relaxed DAE's parts; n states (unknown parameters are states with zero rate), p outputs, q unknown disturbances.

    Symbols: `x` (n), `u`, `p`, `t`. Expressions: `f` (n) at d = 0, `h` (p), `r` (p) of u, p and t alone, `C` = h_x (p x n), `G` (n x p).
    Constants: `E` (n x q), `M` (p x p - q), `rest` the complement of E, `Pi` = I - E (C E)^+ C (n x n), `N_inverse` = (C G)^-1 with
    disturbances, else None.
    """

    x: ca.SX
    u: ca.SX
    p: ca.SX
    t: ca.SX
    f: ca.SX
    h: ca.SX
    r: ca.SX
    C: ca.SX
    G: ca.SX
    E: np.ndarray
    M: np.ndarray
    rest: Complement
    Pi: np.ndarray
    N_inverse: np.ndarray | None

    @property
    def n(self) -> int:
        return self.x.numel()

    @property
    def n_outputs(self) -> int:
        return self.h.numel()

    @property
    def n_disturbances(self) -> int:
        return self.E.shape[1]

    @property
    def n_lambda(self) -> int:
        """p - q."""
        return self.n_outputs - self.n_disturbances

    @property
    def arguments(self) -> list[ca.SX]:
        return [self.x, self.u, self.p, self.t]

    @property
    def linear_outputs(self) -> bool:
        """h is C x plus what depends on none of x, u and t, so that (2.11) is solved in one step."""
        moving = ca.vertcat(self.u, self.t)
        return not ca.depends_on(self.C, self.x) and not ca.depends_on(self.h, moving)


def relaxed(model: Model) -> Dae:
    """The DAE of `model`.

    Raises:
        ModelError: outputs that depend on a disturbance, or on a held input other than by a sum; more outputs than states; unknown
            disturbances with which the index is not 1.
    """
    eq = model.equations
    x = ca.vertcat(eq.x, eq.theta)
    f = ca.vertcat(eq.ode, ca.SX.zeros(eq.theta.numel()))
    h, r = _split(model, x)
    if len(model.outputs) > x.numel():
        raise ModelError(
            f"canonical_dae: model '{model.name}' has {len(model.outputs)} outputs for {x.numel()} states: they cannot be independent"
        )
    C = ca.jacobian(h, x)
    n, p, q = x.numel(), h.numel(), eq.w.numel()
    if q == 0:
        return Dae(
            x, eq.u, eq.p, eq.t, f, h, r, C, C.T, np.zeros((n, 0)), np.eye(p), _nothing(n), np.eye(n), N_inverse=None
        )
    names = ", ".join(v.name for v in model.unknown_disturbances)
    if q > p:
        raise ModelError(
            f"canonical_dae: model '{model.name}' has {q} unknown disturbances ({names}) and {p} outputs: it takes one output each, "
            "or the index exceeds 1"
        )
    E_symbolic, C_symbolic = ca.jacobian(f, eq.w), C
    if not (E_symbolic.is_constant() and C_symbolic.is_constant()):
        what = "disturbances enter the ODE" if not E_symbolic.is_constant() else "outputs depend on the states"
        raise ModelError(
            f"canonical_dae: model '{model.name}': with unknown disturbances ({names}), {what} by constant coefficients only"
        )
    E, Cn = ca.DM(E_symbolic).full(), ca.DM(C_symbolic).full()
    CE = product(Cn, E)
    rest, of_CE = complement(E), complement(CE)
    if rest is None or of_CE is None:
        raise ModelError(
            f"canonical_dae: model '{model.name}': h_x E of the unknown disturbances ({names}) has rank "
            f"{np.linalg.matrix_rank(CE)}, not {q}: no output's first derivative shows them all, so the index exceeds 1"
        )
    M = of_CE.T.T
    G = np.hstack([E, product(Cn.T, M)])
    N_inverse = exact_inverse(product(Cn, G))
    if N_inverse is None:
        raise ModelError(f"canonical_dae: model '{model.name}': the outputs are not independent")
    Pi = np.eye(n) - product(E, of_CE.L, Cn)
    f0 = ca.substitute(f, eq.w, ca.DM.zeros(q))
    return Dae(x, eq.u, eq.p, eq.t, f0, h, r, C, ca.SX(ca.DM(G)), E, M, rest, Pi, N_inverse)


def _split(model: Model, x: ca.SX) -> tuple[ca.SX, ca.SX]:
    """(h, r): each output as h(x) + r(u), or h(x, u) + 0 where the input is not added."""
    eq = model.equations
    start = ca.DM([v.start for v in (*model.states, *model.unknown_parameters)])
    u_start = ca.DM([v.start for v in model.inputs])
    h, r = [], []
    for variable, output in zip(model.outputs, ca.vertsplit(eq.output), strict=True):
        if ca.depends_on(output, eq.w):
            raise ModelError(
                f"canonical_dae: output '{variable.name}' of model '{model.name}' depends on an unknown disturbance: whatever the states "
                "are, some disturbance explains it. Leave the output out, or make the disturbance an unknown parameter"
            )
        inside = bool(model.inputs) and ca.depends_on(ca.jacobian(output, x), eq.u)
        if inside and model.input_between_samples == "held":
            raise ModelError(
                f"canonical_dae: output '{variable.name}' of model '{model.name}' depends on an input other than by a sum: h_x jumps with "
                "a held input, and h_x' lambda' has no meaning there; input_between_samples='linear' makes it continuous"
            )
        if inside or not ca.depends_on(output, eq.u):
            h.append(output)
            r.append(ca.SX(0))
            continue
        at_start = ca.substitute(output, eq.u, u_start)
        h.append(at_start)
        r.append(ca.substitute(output - at_start, x, start))
    return ca.vertcat(*h), ca.vertcat(*r)


def _nothing(n: int) -> Complement:
    return Complement(np.eye(n), np.eye(n), np.zeros((0, n)))
