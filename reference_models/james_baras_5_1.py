"""The bilinear system of James & Baras 1987, (5.1), with n = 3, m = 2: a concrete member of the paper's family."""

from observers.model import Model, Variable

JAMES_BARAS_5_1 = Model(
    name="james_baras_5_1",
    description="Bilinear dynamics, linear observation (James & Baras 1987, Example 5.1)",
    states=[
        Variable("x1", "first state", start=1.0),
        Variable("x2", "second state", start=-1.0),
        Variable("x3", "third state", start=2.0),
    ],
    inputs=[
        Variable("u1", "first control", min=-1.0, max=1.0),
        Variable("u2", "second control", min=-1.0, max=1.0),
    ],
    outputs=[Variable("y", "first state")],
    # x' = (A + u1 B1 + u2 B2) x with A = [[0, 1, 0], [0, 0, 1], [-1, -2, -0.5]], B1 = [[0.3, 0, 0], [0.2, -0.3, 0], [0, 0.2, 0.4]],
    # B2 = [[-0.2, 0, 0], [0, 0.4, 0], [0.3, 0, -0.3]].
    ode=lambda x, u, p, t: [
        x.x2 + u.u1 * 0.3 * x.x1 - u.u2 * 0.2 * x.x1,
        x.x3 + u.u1 * (0.2 * x.x1 - 0.3 * x.x2) + u.u2 * 0.4 * x.x2,
        -x.x1 - 2 * x.x2 - 0.5 * x.x3 + u.u1 * (0.2 * x.x2 + 0.4 * x.x3) + u.u2 * (0.3 * x.x1 - 0.3 * x.x3),
    ],
    output=lambda x, u, p, t: [x.x1],
)
