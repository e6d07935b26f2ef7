"""The linear system with the output sin x1 of James & Baras 1987, (5.3).

The printed matrix has the eigenvalues -4.372 and 1.372. With a third of [[-5, sqrt 2], [sqrt 2, -4]] they are -1 and -2, as the text says.
"""

import math

import casadi as ca

from observers.model import Model, Variable

JAMES_BARAS_5_2 = Model(
    name="james_baras_5_2",
    description="Linear dynamics, nonlinear observation (James & Baras 1987, Example 5.2)",
    states=[Variable("x1", "first state", start=1.0), Variable("x2", "second state", start=-1.0)],
    inputs=[Variable("u", "control", min=-1.0, max=1.0)],
    outputs=[Variable("y", "sine of the first state")],
    ode=lambda x, u, p, t: [
        (-5 * x.x1 + math.sqrt(2) * x.x2) / 3 + u.u,
        (math.sqrt(2) * x.x1 - 4 * x.x2) / 3,
    ],
    output=lambda x, u, p, t: [ca.sin(x.x1)],
)
