"""The linear time-varying example of Chen & Yen 1999, with the matrices as printed."""

import casadi as ca

from observers.model import Model, Variable


def _ode(x, u, p, t):  # type: ignore[no-untyped-def]
    mixed = 1.5 * ca.sin(t) * ca.cos(t)
    return [
        (-1 + 1.5 * ca.cos(t) ** 2) * x.x1 + (1 - mixed) * x.x2,
        (-1 + mixed) * x.x1 + (-1 + 1.5 * ca.sin(t) ** 2) * x.x2,
    ]


CHEN_YEN = Model(
    name="chen_yen",
    description="Unstable linear time-varying system (Chen & Yen 1999, example)",
    states=[Variable("x1", "first state", start=5.0), Variable("x2", "second state", start=-5.0)],
    outputs=[Variable("y", "measured combination of the states")],
    ode=_ode,
    output=lambda x, u, p, t: [
        (ca.cos(ca.sqrt(t)) + ca.sin(ca.sqrt(t))) * x.x1 + 3 * ca.cos(ca.sqrt(t)) ** 2 * x.x2
    ],
)
