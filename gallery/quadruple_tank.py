"""Four tanks, two pumps: the levels of the upper tanks from those of the lower ones; how the first valve divides its flow is unknown.

Johansson, "The quadruple-tank process: a multivariable laboratory process with an adjustable zero", IEEE Transactions on Control Systems
Technology 8 (3), 2000; the paper's numbers for its minimum-phase setting.
"""

import casadi as ca

from observers.controller import controller
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral
from reference_models.plant import plant

SAMPLE_TIME = 2.0  # [s]
STOP_TIME = 600.0  # [s]
GRAVITY = 981.0  # [cm/s2]


def rates(x, u, p, t):
    out = [a * ca.sqrt(2 * GRAVITY * h) for a, h in ((p.a1, x.h1), (p.a2, x.h2), (p.a1, x.h3), (p.a2, x.h4))]
    first, second = 3.33 * u.v1, 3.35 * u.v2  # flows of the pumps [cm3/s]
    return [
        (-out[0] + out[2] + p.valve1 * first) / 28,
        (-out[1] + out[3] + p.valve2 * second) / 32,
        (-out[2] + (1 - p.valve2) * second) / 28,
        (-out[3] + (1 - p.valve1) * first) / 32,
    ]


MODEL = Model(
    name="quadruple_tank",
    description="Quadruple tank, first valve unknown",
    states=[
        # min = 0 keeps every iterate where the roots have a value.
        Variable("h1", "level of the lower tank 1", unit="cm", start=12.4, nominal=5.0, min=0.0),
        Variable("h2", "level of the lower tank 2", unit="cm", start=12.7, nominal=5.0, min=0.0),
        Variable("h3", "level of the upper tank 3", unit="cm", start=1.8, nominal=2.0, min=0.0),
        Variable("h4", "level of the upper tank 4", unit="cm", start=1.4, nominal=2.0, min=0.0),
    ],
    inputs=[
        Variable("v1", "voltage of pump 1", unit="V", start=3.0),
        Variable("v2", "voltage of pump 2", unit="V", start=3.0),
    ],
    parameters=[
        Variable("a1", "outlets of tanks 1 and 3", unit="cm2", start=0.071, nominal=0.07, min=0.0),
        Variable("a2", "outlets of tanks 2 and 4", unit="cm2", start=0.057, nominal=0.06, min=0.0),
        Variable("valve2", "part of pump 2's flow that goes to tank 2", start=0.6, min=0.0, max=1.0),
    ],
    unknown_parameters=[
        Variable("valve1", "part of pump 1's flow that goes to tank 1", start=0.7, nominal=0.5, min=0.0, max=1.0)
    ],
    outputs=[
        Variable("y1", "measured level of tank 1", unit="cm", start=12.4),
        Variable("y2", "measured level of tank 2", unit="cm", start=12.7),
    ],
    ode=rates,
    output=lambda x, u, p, t: [x.h1, x.h2],
)

pumps = controller(
    "quadruple_tank_pumps",
    inputs=[],
    outputs=[
        Variable("v1", "voltage of pump 1", unit="V", start=3.0),
        Variable("v2", "voltage of pump 2", unit="V", start=3.0),
    ],
    law=lambda x, p, t: [
        3.0 + ca.if_else(ca.fmod(t, 200) > 100, 0.5, 0.0),
        3.0 - ca.if_else(ca.fmod(t, 300) > 150, 0.5, 0.0),
    ],
    stop_time=STOP_TIME,
    step_size=SAMPLE_TIME,
)
true_system = plant(MODEL, stop_time=STOP_TIME, step_size=SAMPLE_TIME)
observer = pseudospectral(
    MODEL,
    sample_time=SAMPLE_TIME,
    arrival_cost=True,  # what the samples before the window said is kept: so the window may be short
    L=5,
    segments=5,
    N=4,
    process_noise={"h1": 5e-3, "h2": 5e-3, "h3": 5e-3, "h4": 5e-3, "valve1": 1e-3},
    measurement_noise={"y1": 0.1, "y2": 0.1},
    initial_std={"h1": 2.0, "h2": 2.0, "h3": 1.5, "h4": 1.5, "valve1": 0.2},
    guess={"h1": 11.0, "h2": 11.0, "h3": 3.0, "h4": 3.0, "valve1": 0.5},  # truth 12.4, 12.7, 1.8, 1.4 and 0.7
    stop_time=STOP_TIME,
)
