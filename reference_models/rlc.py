"""The nonlinear circuit of Gong, Ross & Kang 2007, (41), Example 6: a DAE of index 1 whose branches end at a singularity."""

from observers.model import Model, Variable

# 3 (x3 - 1)^2 = 1 is the singularity: two of the three branches of x3 meet there and end.
RLC = Model(
    name="rlc",
    description="RLC circuit with a nonlinear capacitor (Gong, Ross & Kang 2007, (41))",
    states=[
        Variable("x1", "charge of the capacitor", unit="C", start=4.0),
        Variable("x2", "magnetic flux of the inductor", unit="Wb", start=1.5),
    ],
    algebraic=[Variable("x3", "voltage of the capacitor", unit="V", start=2.7)],
    parameters=[
        Variable("R", "resistance", unit="Ohm", start=1.0, min=0.0, max=1e3),
        Variable("L", "inductance", unit="H", start=1.0, min=1e-3, max=1e3),
    ],
    outputs=[Variable("y", "magnetic flux of the inductor", unit="Wb")],
    ode=lambda x, z, u, p, t: [x.x2 / p.L, -x.x2 * p.R / p.L - z.x3 + 1],
    algebraic_equations=lambda x, z, u, p, t: [-x.x1 + (z.x3 - 1) ** 3 - (z.x3 - 1) + 1],
    output=lambda x, z, u, p, t: [x.x2],
)
