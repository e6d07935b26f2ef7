"""References in multiple precision (Arb): the Riccati flow by its Hamiltonian's exponential, the algebraic equation by Newton."""

import math

import numpy as np
from flint import arb, arb_mat, ctx

EPS = float(np.finfo(float).eps)


def relative(found, expected):
    """Largest error over the largest entry."""
    return float(np.abs(found - expected).max() / np.abs(expected).max())


def exponential(A, h):
    """exp(A h), rounded to doubles once."""
    with ctx.workprec(_bits(h * np.abs(np.linalg.eigvals(A).real).max())):
        return _doubles((_matrix(A) * arb(h)).exp())


def riccati_flow(Q, A, W, S, h):
    """Q(h) of Q' = A Q + Q A' - Q S Q + W: (E12 + E11 Q)(E22 + E21 Q)^-1 with E = exp(h [[A, W], [S, -A']]), rounded to doubles once.

    In doubles this form loses everything to cancellation; here the precision grows with h |M|.
    """
    n, M = len(A), np.block([[A, W], [S, -A.T]])
    with ctx.workprec(_bits(h * np.abs(np.linalg.eigvals(M).real).max())):
        E = (_matrix(M) * arb(h)).exp().tolist()
        E11, E12, E21, E22 = (
            arb_mat([row[j : j + n] for row in E[i : i + n]]) for i, j in ((0, 0), (0, n), (n, 0), (n, n))
        )
        start = _matrix(Q)
        above, below = E12 + E11 * start, E22 + E21 * start
        return _doubles(below.transpose().solve(above.transpose()))


def algebraic_riccati(A, W, S, first):
    """Q of A Q + Q A' - Q S Q + W = 0 by Newton's method (Kleinman) from `first`, in 256 bits, rounded to doubles once."""
    n = len(A)
    pairs = [(i, j) for j in range(n) for i in range(j + 1)]
    place = {pair: k for k, pair in enumerate(pairs)} | {(j, i): k for k, (i, j) in enumerate(pairs)}
    with ctx.workprec(256):
        A_, W_, S_, Q = map(_matrix, (A, W, S, (first + first.T) / 2))
        for _ in range(30):
            closed, constant = (A_ - Q * S_).tolist(), (Q * S_ * Q + W_).tolist()
            rows = [[arb(0)] * len(pairs) for _ in pairs]
            for k, (i, j) in enumerate(pairs):
                for m in range(n):
                    rows[k][place[m, j]] += closed[i][m]
                    rows[k][place[i, m]] += closed[j][m]
            values = arb_mat(rows).solve(arb_mat([[-constant[i][j]] for i, j in pairs])).entries()
            before, Q = Q, arb_mat([[values[place[i, j]].mid() for j in range(n)] for i in range(n)])
            change = max(float(abs(x).mid()) for x in (Q - before).entries())
            if change < 1e-25 * max(float(abs(x).mid()) for x in Q.entries()):
                return np.array([float(x.mid()) for x in Q.entries()]).reshape(n, n)
    raise ValueError(f"Newton's method still moves by {change:.1e} after 30 iterations")


def condition(reference, Q, A, W, S):
    """How much `reference(Q, A, W, S)` moves, relative to a random relative change of its arguments' entries."""
    rng, exact, step = np.random.default_rng(0), reference(Q, A, W, S), 1e-13

    def moved(M, symmetric=True):
        factor = 1 + step * rng.choice([-1, 1], size=M.shape)
        return M * (np.triu(factor) + np.triu(factor, 1).T if symmetric else factor)

    tries = [reference(moved(Q), moved(A, False), moved(W), moved(S)) for _ in range(2)]
    return max(relative(found, exact) for found in tries) / step


def _bits(exponent):
    return int(256 + 4 * exponent / math.log(2))


def _matrix(array):
    return arb_mat(*array.shape, [arb(float(x)) for x in array.ravel()])


def _doubles(m):
    assert max(float(x.rad()) for x in m.entries()) < 1e-25 * max(abs(float(x.mid())) for x in m.entries())
    return np.array([float(x.mid()) for x in m.entries()]).reshape(m.nrows(), m.ncols())
