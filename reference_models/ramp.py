"""A ramp between two levels as a signal source: (11) of Calvillo-Corona & Alamir."""

import casadi as ca

from observers import units
from observers.component import Component, Port


def ramp() -> Component:
    """y(t) = 0 up to `start`, `height` from start + duration on, a straight line between, of no unit; no inputs, no state."""
    parameters = (
        Port("height", "value at the end", units.NONE, 0.5, variability="tunable"),
        Port("start", "where it leaves zero", "s", start=1.0, variability="tunable"),
        Port("duration", "time from zero to the end value", "s", start=1.0, min=1e-6, variability="tunable"),
    )
    z, u, p, t, h = ca.SX(0, 1), ca.SX(0, 1), ca.SX.sym("p", 3), ca.SX.sym("t"), ca.SX.sym("h")
    height, start, duration = ca.vertsplit(p)
    y = height * ca.fmin(ca.fmax((t - start) / duration, 0), 1)
    return Component(
        name="ramp",
        description="Ramp between two levels as a signal source",
        start=ca.Function("start", [p, t], [z]),
        flow=ca.Function("flow", [z, u, p, t, h], [z]),
        output=ca.Function("output", [z, u, p, t], [y]),
        parameters=parameters,
        outputs=(Port("y", "the signal", units.NONE),),
        documentation="<p>y(t) = height min(max((t - start) / duration, 0), 1).</p>",
    )
