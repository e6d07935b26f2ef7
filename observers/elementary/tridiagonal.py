"""Symmetric positive definite tridiagonal systems, unrolled into scalar CasADi expressions."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca


def solve(diagonal: Sequence[ca.SX], beside: Sequence[ca.SX], right: Sequence[ca.SX]) -> list[ca.SX]:
    """M^-1 b of the matrix with `diagonal` (n entries) and, above and below it, `beside` (n - 1); O(n), no pivoting (none is needed)."""
    inverses, forward = [1 / diagonal[0]], [right[0]]
    for d, e, b in zip(diagonal[1:], beside, right[1:], strict=True):
        ratio = e * inverses[-1]
        inverses.append(1 / (d - ratio * e))
        forward.append(b - ratio * forward[-1])
    solution = [forward[-1] * inverses[-1]]
    for e, v, b in zip(reversed(beside), reversed(inverses[:-1]), reversed(forward[:-1]), strict=True):
        solution.append((b - e * solution[-1]) * v)
    return solution[::-1]
