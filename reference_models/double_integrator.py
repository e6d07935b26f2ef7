"""Example 2.3 of Nikoukhah 1995, (2.60), and the same pushed by a force that nobody measures."""

from observers.model import Model, Variable

_STATES = (Variable("x1", "position", unit="m"), Variable("x2", "velocity", unit="m/s", start=1.0))
_POSITION = Variable("y", "measured position", unit="m")
_BOTH = (Variable("y1", "measured position", unit="m"), Variable("y2", "measured velocity", unit="m/s"))
_FORCE = Variable("force", "force over mass", unit="m/s2")

DOUBLE_INTEGRATOR = Model(
    name="double_integrator",
    description="Double integrator (Nikoukhah 1995, (2.60))",
    states=_STATES,
    outputs=[_POSITION],
    ode=lambda x, u, p, t: [x.x2, 0],
    output=lambda x, u, p, t: [x.x1],
)
# The plant knows its force as a parameter that can jump, the observer as an unknown disturbance.
PUSHED_MASS = Model(
    name="pushed_mass",
    description="Double integrator with a force, position and velocity measured",
    states=_STATES,
    unknown_parameters=[_FORCE],
    outputs=_BOTH,
    ode=lambda x, u, p, t: [x.x2, p.force],
    output=lambda x, u, p, t: [x.x1, x.x2],
)
MASS_WITH_UNKNOWN_FORCE = Model(
    name="pushed_mass",
    description="Double integrator with an unknown force, position and velocity measured",
    states=_STATES,
    unknown_disturbances=[_FORCE],
    outputs=_BOTH,
    ode=lambda x, u, p, t: [x.x2, u.force],
    output=lambda x, u, p, t: [x.x1, x.x2],
)
