"""The linear time-varying example of Chen & Yen 1999, with the matrices as printed.

A21 = -1 + 1.5 sin t cos t is not the textbook's (which has a minus sign there); the paper's figures belong to the printed one.
"""

import casadi as ca

from observers.model import Model, Variable

CHEN_YEN = Model(
    name="chen_yen",
    description="Unstable linear time-varying system (Chen & Yen 1999, example)",
    states=[Variable("x1", "first state", start=5.0), Variable("x2", "second state", start=-5.0)],
    outputs=[Variable("y", "measured combination of the states")],
    ode=lambda x, u, p, t: [
        (-1 + 1.5 * ca.cos(t) ** 2) * x.x1 + (1 - 1.5 * ca.sin(t) * ca.cos(t)) * x.x2,
        (-1 + 1.5 * ca.sin(t) * ca.cos(t)) * x.x1 + (-1 + 1.5 * ca.sin(t) ** 2) * x.x2,
    ],
    output=lambda x, u, p, t: [(ca.cos(ca.sqrt(t)) + ca.sin(ca.sqrt(t))) * x.x1 + 3 * ca.cos(ca.sqrt(t)) ** 2 * x.x2],
)
