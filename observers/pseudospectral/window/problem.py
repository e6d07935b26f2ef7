"""The windowed least-squares problem: what its constants and its known terms are.

A window is a chain of equal segments (one: the paper's). Points and nodes of a segment are worked on in groups, each by one function of
scalars (SX). One group for all nodes while the problem is small: then a whole step is one straight-line function. Beyond, groups of about
`TILE` rows, so that the code does not grow with N^3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from observers.numerics import tiles
from observers.numerics.exact import product
from observers.numerics.layout import Layout
from observers.numerics.semilinear import Split
from observers.pseudospectral.window.collocation import Segment
from observers.pseudospectral.window.pointwise import Pointwise

SMALL = 24  # rows of the collocation matrix up to which a segment's step is one straight-line function
SMALL_POINTS = 2000  # entries of the measured points' matrix up to which it is


@dataclass(frozen=True)
class LeastSquares:
    """The constant data of the problem: `count` segments, rates phi, and outputs h = C x + D u + h_n(x_H, ...) measured at `points`.

    `points` are times [s] since a segment's start; the first is the start itself, which counts in the first segment only. `scale` (ns) are
    the nominal values of s = [x0; theta], `rate_scale` (nv) those of V, `output_scale` (ny) those of the outputs. `bounded` are the states
    with bounds on the nodes. `path` (None: no constraints) is the same window with the path constraints in the outputs' place, at the nodes
    and the sample instants. `noisy_parameters` are the unknown parameters that jump by process noise at the segments' ends, which a last
    measured point sees if `sees_jumps`; the segment's `noisy` states have some on their rates.
    """

    segment: Segment
    count: int
    rates: Pointwise
    output: Split
    output_rest: Pointwise
    points: np.ndarray
    scale: np.ndarray
    rate_scale: np.ndarray
    output_scale: np.ndarray
    n_parameters: int
    n_theta: int
    bounded: tuple[int, ...] = ()
    noisy_parameters: tuple[int, ...] = ()
    output_sees_theta: bool = False
    path: LeastSquares | None = None

    @property
    def nx(self) -> int:
        return len(self.segment.split.A)

    @property
    def ny(self) -> int:
        return len(self.output.A)

    @property
    def nu(self) -> int:
        return int(self.segment.split.B.shape[1])

    @property
    def n_rates(self) -> int:
        """Length of a segment's V: N nv."""
        return self.segment.order * self.rates.n

    @property
    def n_algebraic(self) -> int:
        """Length of a segment's Z: N nz."""
        return self.segment.order * self.rates.n_algebraic

    @property
    def n_measured(self) -> int:
        """Number of measured points in the window."""
        return len(self.points) + (self.count - 1) * (len(self.points) - 1)

    @property
    def has_ends(self) -> bool:
        """Whether what happens at a segment's end matters to the solve."""
        return self.count > 1 or self.n_noise > 0

    @property
    def noisy_states(self) -> tuple[int, ...]:
        return self.segment.noisy

    @property
    def n_noise(self) -> int:
        """Length of a segment's noise: constants of the noisy states' rates, jumps of the noisy parameters."""
        return len(self.noisy_states) + len(self.noisy_parameters)

    @property
    def sees_jumps(self) -> bool:
        return bool(self.noisy_parameters) and self.output_sees_theta

    def jumps(self, noise: Any, j: int) -> Any:
        """By how much theta (nt) moves at the end of segment j; `noise` (count n_noise)."""
        place, first = j * self.n_noise, len(self.noisy_states)
        onto = np.eye(self.n_theta)[:, list(self.noisy_parameters)]
        return ca.mtimes(type(noise)(ca.DM(onto)), noise[place + first : place + self.n_noise])

    def thetas(self, theta: Any, noise: Any) -> list[Any]:
        """The unknown parameters of each segment."""
        found = [theta]
        for j in range(self.count - 1):
            found.append(found[-1] + self.jumps(noise, j) if self.noisy_parameters else theta)
        return found

    def driven(self, U: Any, noise: Any) -> Any:
        """What drives the window's trajectory: its inputs, and the constants on the noisy states' rates, segment by segment."""
        n = len(self.noisy_states)
        if n == 0:
            return U
        return ca.vertcat(U, *[noise[j * self.n_noise : j * self.n_noise + n] for j in range(self.count)])

    @property
    def n_driven(self) -> int:
        return self.inputs(self.count - 1).stop + self.count * len(self.noisy_states)

    def noise_terms(self, j: int) -> np.ndarray:
        """d data(j) / d the segment's noise: what the constants on the rates add to the forced responses."""
        s, rest = self.segment, self.output_rest
        nodes, points = s.node_times[1:], self.points_of(j)
        there = {
            "forced": s.held(nodes, s.split.states),
            "offset": self.observed_noise(points),
            "forced_output": s.held(points, self.output.states) if rest.n else np.zeros((0, len(self.noisy_states))),
            "forced_bounded": s.held(nodes, list(self.bounded)),
            "forced_end": s.held(np.array([s.length])),
        }
        if self.path is not None:
            along = self.path.points_of(j)
            there["path_offset"] = self.path.observed_noise(along)
            there["path_forced"] = s.held(along, self.path.output.states)
        rows = [
            there[name] if name in there and size else np.zeros((size, len(self.noisy_states)))
            for name, size in self.data(j).sizes.items()
        ]
        whole = np.vstack(rows)
        return np.hstack([whole, np.zeros((len(whole), len(self.noisy_parameters)))])

    def observed_noise(self, points: np.ndarray) -> np.ndarray:
        """The same of the outputs' linear part at `points` (ny m x noisy)."""
        return product(np.kron(np.eye(len(points)), self.output.A), self.segment.held(points))

    def direct(self, response: np.ndarray) -> np.ndarray | None:
        """A response (rows x noisy) as a derivative by [1; s; noise]; None of a problem without noise."""
        if not self.n_noise:
            return None
        before = np.zeros((len(response), 1 + len(self.scale)))
        return np.hstack([before, response, np.zeros((len(response), len(self.noisy_parameters)))])

    @property
    def segment_is_small(self) -> bool:
