"""A stirred tank reactor that ignites and goes out: Henson & Seborg, "Nonlinear Process Control", 1997, chapter 1, with minutes as seconds.
The temperature is measured; unknown is how well the jacket cools.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from observers.model import Model, Variable


def _rates(x: Any, u: Any, p: Any, t: Any) -> list[Any]:
    reaction = p.k0 * ca.exp(-8750.0 / x.T) * x.c
    return [
        (1.0 - x.c) / 60 - reaction,
        (350.0 - x.T) / 60 + 209.205 * reaction + p.cooling * (u.Tj - x.T),
    ]


IGNITING_REACTOR = Model(
    name="igniting_reactor",
    description="Exothermic reactor (Henson & Seborg 1997), cooling unknown",
    states=[
        Variable("c", "concentration of A", "mol/l", start=0.6, min=0.0, max=1.0),
        Variable("T", "reactor temperature", "K", start=345.0, nominal=10.0),
    ],
    inputs=[Variable("Tj", "jacket temperature", "K", start=300.0, nominal=10.0)],
    parameters=[Variable("k0", "frequency factor", "1/s", start=1.2e9, nominal=1e9, min=0.0)],
    unknown_parameters=[
        Variable("cooling", "UA/(V rho cp)", "1/s", start=0.0349, nominal=0.03, min=0.0, max=0.2),
    ],
    outputs=[Variable("y", "measured temperature", "K", nominal=0.2)],
    ode=_rates,
    output=lambda x, u, p, t: [x.T],
)
