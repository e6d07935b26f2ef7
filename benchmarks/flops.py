"""The floor: floating-point operations that a pseudospectral sample of the Duffing observer cannot do without."""

from __future__ import annotations


def ideal_flops(N: int, L: int, iterations: float) -> float:
    """Additions and multiplications of one sample with `iterations` Gauss-Newton steps.

    n = N rates (one equation is nonlinear, in one state), two first states and theta to find, m = L + 1 samples of one
    output. Counted are the dense products and the elimination, not the cosines and the model's own polynomials.
    """
    n, m, states, columns = N, L + 1, 2, 4  # columns: the residual, two first states, theta
    trajectory = 2 * n * (n + states)  # the state at the nodes from the first state and the rates
    residual = 2 * m * (n + states)  # the output at the samples likewise
    step = (
        trajectory
        + n**2  # rows of a constant matrix scaled by the slope of the nonlinearity
        + 2 * n**3 / 3  # its LU factors
        + 2 * n**2 * columns  # forward and back substitution
        + residual
        + 2 * m * n * columns  # sensitivities of the output at the samples
        + m * columns * (columns + 1)  # the symmetric normal matrix
        + 2 * n * columns  # the new rates
    )
    warm_start, last_state = trajectory, 2 * states * (n + states)
    return iterations * step + warm_start + residual + last_state
