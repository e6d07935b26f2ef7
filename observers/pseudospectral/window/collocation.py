"""One segment of the pseudospectral window: everything about it that does not change from sample to sample.

With f = A x + B u + E phi the collocation equations at the nodes 1..N of a segment of length delta,

    sum_j D_kj X_j = (delta / 2) f(X_k)        (Gong, Ross & Kang 2007, (16) without node 0)

are linear in the segment's first state xs and the rates V_k = phi(X_k), so that X = Phi xs + Psi V exactly, with constant Phi and Psi. (16)
at all N + 1 nodes is overdetermined: D has rank N. The forced response to B u is exact and apart: a held input has
kinks that no polynomial follows. The paper's window is one segment; a long one is a chain of equal segments.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from flint import arb

from observers.numerics.exact import in_high_precision, matrix, rounded, table
from observers.numerics.semilinear import Split
from observers.pseudospectral.window import lgl
from observers.pseudospectral.window.forced import forced_response, input_at


@dataclass(frozen=True)
class Segment:
    """Constants of a segment of `samples` = L sample intervals of length `sample_time` on LGL nodes of order N.

    Stacked vectors are node-major: X = [X_1; ...; X_N], V likewise. `Phi` (N nx x nx), `Psi` (N nx x N nv), as Arb numbers. `noisy` are the
    states whose rates get a constant of their own, the process noise.
    """

    order: int
    samples: int
    sample_time: float
    split: Split
    input_kind: str
    Phi: np.ndarray
    Psi: np.ndarray
    noisy: tuple[int, ...] = ()

    @property
    def length(self) -> float:
        """delta = L Ts [s]."""
        return self.samples * self.sample_time

    @property
    def node_times(self) -> np.ndarray:
        """Times of the nodes 0..N since the segment's start [s], by (9)."""
        return (lgl.nodes(self.order) + 1) / 2 * self.length

    @in_high_precision
    def at(self, times: np.ndarray, states: list[int] | None = None) -> tuple[np.ndarray, np.ndarray]:
        """(Ph, Ps) with [x(times)]_states = Ph xs + Ps V + `forced` U, stacked time by time; `times` [s] since the segment's start."""
        nx = len(self.split.A)
        P = lgl.interpolation_exact(self.order, self._points(times))
        Ph = np.kron(P[:, :1], np.eye(nx, dtype=int)) + _spread(P[:, 1:], self.Phi, nx)
        Ps = _spread(P[:, 1:], self.Psi, nx)
        keep = self._keep(times, states)
        return rounded(Ph[keep]), rounded(Ps[keep])

    def forced(self, times: np.ndarray, states: list[int] | None = None) -> np.ndarray:
        """Xi: the exact response of [x(times)]_states to the segment's inputs U."""
        kind = self.input_kind
        if len(times) == 0:
            return np.zeros((0, self.inputs_at(np.zeros(1)).shape[1] * self.split.B.shape[1]))
        Xi = forced_response(self.split.A, self.split.B, self.sample_time, self.samples, np.asarray(times), kind)
        return Xi[self._keep(times, states)]

    def held(self, times: np.ndarray, states: list[int] | None = None) -> np.ndarray:
        """The exact response of [x(times)]_states (rows x noisy) to the constants on the rates of the noisy states."""
        if not self.noisy or len(times) == 0:
            return np.zeros((len(self._keep(times, states)), len(self.noisy)))
        onto = np.eye(len(self.split.A))[:, list(self.noisy)]
        each = forced_response(self.split.A, onto, self.sample_time, self.samples, np.asarray(times), "held")
        total = each.reshape(len(each), self.samples, len(self.noisy)).sum(axis=1)
        return np.asarray(total[self._keep(times, states)])

    @in_high_precision
    def from_nodes(self, times: np.ndarray) -> np.ndarray:
        """Weights (len(times) x N) of a quantity's values at the nodes 1..N in its value at `times`: a polynomial of degree N - 1."""
        tau = lgl.nodes_exact(self.order)[1:]
        rows = [
            [_product((x - tau[i]) / (tau[j] - tau[i]) for i in range(len(tau)) if i != j) for j in range(len(tau))]
            for x in self._points(times)
        ]
        return rounded(np.array(rows, dtype=object).reshape(len(times), self.order))

    def _points(self, times: np.ndarray) -> np.ndarray:
        return np.array([2 * arb(float(time)) / self.length - 1 for time in times], dtype=object)

    def _keep(self, times: np.ndarray, states: list[int] | None) -> np.ndarray:
        nx = len(self.split.A)
        chosen = np.arange(nx)[states if states is not None else slice(None)]
        return np.asarray((np.arange(len(times))[:, None] * nx + chosen).ravel(), dtype=int)

    def inputs_at(self, times: np.ndarray) -> np.ndarray:
        """Weights (len(times) x count) of the segment's input values in u(times)."""
        return input_at(self.sample_time, self.samples, np.asarray(times), self.input_kind)

    @property
    @in_high_precision
    def node0(self) -> tuple[np.ndarray, np.ndarray]:
        """(R0, RV): the residual of (16) at the dropped node 0 is R0 xs + RV V - (delta / 2) E phi(xs)."""
        nx = len(self.split.A)
        d = lgl.differentiation_exact(self.order)[:1]
        half = arb(self.length) / 2
        R0 = d[0, 0] * np.eye(nx, dtype=int) + _spread(d[:, 1:], self.Phi, nx) - half * table(matrix(self.split.A))
        return rounded(R0), rounded(_spread(d[:, 1:], self.Psi, nx))


@in_high_precision
def segment(
    split: Split,
    order: int,
    samples: int,
    sample_time: float,
    input_kind: str = "held",
    noisy: tuple[int, ...] = (),
) -> Segment:
    """The constants for polynomial order N = `order` over L = `samples` intervals. Cost O((N nx)^3), once, at build time."""
    nx = len(split.A)
    half = arb(samples * sample_time) / 2
    integrate = table(matrix(lgl.differentiation_exact(order)[1:, 1:]).inv())  # A1: rates at the nodes to states
    S = matrix(np.eye(order * nx, dtype=int) - half * np.kron(integrate, _whole(split.A)))
    right = np.hstack([_whole(np.kron(np.ones((order, 1)), np.eye(nx))), half * np.kron(integrate, _whole(split.E))])
    both = table(S.solve(matrix(right)))
    Phi, Psi = both[:, :nx], both[:, nx:]
    return Segment(order, samples, sample_time, split, input_kind, Phi, Psi, noisy)


def _whole(array: np.ndarray) -> np.ndarray:
    """The same doubles, exactly, as Arb numbers."""
    return table(matrix(array)) if array.size else array.astype(object)


def _product(factors: Iterable[arb]) -> arb:
    total = arb(1)
    for factor in factors:
        total = total * factor
    return total


def _spread(P: np.ndarray, stacked: np.ndarray, nx: int) -> np.ndarray:
    """(P (x) I) stacked for P (m x N), stacked (N nx x k), without forming the Kronecker product."""
    m, k = P.shape[0], stacked.shape[1]
    if m == 0 or k == 0:
        return np.empty((m * nx, k), dtype=object)
    flat = stacked.reshape(P.shape[1], nx * k)
    return table(matrix(P) * matrix(flat)).reshape(m * nx, k)