<<<<<<< HEAD
        compared = self.ny * len(self.points) + (self.path.ny * len(self.path.points) if self.path is not None else 0)
        return self.n_rates <= SMALL and compared * self.n_rates <= SMALL_POINTS
=======
        few = tiles.kind(len(self.scale)) is ca.SX
        return few and self.n_rates <= SMALL and self.ny * len(self.points) * self.n_rates <= SMALL_POINTS
>>>>>>> a98aff1 (Windows of many unknowns: damped steps until the samples determine the state, so that wrong guesses converge; dense algebra in loops, less C)

    @property
    def kind(self) -> Any:
        """Of expressions over the whole window: SX where one straight-line function does, MX beyond."""
        return ca.SX if self.count == 1 and self.segment_is_small else ca.MX

    def points_of(self, j: int) -> np.ndarray:
        """The measured points of segment j."""
        return self.points if j == 0 else self.points[1:]

    def measured(self, j: int) -> slice:
        """Those points' places among all measured points' outputs."""
        each = len(self.points) - 1
        start = j * each + (j > 0)
        return slice(start * self.ny, (start + len(self.points_of(j))) * self.ny)

    def inputs(self, j: int) -> slice:
        """The places of segment j's inputs among the window's: one an interval (held) or one a sample (linear)."""
        samples = self.segment.samples
        return slice(j * samples * self.nu, ((j + 1) * samples + (self.segment.input_kind == "linear")) * self.nu)

    def data(self, j: int) -> Layout:
        """What is known of segment j: forced responses and known terms at nodes and points, the response at its end, and of the path."""
        N, m, rest, path = self.segment.order, len(self.points_of(j)), self.output_rest, self.path
        along = len(path.points_of(j)) if path is not None else 0
        return Layout(
            forced=self.rates.n_states * N,
            known=self.rates.n_known * N,
            offset=self.ny * m,
            forced_output=rest.n_states * m,
            known_output=rest.n_known * m,
            forced_bounded=len(self.bounded) * N,
            forced_end=self.nx if self.has_ends else 0,
            path_offset=path.ny * along if path is not None else 0,
            path_forced=path.output_rest.n_states * along if path is not None else 0,
            path_known=path.output_rest.n_known * along if path is not None else 0,
        )

    @property
    def n_data(self) -> int:
        return sum(self.data(j).total for j in range(self.count))

    def data_of(self, j: int) -> slice:
        start = sum(self.data(i).total for i in range(j))
        return slice(start, start + self.data(j).total)

    def chop(self, vector: Any, each: int) -> list[Any]:
        """A stacked quantity of the whole window, segment by segment."""
        return [vector[j * each : (j + 1) * each] if each else type(vector)(0, 1) for j in range(self.count)]


