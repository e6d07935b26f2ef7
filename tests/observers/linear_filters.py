"""A linear model, the filters of it, and the Kalman filter that they are."""

from __future__ import annotations

import functools

import numpy as np
from scipy.linalg import expm

from observers.component import Component
from observers.least_squares import least_squares
from observers.model import Model, Variable
from observers.riccati import riccati
from observers.ukf import ukf

TS = 0.1
A = np.array([[0.0, 1.0], [-2.0, -0.3]])
F = expm(A * TS)
P0, W, R = np.diag([1.0, 4.0]), np.diag([0.1, 0.3]) ** 2, 0.2**2
GUESS = np.array([0.4, -0.7])
LINEAR = Model(
    name="linear",
    states=[Variable("a", start=0.4), Variable("b", start=-0.7)],
    outputs=[Variable("y")],
    ode=lambda x, u, p, t: [x.b, -2 * x.a - 0.3 * x.b],
    output=lambda x, u, p, t: [x.a],
)
KNOWN = {"measurement_noise": {"y": 0.2}, "initial_std": {"a": 1.0, "b": 2.0}}
MOVING = {"process_noise": {"a": 0.1, "b": 0.3}}
KINDS = ("ukf", "riccati", "least_squares")


@functools.cache
def made(kind: str) -> Component:
    if kind == "least_squares":
        return least_squares(LINEAR, sample_time=TS, T=100.0, **KNOWN)
    return {"ukf": ukf, "riccati": riccati}[kind](LINEAR, sample_time=TS, **KNOWN, **MOVING)


def van_loan(W: np.ndarray) -> np.ndarray:
    """What process noise of that intensity adds over a sample."""
    M = expm(np.block([[-A, W], [np.zeros((2, 2)), A.T]]) * TS)
    return M[2:, 2:].T @ M[:2, 2:]


class Reference:
    """The Kalman filter: estimate x, the covariance P that makes its gain, and S, that of its errors.

    The two differ in least squares, where the first sample of an interval has half a weight, and where there is no process noise. The
    unscented filter takes that in at the next sample, before the first one too.
    """

    def __init__(self, kind: str, W: np.ndarray = W, variance: float = R, first: np.ndarray = P0):
        self.kind, self.variance, self.first, self.x = kind, variance, first, GUESS
        self.noise = {"ukf": W * TS, "riccati": van_loan(W), "least_squares": np.zeros((2, 2))}[kind]
        self.start()
        if kind == "ukf":
            self.P = self.S = first + self.noise

    def start(self) -> None:
        self.P = self.S = self.first
        self.fresh = True

    def sample(self, y: float) -> None:
        believed = self.variance * (1 + (self.fresh and self.kind == "least_squares"))
        K = self.P[:, :1] / (self.P[0, 0] + believed)
        L = np.eye(2) - K @ [[1.0, 0.0]]
        self.x, self.P = self.x + K[:, 0] * (y - self.x[0]), L @ self.P
        self.S = L @ self.S @ L.T + self.variance * K @ K.T
        self.fresh = False

    def move(self) -> None:
        self.x = F @ self.x
        self.P, self.S = (F @ M @ F.T + self.noise for M in (self.P, self.S))
