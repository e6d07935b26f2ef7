"""A stirred tank reactor that ignites and goes out: only its temperature is measured, and how well its jacket cools is unknown.

Henson & Seborg, "Nonlinear Process Control", Prentice Hall 1997, chapter 1, after Uppal, Ray & Poore, "On the dynamic behavior of
continuous stirred tank reactors", Chemical Engineering Science 29, 1974. Their minutes are seconds here.
"""

import casadi as ca

from observers.controller import controller
from observers.model import Model, Variable
from observers.riccati import riccati
from reference_models.plant import plant

SAMPLE_TIME = 5.0  # [s]
STOP_TIME = 3000.0  # [s]


def rates(x, u, p, t):
    reaction = p.k0 * ca.exp(-8750.0 / x.T) * x.c  # [mol/(l s)]
    return [
        (1.0 - x.c) / 60 - reaction,
        (350.0 - x.T) / 60 + 209.205 * reaction + p.cooling * (u.Tj - x.T),
    ]


MODEL = Model(
    name="stirred_tank",
    description="Exothermic stirred tank reactor, cooling unknown",
    states=[
        # With bounds no iterate leaves what the equations are made for. The nominal values say what a change of each is worth.
        Variable("c", "concentration of the feed", unit="mol/l", start=0.6, min=0.0, max=1.0),
        Variable("T", "temperature", unit="K", start=345.0, nominal=10.0),
    ],
    inputs=[Variable("Tj", "temperature of the jacket", unit="K", start=300.0, nominal=10.0)],
    parameters=[Variable("k0", "frequency factor of the reaction", unit="1/s", start=1.2e9, nominal=1e9, min=0.0)],
    unknown_parameters=[
        Variable("cooling", "UA/(V rho cp)", unit="1/s", start=0.0349, nominal=0.03, min=0.0, max=0.2),
    ],
    outputs=[Variable("y", "measured temperature", unit="K", start=345.0)],
    ode=rates,
    output=lambda x, u, p, t: [x.T],
)

# The jacket swings by 4 K, and is 3 K warmer from 1500 s on: the tank ignites and goes out with each swing.
jacket = controller(
    "stirred_tank_jacket",
    inputs=[],
    outputs=[Variable("Tj", "temperature of the jacket", unit="K", start=300.0)],
    law=lambda x, p, t: [300.0 + 4.0 * ca.sin(2 * ca.pi * t / 500) + ca.if_else(t > 1500, 3.0, 0.0)],
    stop_time=STOP_TIME,
    step_size=SAMPLE_TIME,
)
true_system = plant(MODEL, stop_time=STOP_TIME, step_size=SAMPLE_TIME)
observer = riccati(
    MODEL,
    sample_time=SAMPLE_TIME,
    process_noise={"c": 1e-4, "T": 1e-2, "cooling": 2e-5},
    measurement_noise={"y": 0.2},
    initial_std={"c": 0.2, "T": 1.0, "cooling": 0.02},
    guess={"c": 0.5, "cooling": 0.02},  # truth 0.6 and 0.0349
    stop_time=STOP_TIME,
)
