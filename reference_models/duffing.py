"""The chaotic Duffing system of Gong, Ross & Kang 2007, (34), with a control input: Examples 1 to 5."""

from dataclasses import replace

import casadi as ca

from observers.model import Model, Variable

DUFFING = Model(
    name="duffing",
    description="Forced Duffing oscillator with unknown forcing amplitude (Gong, Ross & Kang 2007, (34))",
    states=[
        Variable("x1", "displacement", unit="m", start=2.0),
        Variable("x2", "velocity", unit="m/s", start=1.0),
    ],
    inputs=[Variable("u", "control acceleration", unit="m/s2")],
    parameters=[Variable("damping", "damping coefficient", unit="1/s", start=0.25, min=0.0, max=100.0)],
    unknown_parameters=[Variable("theta", "forcing amplitude", unit="m/s2", start=0.4)],
    outputs=[Variable("y", "displacement plus half the velocity times one second", unit="m")],
    ode=lambda x, u, p, t: [x.x2, -p.damping * x.x2 + x.x1 * (1 - x.x1**2) + p.theta * ca.cos(t) + u.u],
    output=lambda x, u, p, t: [x.x1 + 0.5 * x.x2],
)

# (35): the same with theta known, a parameter.
DUFFING_KNOWN = replace(
    DUFFING,
    name="duffing_known",
    description="Forced Duffing oscillator (Gong, Ross & Kang 2007, (35))",
    parameters=[*DUFFING.parameters, *DUFFING.unknown_parameters],
    unknown_parameters=[],
)