def known_terms(problem: LeastSquares) -> ca.Function:
    """Function known_terms(t_start, U, seen, p) -> data: everything that stays fixed within a sample, segment by segment.

    U is the stacked inputs of the window's intervals (held) or samples (linear), `seen` (nu m) those at the points, which the outputs see.
    """
    s, nu = problem.segment, problem.nu
    t, p = ca.MX.sym("t"), ca.MX.sym("p", problem.n_parameters)
    U = ca.MX.sym("U", problem.inputs(problem.count - 1).stop)
    seen = ca.MX.sym("seen", problem.n_measured * nu)
    parts = []
    for j in range(problem.count):
        first = problem.measured(j).start // problem.ny
        here = seen[first * nu : (first + len(problem.points_of(j))) * nu] if nu else ca.MX(0, 1)
        u = U[problem.inputs(j)] if nu else ca.MX(0, 1)
        parts.append(_segment_terms(problem, min(j, 1))(t + j * s.length, u, here, p))
    function = ca.Function("known_terms", [t, U, seen, p], [ca.vertcat(*parts)])
    return function.expand() if problem.kind is ca.SX else function


def _segment_terms(problem: LeastSquares, j: int) -> ca.Function:
    s, rates, rest, nu = problem.segment, problem.rates, problem.output_rest, problem.nu
    nodes, points = s.node_times[1:], problem.points_of(j)
    t, p = ca.MX.sym("t"), ca.MX.sym("p", problem.n_parameters)
    U = ca.MX.sym("U", problem.inputs(0).stop)
    seen = ca.MX.sym("seen", len(points) * nu)
    everything = list(range(problem.nx))

    def terms(part: Pointwise, inputs: ca.MX, times: np.ndarray) -> ca.MX:
        if part.n_known == 0 or len(times) == 0:
            return ca.MX(0, 1)
        values = [part.known(t + float(time), inputs[i * nu : (i + 1) * nu], p) for i, time in enumerate(times)]
        return ca.vertcat(*values)

    def response(matrix: np.ndarray, inputs: ca.MX) -> ca.MX:
        return ca.MX(ca.DM(matrix)) @ inputs if matrix.size and matrix.any() else ca.MX(ca.DM.zeros(matrix.shape[0], 1))

    def forced(times: np.ndarray, states: list[int]) -> ca.MX:
        return response(s.forced(times, states), U)

    def observed(part: Split, inputs: ca.MX, times: np.ndarray) -> ca.MX:
        """Of the linear part of outputs at `times`, what is forced and what passes through."""
        offset = product(np.kron(np.eye(len(times)), part.A), s.forced(times, everything))
        return response(offset, U) + response(np.kron(np.eye(len(times)), part.B), inputs)

    def inputs_at(times: np.ndarray) -> ca.MX:
        return ca.MX(ca.DM(np.kron(s.inputs_at(times), np.eye(nu)))) @ U if nu and len(times) else ca.MX(0, 1)

    path, along = problem.path, problem.path.points_of(j) if problem.path is not None else np.empty(0)
    there = inputs_at(along)
    data = problem.data(j).pack(
        {
            "forced": forced(nodes, s.split.states),
            "known": terms(rates, inputs_at(nodes), nodes),
            "offset": observed(problem.output, seen, points),
            "forced_output": forced(points, problem.output.states),
            "known_output": terms(rest, seen, points),
            "forced_bounded": forced(nodes, list(problem.bounded)),
            "forced_end": forced(np.array([s.length]) if problem.has_ends else np.empty(0), everything),
            "path_offset": observed(path.output, there, along) if path is not None else ca.MX(0, 1),
            "path_forced": forced(along, path.output.states) if path is not None else ca.MX(0, 1),
            "path_known": terms(path.output_rest, there, along) if path is not None else ca.MX(0, 1),
        }
    )
    return ca.Function("segment_terms", [t, U, seen, p], [data])
