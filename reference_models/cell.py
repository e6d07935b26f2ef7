"""A lithium-ion cell: Chen & Rincon-Mora, "Accurate electrical battery model capable of predicting runtime and I-V performance", IEEE
Transactions on Energy Conversion 21 (2), 2006, with one RC branch. Current in, voltage out; unknown is the series resistance.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from observers.model import Model, Variable


def open_circuit_voltage(soc: Any) -> Any:
    """[V], their equation (2)."""
    return -1.031 * ca.exp(-35 * soc) + 3.685 + 0.2156 * soc - 0.1178 * soc**2 + 0.3201 * soc**3


CELL = Model(
    name="cell",
    description="Lithium-ion cell (Chen & Rincon-Mora 2006), series resistance unknown",
    states=[
        Variable("soc", "state of charge", start=0.9, nominal=0.5, min=0.0, max=1.0),
        Variable("v1", "voltage of the RC branch", "V", nominal=0.05),
    ],
    inputs=[Variable("i", "current, positive discharges", "A")],
    parameters=[
        Variable("capacity", "charge", "C", start=10440.0, nominal=1e4, min=1.0),
        Variable("R1", "resistance of the RC branch", "Ohm", start=0.02, nominal=0.02, min=1e-6),
        Variable("C1", "capacitance of the RC branch", "F", start=2000.0, nominal=2000.0, min=1e-3),
    ],
    unknown_parameters=[Variable("R0", "series resistance", "Ohm", start=0.03, nominal=0.03, min=0.0, max=0.2)],
    outputs=[Variable("v", "terminal voltage", "V", nominal=0.002)],
    ode=lambda x, u, p, t: [-u.i / p.capacity, -x.v1 / (p.R1 * p.C1) + u.i / p.C1],
    output=lambda x, u, p, t: [open_circuit_voltage(x.soc) - x.v1 - p.R0 * u.i],
)
