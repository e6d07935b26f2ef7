"""Linear models whose matrices are parameters, so that one FMU of an observer stands for every system of its size; their Kalman filter."""

import numpy as np
from scipy.linalg import expm

from observers import least_squares as least_squares_room
from observers import riccati as riccati_room
from observers.component import Component
from observers.model import Model, Variable

SAMPLE_TIME = 0.1  # [s]
LARGEST = 8


def outputs_of(n: int) -> int:
    """How many outputs the model of n states has: 1, 2 or 3."""
    return 1 + n % 3


def linear(n: int, ny: int) -> Model:
    """x' = A x + u, y = C x, with the entries of A and C as parameters."""
    a = [[f"a{i}{j}" for j in range(n)] for i in range(n)]
    c = [[f"c{i}{j}" for j in range(n)] for i in range(ny)]

    def product(rows, x, p):
        return [sum(getattr(p, entry) * getattr(x, f"x{j}") for j, entry in enumerate(row)) for row in rows]

    return Model(
        name=f"linear_{n}",
        states=[Variable(f"x{i}") for i in range(n)],
        inputs=[Variable("u")],
        outputs=[Variable(f"y{i}") for i in range(ny)],
        parameters=[Variable(entry) for row in a + c for entry in row],
        ode=lambda x, u, p, t: [rate + u.u for rate in product(a, x, p)],
        output=lambda x, u, p, t: product(c, x, p),
    )


def entries(A: np.ndarray, C: np.ndarray) -> dict[str, float]:
    """The parameters of `linear` for the matrices A and C."""
    return {f"parameter.{letter}{i}{j}": v for letter, M in (("a", A), ("c", C)) for (i, j), v in np.ndenumerate(M)}


def design(**matrices: np.ndarray) -> dict[str, float]:
    """The parameters `tuning.<name>[i,j]` for whole matrices."""
    return {f"tuning.{name}[{i + 1},{j + 1}]": v for name, M in matrices.items() for (i, j), v in np.ndenumerate(M)}


def riccati(n: int) -> Component:
    """The Riccati observer of `linear`, its design matrices whole, Q put out."""
    ny = outputs_of(n)
    one = np.eye(n)
    return riccati_room.riccati(linear(n, ny), sample_time=SAMPLE_TIME, N=one, R=np.eye(ny), Q0=one, expose=["Q"])


def least_squares(n: int) -> Component:
    """The least-squares observer of `linear`."""
    return least_squares_room.least_squares(linear(n, outputs_of(n)), sample_time=SAMPLE_TIME, T=0.5)


def kalman(A, C, N, R, Q, m, samples, inputs, Ts):
    """The sampled Kalman filter's estimate and Q after each step, by Van Loan's exponential, in textbook form; NaN: no sample."""
    n = len(A)
    E = expm(Ts * np.block([[-A, N @ N.T], [np.zeros((n, n)), A.T]]))
    Phi = E[n:, n:].T
    Wd = Phi @ E[:n, n:]
    held = expm(Ts * np.block([[A, np.ones((n, 1))], [np.zeros((1, n + 1))]]))[:n, n]
    Rd = R @ R.T / Ts
    for y, u in zip(samples, inputs, strict=True):
        there = np.isfinite(y)
        if there.any():
            H, noise = C[there], Rd[np.ix_(there, there)]
            K = Q @ H.T @ np.linalg.inv(H @ Q @ H.T + noise)
            m, Q = m + K @ (y[there] - H @ m), Q - K @ H @ Q
        m, Q = Phi @ m + held * u, Phi @ Q @ Phi.T + Wd
        yield np.concatenate([m, Q.ravel()])
