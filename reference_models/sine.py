"""A sine wave as a signal source: one component that feeds plant and observer the same known input, in whatever unit that has."""

import casadi as ca

from observers import units
from observers.component import Component, Port


def sine() -> Component:
    """y(t) = offset + amplitude sin(frequency t + phase), of no unit, for it stands for anything; no inputs, no state."""
    parameters = (
        Port("amplitude", "amplitude", units.NONE, 1.0, variability="tunable"),
        Port("frequency", "angular frequency", "rad/s", start=1.0, variability="tunable"),
        Port("phase", "phase at time zero", "rad", variability="tunable"),
        Port("offset", "mean value", units.NONE, variability="tunable"),
    )
    z, u, p, t, h = ca.SX(0, 1), ca.SX(0, 1), ca.SX.sym("p", 4), ca.SX.sym("t"), ca.SX.sym("h")
    amplitude, frequency, phase, offset = ca.vertsplit(p)
    return Component(
        name="sine",
        description="Sine wave as a signal source",
        start=ca.Function("start", [p, t], [z]),
        flow=ca.Function("flow", [z, u, p, t, h], [z]),
        output=ca.Function("output", [z, u, p, t], [offset + amplitude * ca.sin(frequency * t + phase)]),
        parameters=parameters,
        outputs=(Port("y", "the signal", units.NONE),),
        documentation="<p>y(t) = offset + amplitude sin(frequency t + phase).</p>",
    )
