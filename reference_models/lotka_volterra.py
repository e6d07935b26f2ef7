"""Prey and predators of Lotka (1925) and Volterra (1926), both counted, all four rates unknown."""

from __future__ import annotations

from observers.model import Model, Variable

LOTKA_VOLTERRA = Model(
    name="lotka_volterra",
    description="Prey and predators (Lotka 1925, Volterra 1926), four unknown rates",
    states=[Variable("prey", start=1.5, min=0.0), Variable("predators", start=0.8, min=0.0)],
    unknown_parameters=[
        Variable(name, text, "1/s", start=start, min=0.05, max=5.0)
        for name, text, start in (
            ("birth", "growth of the prey", 1.1),
            ("loss", "prey that a predator takes", 0.9),
            ("death", "decay of the predators", 1.2),
            ("gain", "growth of the predators by prey", 0.8),
        )
    ],
    outputs=[Variable("y1", "counted prey", nominal=0.1), Variable("y2", "counted predators", nominal=0.1)],
    ode=lambda x, u, p, t: [
        p.birth * x.prey - p.loss * x.prey * x.predators,
        -p.death * x.predators + p.gain * x.prey * x.predators,
    ],
    output=lambda x, u, p, t: [x.prey, x.predators],
)
