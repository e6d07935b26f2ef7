"""The quadruple-tank process of Johansson, "The quadruple-tank process: a multivariable laboratory process with an adjustable zero", IEEE
Transactions on Control Systems Technology 8 (3), 2000: the two lower levels are measured; unknown is how the first valve divides its flow.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from observers.model import Model, Variable

GRAVITY = 981.0  # [cm/s2]
LARGE, SMALL = 32.0, 28.0  # cross-sections of the tanks [cm2]: 1 and 3 are small
PUMPS = (3.33, 3.35)  # [cm3/(V s)]
SECOND_VALVE = 0.6  # part of the second pump's flow that goes to the lower tank


def _rates(x: Any, u: Any, p: Any, t: Any) -> list[Any]:
    out = [a * ca.sqrt(2 * GRAVITY * h) for a, h in ((p.a1, x.h1), (0.057, x.h2), (0.071, x.h3), (0.057, x.h4))]
    first, second = PUMPS[0] * u.v1, PUMPS[1] * u.v2
    return [
        (-out[0] + out[2] + p.valve * first) / SMALL,
        (-out[1] + out[3] + SECOND_VALVE * second) / LARGE,
        (-out[2] + (1 - SECOND_VALVE) * second) / SMALL,
        (-out[3] + (1 - p.valve) * first) / LARGE,
    ]


QUADRUPLE_TANK = Model(
    name="quadruple_tank",
    description="Quadruple tank (Johansson 2000), first valve unknown",
    states=[
        Variable(f"h{i}", f"level of tank {i}", "cm", start=start, nominal=5.0, min=0.0)
        for i, start in enumerate((12.0, 13.0, 5.0, 5.0), start=1)
    ],
    inputs=[Variable("v1", "voltage of pump 1", "V", start=3.0), Variable("v2", "voltage of pump 2", "V", start=3.0)],
    parameters=[Variable("a1", "outlet of tank 1", "cm2", start=0.071, nominal=0.07, min=0.0)],
    unknown_parameters=[
        Variable("valve", "part of the first pump's flow to the lower tank", start=0.7, nominal=0.5, min=0.0, max=1.0)
    ],
    outputs=[
        Variable("y1", "measured level of tank 1", "cm", nominal=1.0),
        Variable("y2", "measured level of tank 2", "cm", nominal=1.0),
    ],
    ode=_rates,
    output=lambda x, u, p, t: [x.h1, x.h2],
)
