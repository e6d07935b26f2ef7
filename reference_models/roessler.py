"""Rössler's chaotic system ("An equation for continuous chaos", Phys. Lett. A 57 (5), 1976), its second state measured."""

from observers.model import Model, Variable

ROESSLER = Model(
    name="roessler",
    description="Rössler's chaotic system (Phys. Lett. A 57, 1976), second state measured",
    states=[
        Variable("x1", "first state", start=2.0, nominal=5.0),
        Variable("x2", "second state", start=-3.0, nominal=5.0),
        Variable("x3", "third state", start=1.0),
    ],
    parameters=[
        Variable("a", "self-excitation of x2", start=0.2),
        Variable("b", "constant rate of x3", start=0.2),
        Variable("c", "decay of x3", start=5.7),
    ],
    outputs=[Variable("y", "measured second state", nominal=5.0)],
    ode=lambda x, u, p, t: [-x.x2 - x.x3, x.x1 + p.a * x.x2, p.b + x.x3 * (x.x1 - p.c)],
    output=lambda x, u, p, t: [x.x2],
)
