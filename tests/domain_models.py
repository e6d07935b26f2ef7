"""Plants whose equations end somewhere: roots, logarithms and powers of what an iterate may make negative, exponentials that overflow."""

from __future__ import annotations

import casadi as ca

from observers.model import Model, Variable

TANK = Model(
    name="tank",
    description="a tank that empties through an orifice, with an unknown leak",
    states=[Variable("h", unit="m", start=0.3), Variable("d", start=0.0)],
    inputs=[Variable("q", start=0.27)],
    outputs=[Variable("y", unit="m", start=0.3)],
    ode=lambda x, u, p, t: [u.q - 0.5 * ca.sqrt(x.h) + x.d, -0.1 * x.d],
    output=lambda x, u, p, t: [x.h],
)
TWO_TANKS = Model(
    name="two_tanks",
    description="two tanks in a row, the second one measured",
    states=[Variable("h1", unit="m", start=0.5, min=0.0), Variable("h2", unit="m", start=0.3, min=0.0)],
    inputs=[Variable("q", start=0.3)],
    unknown_parameters=[Variable("a", start=0.5, min=0.0, max=2.0)],
    outputs=[Variable("y", unit="m", start=0.3)],
    ode=lambda x, u, p, t: [u.q - p.a * ca.sqrt(x.h1), p.a * ca.sqrt(x.h1) - 0.6 * ca.sqrt(x.h2)],
    output=lambda x, u, p, t: [x.h2],
)
LOG_SENSOR = Model(
    name="log_sensor",
    description="a concentration that decays, seen by a logarithmic sensor",
    states=[Variable("c", start=0.8)],
    unknown_parameters=[Variable("rate", start=0.3, min=0.0)],
    inputs=[Variable("feed", start=0.2)],
    outputs=[Variable("y")],
    ode=lambda x, u, p, t: [u.feed - p.rate * x.c],
    output=lambda x, u, p, t: [ca.log(x.c)],
)
REACTOR = Model(
    name="reactor",
    description="a stirred tank reactor that ignites (Henson & Seborg 1997)",
    states=[
        Variable("c", "concentration", unit="mol/l", start=0.5, min=0.0, max=1.0),
        Variable("T", "temperature", unit="K", start=350.0, nominal=10.0),
    ],
    inputs=[Variable("Tc", "jacket temperature", unit="K", start=300.0)],
    unknown_parameters=[Variable("ua", unit="1/s", start=0.0349, min=0.0, max=0.2, nominal=0.03)],
    outputs=[Variable("Tm", "measured temperature", unit="K", nominal=0.2, start=350.0)],
    ode=lambda x, u, p, t: [
        (1 - x.c) / 60 - 1.2e9 * ca.exp(-8750.0 / x.T) * x.c,
        (350 - x.T) / 60 + 209.205 * 1.2e9 * ca.exp(-8750.0 / x.T) * x.c + p.ua * (u.Tc - x.T),
    ],
    output=lambda x, u, p, t: [x.T],
)
DIODE = Model(
    name="diode",
    description="a capacitor that discharges through a diode",
    states=[Variable("v", unit="V", start=0.5), Variable("i", unit="A", start=0.0)],
    inputs=[Variable("source", unit="V", start=0.6)],
    outputs=[Variable("y", unit="V", start=0.5)],
    ode=lambda x, u, p, t: [x.i - 1e-10 * (ca.exp(x.v / 0.026) - 1), 5 * (u.source - x.v - 0.5 * x.i)],
    output=lambda x, u, p, t: [x.v],
)
POWER = Model(
    name="power",
    description="evaporation with the power 1.5 of a level, its output the inverse of the other state",
    states=[Variable("a", start=1.0), Variable("b", start=2.0)],
    outputs=[Variable("y1", start=1.0), Variable("y2", start=0.5)],
    ode=lambda x, u, p, t: [0.5 - 0.5 * x.a**1.5, x.a - 0.5 * x.b],
    output=lambda x, u, p, t: [x.a, 1 / x.b],
)
SAMPLE_TIMES = {"reactor": 5.0}  # [s]; 0.1 s for the others
MODELS = {model.name: model for model in (TANK, TWO_TANKS, LOG_SENSOR, REACTOR, DIODE, POWER)}
