"""The windowed least-squares problem: what its constants and its known terms are.

Points and nodes are worked on in groups, each by one function of scalars (SX). One group for all nodes while the problem is small: then a
whole step is one straight-line function. Beyond, groups of about `TILE` rows, so that the code does not grow with N^3.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from observers.numerics.collocation import Window
from observers.numerics.exact import product
from observers.numerics.pointwise import Pointwise
from observers.numerics.semilinear import Split

SMALL = 24  # rows of the collocation matrix up to which the step is one straight-line function
SMALL_POINTS = 2000  # entries of the measured points' matrix up to which it is


@dataclass(frozen=True)
class LeastSquares:
    """The constant data of the problem: a window, its rates phi, and outputs h = C x + D u + h_n(x_H, ...) measured at `points`.

    `points` are times [s] since the window's start; `scale` (ns) the nominal values of s = [x0; theta]; `rate_scale` (nv) those of V.
    """

    window: Window
    rates: Pointwise
    output: Split
    output_rest: Pointwise
    points: np.ndarray
    scale: np.ndarray
    rate_scale: np.ndarray
    n_parameters: int
    n_theta: int

    @property
    def nx(self) -> int:
        return len(self.window.split.A)

    @property
    def ny(self) -> int:
        return len(self.output.A)

    @property
    def n_rates(self) -> int:
        """Length of V: N nv."""
        return self.window.order * self.rates.n

    @property
    def is_small(self) -> bool:
        return self.n_rates <= SMALL and self.ny * len(self.points) * self.n_rates <= SMALL_POINTS

    @property
    def lengths(self) -> list[int]:
        """Lengths of the four parts of `known_terms`' result."""
        N, m, rest = self.window.order, len(self.points), self.output_rest
        return [self.rates.n_states * N, self.rates.n_known * N, self.ny * m, (rest.n_states + rest.n_known) * m]


def known_terms(problem: LeastSquares) -> ca.Function:
    """Function known_terms(t_start, U, seen, p) -> data: everything that stays fixed within a sample.

    The parts of `data`: forced response of the Q states at the nodes (nq N), known terms of phi at the nodes (ne N), C Xi U + D u at
    the points (ny m), forced response and known terms of h_n at the points ((nqh + neh) m). U is the stacked inputs of the
    window's intervals (held) or samples (linear), `seen` (nu m) those at the points, which the outputs see.
    """
    w, rates, rest = problem.window, problem.rates, problem.output_rest
    nodes = w.node_times[1:]
    at_nodes = w.inputs_at(nodes)
    nu = w.split.B.shape[1]
    count = at_nodes.shape[1]
    t, p, U = ca.MX.sym("t"), ca.MX.sym("p", problem.n_parameters), ca.MX.sym("U", count * nu)
    XiQ = w.at(nodes, w.split.states)[2]
    xi_points = w.at(problem.points)[2]
    seen = ca.MX.sym("seen", len(problem.points) * nu)
    offset = product(np.kron(np.eye(len(problem.points)), problem.output.A), xi_points)
    through = np.kron(np.eye(len(problem.points)), problem.output.B)
    XiH = w.at(problem.points, problem.output.states)[2]

    def terms(part: Pointwise, inputs: ca.MX, times: np.ndarray) -> ca.MX:
        if part.n_known == 0 or len(times) == 0:
            return ca.MX(0, 1)
        values = [part.known(t + float(time), inputs[i * nu : (i + 1) * nu], p) for i, time in enumerate(times)]
        return ca.vertcat(*values)

    def response(matrix: np.ndarray, inputs: ca.MX) -> ca.MX:
        return ca.MX(ca.DM(matrix)) @ inputs if matrix.size and matrix.any() else ca.MX(ca.DM.zeros(matrix.shape[0], 1))

    parts = [
        response(XiQ, U),
        terms(rates, ca.MX(ca.DM(np.kron(at_nodes, np.eye(nu)))) @ U if nu else ca.MX(0, 1), nodes),
        response(offset, U) + response(through, seen),
        ca.vertcat(response(XiH, U), terms(rest, seen, problem.points)),
    ]
    function = ca.Function("known_terms", [t, U, seen, p], [ca.vertcat(*parts)])
    return function.expand() if problem.is_small else function


def split_data(problem: LeastSquares, data: Any) -> tuple[list[Any], list[Any], list[Any], list[Any], list[Any]]:
    """The data's parts by node and by point: CQ_j, e_j; offset_i, CH_i, eh_i."""
    cuts = np.cumsum([0, *problem.lengths]).tolist()
    CQ, e, offset, rest = (data[a:b] for a, b in pairwise(cuts))
    N, m = problem.window.order, len(problem.points)
    nh = problem.output_rest.n_states

    def chop(vector: Any, each: int, count: int) -> list[Any]:
        return [vector[i * each : (i + 1) * each] for i in range(count)]

    return (
        chop(CQ, problem.rates.n_states, N),
        chop(e, problem.rates.n_known, N),
        chop(offset, problem.ny, m),
        chop(rest[: nh * m], nh, m),
        chop(rest[nh * m :], problem.output_rest.n_known, m),
    )
