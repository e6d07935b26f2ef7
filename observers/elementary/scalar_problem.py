"""A scalar optimal control problem with unknown initial state, on the samples of a window: what its solvers solve.

    minimise  sum_n w_n l(xi_n) + sum_i s/2 sum_j r_j delta_ij^2
    over xi_0 .. xi_(N-1) and delta_ij, subject to
    xi_(i+1) = xi_i + s (rate_i + F((xi_i + xi_(i+1)) / 2, nu_i + delta_i) - F((ref_i + ref_(i+1)) / 2, nu_i)),
    lower_j <= nu_ij + delta_ij <= upper_j

State xi on N nodes, s apart; controls constant on the N - 1 intervals, nu_i their references; w_n the trapezoidal rule's weights. `rate`
is the mean of F along the references: where the solution equals them, the only discretisation error is that of `rate`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca


@dataclass(frozen=True)
class ScalarProblem:
    """The functions of a scalar problem with m controls.

    Attributes:
        name: of its state, an identifier.
        dynamics: (xi, nu (m), known, p) -> (F, dF/dxi, dF/dnu (m)); `known` belongs to the interval.
        penalty: (xi, ref, target, p, q) -> (l, dl/dxi, its Gauss-Newton second derivative, > 0); `target` belongs to the node.
        affine: F is affine in (xi, nu) and l quadratic.
        lower, upper: bounds of the controls, infinite where there are none.
        nodes: the grid's range of xi and the number of its nodes, for solvers that have one.
    """

    name: str
    dynamics: ca.Function
    penalty: ca.Function
    affine: bool
    lower: Sequence[float]
    upper: Sequence[float]
    nodes: tuple[float, float, int]

    @property
    def n_controls(self) -> int:
        return len(self.lower)

    def arguments(self, kind: Any, N: int) -> SimpleNamespace:
        """The arguments of a solver on N nodes, as symbols: one column for each node or interval."""
        m = self.n_controls
        return SimpleNamespace(
            ref=kind.sym("ref", 1, N),
            nu=kind.sym("nu", m, N - 1),
            rate=kind.sym("rate", 1, N - 1),
            known=kind.sym("known", self.dynamics.numel_in(2), N - 1),
            target=kind.sym("target", self.penalty.numel_in(2), N),
            active=kind.sym("active", 1, N - 1),  # 1, or 0 for an interval before the first sample
            s=kind.sym("s"),
            p=kind.sym("p", self.dynamics.numel_in(3)),
            q=kind.sym("q"),
            r=kind.sym("r", m),
        )
