"""The three-phase current motor of Nikoukhah 1995, (5.1), after Birk & Zeitz 1988: rotor angle, its rate, field voltage."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import casadi as ca

from observers.model import Model, Variable

_STATES = (
    Variable("x1", "rotor angle", unit="rad", start=0.8),
    Variable("x2", "rotor speed", unit="rad/s", start=0.1),
    Variable("x3", "field", start=10.0, nominal=10.0),
)
_INPUTS = (Variable("u", "field excitation", unit="1/s", start=2.0, min=0.0, max=4.0),)
_PARAMETERS = (
    Variable("A1", "damping", unit="1/s", start=0.2703),
    Variable("A2", "torque per field and sine", unit="1/s2", start=12.01),
    Variable("B1", "driving torque", unit="1/s2", start=39.19),
    Variable("B2", "reluctance torque", unit="1/s2", start=-48.04),
    Variable("D1", "decay of the field", unit="1/s", start=0.3222),
    Variable("D2", "armature reaction", unit="1/s", start=1.9),
)
_OUTPUTS = (Variable("y1", "measured angle", unit="rad"), Variable("y2", "measured speed", unit="rad/s"))


def _rates(x: Any, u: Any, p: Any, t: Any) -> list[Any]:
    return [
        x.x2,
        p.B1 - p.A1 * x.x2 - p.A2 * x.x3 * ca.sin(x.x1) - 0.5 * p.B2 * ca.sin(2 * x.x1),
        u.u - p.D1 * x.x3 + p.D2 * ca.cos(x.x1),
    ]


def _faulty_rates(x: Any, u: Any, p: Any, t: Any) -> Iterable[Any]:
    x1, x2, x3 = _rates(x, u, p, t)
    return [x1, x2, x3 + p.actuator_fault]


# What the observer knows: without faults.
MOTOR = Model(
    name="motor",
    description="Three-phase current motor (Nikoukhah 1995, (5.1))",
    states=_STATES,
    inputs=_INPUTS,
    parameters=_PARAMETERS,
    outputs=_OUTPUTS,
    ode=_rates,
    output=lambda x, u, p, t: [x.x1, x.x2],
)
# The plant: its faults are unknown parameters, which can jump.
FAULTY_MOTOR = Model(
    name="motor",
    description="Three-phase current motor with actuator and sensor faults (Nikoukhah 1995, (5.1))",
    states=_STATES,
    inputs=_INPUTS,
    parameters=_PARAMETERS,
    unknown_parameters=(
        Variable("actuator_fault", "fault added to the rate of the field", unit="1/s"),
        Variable("bias_y1", "bias of the measured angle", unit="rad"),
        Variable("bias_y2", "bias of the measured speed", unit="rad/s"),
    ),
    outputs=_OUTPUTS,
    ode=_faulty_rates,
    output=lambda x, u, p, t: [x.x1 + p.bias_y1, x.x2 + p.bias_y2],
)
