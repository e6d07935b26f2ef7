"""Chua's circuit with a cubic resistor: a system of Example 2.2 of Nikoukhah 1995, (2.23)-(2.25), bent by its output alone.

Huang, Pivka, Wu & Franz, "Chua's equation with cubic nonlinearity", Int. J. Bifurcation and Chaos 6 (12A), 1996; dimensionless.
"""

from observers.model import Model, Variable

CHUA = Model(
    name="chua",
    description="Chua's chaotic circuit with a cubic resistor, first voltage measured (Nikoukhah 1995, Example 2.2)",
    states=[
        Variable("x1", "voltage of the first capacitor", start=0.1),
        Variable("x2", "voltage of the second capacitor"),
        Variable("x3", "current of the coil"),
    ],
    parameters=[
        Variable("alpha", "ratio of the capacitances", start=10.0),
        Variable("beta", "inverse inductance", start=16.0),
        Variable("a", "cubic conductance of the resistor", start=1.0),
        Variable("c", "linear conductance of the resistor", start=-0.143),
    ],
    outputs=[Variable("y", "measured voltage of the first capacitor")],
    ode=lambda x, u, p, t: [p.alpha * (x.x2 - p.c * x.x1 - p.a * x.x1**3), x.x1 - x.x2 + x.x3, -p.beta * x.x2],
    output=lambda x, u, p, t: [x.x1],
)
