"""A chemostat with Monod's rate (Monod 1949; Bastin & Dochain, "On-line estimation and adaptive control of bioreactors", 1990, chapter
1): the biomass is measured, the largest growth rate is unknown. Time in seconds, the numbers of the literature per hour.
"""

from __future__ import annotations

from typing import Any

from observers.model import Model, Variable

HOUR = 3600.0  # [s]
YIELD = 0.5  # biomass per substrate


def _rates(x: Any, u: Any, p: Any, t: Any) -> list[Any]:
    growth = p.mu * x.S / (p.half + x.S) * x.X
    return [growth - u.dilution * x.X, u.dilution * (10.0 - x.S) - growth / YIELD]


CHEMOSTAT = Model(
    name="chemostat",
    description="Chemostat with Monod's rate, largest growth rate unknown",
    states=[
        Variable("X", "biomass", "g/l", start=3.0, nominal=2.0, min=0.0),
        Variable("S", "substrate", "g/l", start=2.0, nominal=2.0, min=0.0),
    ],
    inputs=[Variable("dilution", "feed over volume", "1/s", start=0.2 / HOUR, nominal=0.2 / HOUR)],
    parameters=[Variable("half", "substrate at half the largest rate", "g/l", start=0.5, min=0.0)],
    unknown_parameters=[
        Variable(
            "mu", "largest growth rate", "1/s", start=0.4 / HOUR, nominal=0.3 / HOUR, min=0.01 / HOUR, max=2 / HOUR
        )
    ],
    outputs=[Variable("y", "measured biomass", "g/l", start=3.0, nominal=0.1)],
    ode=_rates,
    output=lambda x, u, p, t: [x.X],
)
