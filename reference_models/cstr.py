"""The van de Vusse reactor of Klatt & Engell, "Gain-scheduling trajectory control of a continuous stirred tank reactor", Computers &
Chemical Engineering 22 (4-5), 1998: A -> B -> C, 2 A -> D in a jacketed tank, two temperatures measured. Time in seconds, the paper's in
hours. Unknown is the catalyst's activity, a factor of the first reaction.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from observers.model import Model, Variable

HOUR = 3600.0  # [s]
KELVIN = 273.15
FEED, FEED_TEMPERATURE = 5.1, 130.0  # concentration of A [mol/l], [degC]
HEAT = (4.2, -11.0, -41.85)  # reaction enthalpies of A -> B, B -> C, 2 A -> D [kJ/mol]
DENSITY, CAPACITY, VOLUME = 0.9342, 3.01, 10.0  # [kg/l], [kJ/(kg K)], [l]
JACKET_MASS, JACKET_CAPACITY, AREA = 5.0, 2.0, 0.215  # [kg], [kJ/(kg K)], [m2]


def _rates(x: Any, u: Any, p: Any, t: Any) -> list[Any]:
    k12 = 1.287e12 / HOUR * ca.exp(-9758.3 / (x.T + KELVIN))  # of both first-order reactions
    k3 = 9.043e9 / HOUR * ca.exp(-8560.0 / (x.T + KELVIN))
    first, second, third = p.activity * k12 * x.cA, k12 * x.cB, k3 * x.cA**2
    reaction_heat = HEAT[0] * first + HEAT[1] * second + HEAT[2] * third
    transfer = p.transfer * AREA * (x.T - x.Tj)
    return [
        u.dilution * (FEED - x.cA) - first - third,
        -u.dilution * x.cB + first - second,
        u.dilution * (FEED_TEMPERATURE - x.T)
        - reaction_heat / (DENSITY * CAPACITY)
        - transfer / (DENSITY * CAPACITY * VOLUME),
        (u.heating + transfer) / (JACKET_MASS * JACKET_CAPACITY),
    ]


CSTR = Model(
    name="cstr",
    description="Van de Vusse reactor with jacket (Klatt & Engell 1998), activity unknown",
    states=[
        Variable("cA", "concentration of A", "mol/l", start=1.0, min=0.0),
        Variable("cB", "concentration of B", "mol/l", start=1.0, min=0.0),
        Variable("T", "reactor temperature", "degC", start=134.0, nominal=10.0),
        Variable("Tj", "jacket temperature", "degC", start=130.0, nominal=10.0),
    ],
    inputs=[
        Variable("dilution", "feed over volume", "1/s", start=20.0 / HOUR, nominal=20.0 / HOUR),
        Variable("heating", "heat flow into the jacket", "kJ/s", start=-4000.0 / HOUR),
    ],
    parameters=[Variable("transfer", "heat transfer coefficient of the wall", "kJ/(s.m2.K)", start=4032.0 / HOUR)],
    unknown_parameters=[Variable("activity", "of the first reaction's catalyst", start=1.0, min=0.3, max=3.0)],
    outputs=[
        Variable("yT", "measured reactor temperature", "degC", nominal=1.0),
        Variable("yTj", "measured jacket temperature", "degC", nominal=1.0),
    ],
    ode=_rates,
    output=lambda x, u, p, t: [x.T, x.Tj],
)
