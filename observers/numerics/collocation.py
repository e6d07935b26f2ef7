"""The pseudospectral window: everything about [T - delta, T] that does not change from sample to sample.

With f = A x + B u + E phi the collocation equations at the nodes 1..N,

    sum_j D_kj X_j = (delta / 2) f(X_k)        (Gong, Ross & Kang 2007, (16) without node 0)

are linear in the first state x0 and the rates V_k = phi(X_k), so that X = Phi x0 + Psi V exactly, with constant Phi and Psi. (16) at all
N + 1 nodes is overdetermined: D has rank N. The forced response to B u is exact and apart: a held input has kinks that no polynomial follows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from observers.numerics import lgl
from observers.numerics.forced import forced_response, input_at
from observers.numerics.semilinear import Split


@dataclass(frozen=True)
class Window:
    """Constants of a window of `samples` = L sample intervals of length `sample_time` on LGL nodes of order N.

    Stacked vectors are node-major: X = [X_1; ...; X_N], V likewise. `Phi` (N nx x nx), `Psi` (N nx x N nv).
    """

    order: int
    samples: int
    sample_time: float
    split: Split
    input_kind: str
    Phi: np.ndarray
    Psi: np.ndarray

    @property
    def length(self) -> float:
        """delta = L Ts [s]."""
        return self.samples * self.sample_time

    @property
    def node_times(self) -> np.ndarray:
        """Times of the nodes 0..N since the window's start [s], by (9)."""
        return (lgl.nodes(self.order) + 1) / 2 * self.length

    def at(self, times: np.ndarray, states: list[int] | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(Ph, Ps, Xi) with [x(times)]_states = Ph x0 + Ps V + Xi U, stacked time by time; `times` [s] since the window's start."""
        nx = len(self.split.A)
        P = lgl.interpolation(self.order, 2 * np.asarray(times) / self.length - 1)
        spread = np.kron(P[:, 1:], np.eye(nx))
        Ph = np.kron(P[:, :1], np.eye(nx)) + spread @ self.Phi
        Ps = spread @ self.Psi
        Xi = forced_response(self.split.A, self.split.B, self.sample_time, self.samples, np.asarray(times), self.input_kind)
        keep = np.arange(len(times))[:, None] * nx + np.arange(nx)[states if states is not None else slice(None)]
        return Ph[keep.ravel()], Ps[keep.ravel()], Xi[keep.ravel()]

    def inputs_at(self, times: np.ndarray) -> np.ndarray:
        """Weights (len(times) x count) of the window's input values in u(times)."""
        return input_at(self.sample_time, self.samples, np.asarray(times), self.input_kind)

    @property
    def node0(self) -> tuple[np.ndarray, np.ndarray]:
        """(R0, RV): the residual of (16) at the dropped node 0 is R0 x0 + RV V - (delta / 2) E phi(x0)."""
        nx = len(self.split.A)
        d = lgl.differentiation(self.order)[0]
        spread = np.kron(d[None, 1:], np.eye(nx))
        return d[0] * np.eye(nx) + spread @ self.Phi - self.length / 2 * self.split.A, spread @ self.Psi


def window(split: Split, order: int, samples: int, sample_time: float, input_kind: str = "held") -> Window:
    """The constants for polynomial order N = `order` over L = `samples` intervals. Cost O((N nx)^3), once, at build time."""
    nx = len(split.A)
    half = samples * sample_time / 2
    integrate = np.linalg.inv(lgl.differentiation(order)[1:, 1:])  # A1: rates at the nodes to states, from the window's start
    S = np.linalg.inv(np.eye(order * nx) - half * np.kron(integrate, split.A))
    Phi = S @ np.kron(np.ones((order, 1)), np.eye(nx))
    Psi = half * S @ np.kron(integrate, split.E)
    return Window(order, samples, sample_time, split, input_kind, Phi, Psi)
