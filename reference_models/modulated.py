"""Example 2.1 of Nikoukhah 1995, (2.12): x1 reaches the output only as far as the input lets it through."""

from typing import Any

import casadi as ca

from observers.model import Model, Names, Variable

ALPHA, GAMMA_2 = 1.0, 2.0  # of (2.20), (2.22), chosen here: the report leaves them open

MODULATED = Model(
    name="modulated",
    description="A state that the input modulates into the measurement (Nikoukhah 1995, (2.12))",
    states=[Variable("x1", "hidden state", start=1.0), Variable("x2", "measured state", start=0.5)],
    inputs=[Variable("u", "modulation", start=1.0)],
    outputs=[Variable("y", "measured state")],
    ode=lambda x, u, p, t: [ca.sin(x.x2), -x.x2 + x.x1 * u.u],
    output=lambda x, u, p, t: [x.x2],
)


def lyapunov_gain(x: Names, u: Names, p: Names, t: ca.SX) -> list[list[Any]]:
    """Gamma of (2.22): V = x1~^2 + alpha lambda^2 falls along the error's trajectories."""
    return [[ALPHA * u.u], [GAMMA_2]]
