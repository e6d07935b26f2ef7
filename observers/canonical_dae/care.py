"""The stabilising solution of a continuous algebraic Riccati equation, unrolled for generated C.

Own code, not scipy's `solve_continuous_are`: the equation's coefficients depend on the estimate, so it is solved at run time.
"""

from __future__ import annotations

import casadi as ca

from observers.numerics.linear import inverse

DOUBLINGS = 12  # |(gamma - s) / (gamma + s)|^(2^12) < 1e-16 for every closed-loop eigenvalue -s with s > gamma / 220


def care(A: ca.SX, G: ca.SX, H: ca.SX, gamma: ca.SX) -> ca.SX:
    """P of A P + P A' - P G P + H = 0 (all n x n, G and H symmetric positive semidefinite) by structure-preserving doubling.

    Chu, Fan & Lin, "A structure-preserving doubling algorithm for continuous-time algebraic Riccati equations", Linear Algebra and
    its Applications 396, 2005, section 3. The Cayley transform's `gamma` (> ||A||, for its elimination goes without pivoting) maps the
    closed loop's eigenvalues into the unit disc; each of the DOUBLINGS squares them.
    """
    identity = ca.SX.eye(A.shape[0])
    shifted = inverse(A.T - gamma * identity)  # the paper's A is our A'
    K = inverse(A - gamma * identity + ca.mtimes(H, ca.mtimes(shifted, G)))
    E = identity + 2 * gamma * K.T
    G_k = 2 * gamma * ca.mtimes(shifted, ca.mtimes(G, K))
    P = 2 * gamma * ca.mtimes(K, ca.mtimes(H, shifted))
    for _ in range(DOUBLINGS):
        Z = inverse(identity + ca.mtimes(G_k, P))
        EZ = ca.mtimes(E, Z)
        P_next = P + ca.mtimes(E.T, ca.mtimes(P, ca.mtimes(Z, E)))
        G_k = G_k + ca.mtimes(EZ, ca.mtimes(G_k, E.T))
        E = ca.mtimes(EZ, E)
        P, G_k = (P_next + P_next.T) / 2, (G_k + G_k.T) / 2
    return P
