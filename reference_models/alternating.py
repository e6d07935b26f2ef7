"""Two sensors that see a hidden oscillation in turn: observability indices that vary with time, for Chen & Yen 1999.

The oscillation x2, x3 drives two lags, x1 by max(sin t, 0)^3 and x4 by max(-sin t, 0)^3, of which both are measured. The indices of the two
outputs are 3 and 1 while sin t > 0, 1 and 3 while sin t < 0; where sin t = 0 no output sees the oscillation. It grows by e^0.05 a second.
"""

import casadi as ca

from observers.model import Model, Variable

ALTERNATING = Model(
    name="alternating",
    description="Growing oscillation that drives two measured lags in turn: observability indices vary",
    states=[
        Variable("x1", "first lag", start=1.0),
        Variable("x2", "oscillation", start=2.0),
        Variable("x3", "its rate of change", start=-1.0),
        Variable("x4", "second lag", start=-1.0),
    ],
    outputs=[Variable("y1", "first lag"), Variable("y2", "second lag")],
    ode=lambda x, u, p, t: [
        -x.x1 + ca.fmax(ca.sin(t), 0) ** 3 * x.x2,
        x.x3,
        -x.x2 + 0.1 * x.x3,
        -x.x4 + ca.fmax(-ca.sin(t), 0) ** 3 * x.x2,
    ],
    output=lambda x, u, p, t: [x.x1, x.x4],
)
