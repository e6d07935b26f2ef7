"""A lithium-ion cell: its state of charge from current and voltage; the open-circuit voltage is a table, the resistance unknown.

Plett, "Battery Management Systems, Volume I: Battery Modeling", Artech House 2015, chapter 2: open-circuit voltage, series resistance
and one RC branch. The table is equation (2) of Chen & Rincon-Mora, "Accurate electrical battery model capable of predicting runtime and
I-V performance", IEEE Transactions on Energy Conversion 21 (2), 2006, at steps of 5 %; the other numbers are those of a cell of 2.9 Ah.
"""

import casadi as ca

from observers.controller import controller
from observers.model import Model, Variable
from observers.ukf import ukf
from reference_models.plant import plant

SAMPLE_TIME = 1.0  # [s]
STOP_TIME = 3600.0  # [s]
CHARGE = [0.05 * i for i in range(21)]
VOLTAGE = [
    *(2.654, 3.5164, 3.6746, 3.7104, 3.725, 3.7364, 3.7477),
    *(3.7597, 3.7729, 3.7873, 3.8034, 3.8212, 3.8411, 3.8633),
    *(3.888, 3.9155, 3.946, 3.9797, 4.017, 4.058, 4.1029),
]
# A B-spline goes smoothly through the table, and has a slope everywhere. It is 0 beyond its ends: the bounds of soc keep estimates inside.
open_circuit_voltage = ca.interpolant("open_circuit_voltage", "bspline", [CHARGE], VOLTAGE)


MODEL = Model(
    name="lithium_cell",
    description="Lithium-ion cell with a table of its open-circuit voltage, series resistance unknown",
    states=[
        Variable("soc", "state of charge", start=0.9, nominal=0.5, min=0.0, max=1.0),
        Variable("v1", "voltage of the RC branch", unit="V", nominal=0.05),
    ],
    inputs=[Variable("i", "current, positive discharges", unit="A")],
    parameters=[
        Variable("capacity", "charge of the full cell", unit="C", start=10440.0, nominal=1e4, min=1.0),
        Variable("R1", "resistance of the RC branch", unit="Ohm", start=0.02, nominal=0.02, min=1e-6),
        Variable("C1", "capacitance of the RC branch", unit="F", start=2000.0, nominal=2000.0, min=1e-3),
    ],
    unknown_parameters=[Variable("R0", "series resistance", unit="Ohm", start=0.03, nominal=0.03, min=0.0, max=0.2)],
    outputs=[Variable("v", "terminal voltage", unit="V", start=3.946)],
    ode=lambda x, u, p, t: [-u.i / p.capacity, -x.v1 / (p.R1 * p.C1) + u.i / p.C1],
    # The current acts on the voltage at once: an output may depend on inputs.
    output=lambda x, u, p, t: [open_circuit_voltage(x.soc) - x.v1 - p.R0 * u.i],
)


def drive(x, p, t):
    """A cycle of two minutes: bursts of discharge, and a phase that brakes and charges.

    It changes half-way between samples. In a system a plant's outputs show the inputs of the step before: with steps of half a sample,
    current and voltage that are read at a sample instant belong together.
    """
    second = ca.floor(t / SAMPLE_TIME + 0.5) * SAMPLE_TIME
    phase = ca.fmod(second, 120.0)
    return [1.2 + 1.5 * ca.sin(0.2 * second) + ca.if_else(phase < 20, 4.4, 0.0) - ca.if_else(phase > 100, 3.5, 0.0)]


cycle = controller(
    "lithium_cell_cycle",
    inputs=[],
    outputs=[Variable("i", "current", unit="A")],
    law=drive,
    stop_time=STOP_TIME,
    step_size=SAMPLE_TIME / 2,
)
true_system = plant(MODEL, stop_time=STOP_TIME, step_size=SAMPLE_TIME / 2)
observer = ukf(
    MODEL,
    sample_time=SAMPLE_TIME,
    process_noise={"soc": 1e-6, "v1": 1e-4, "R0": 1e-5},
    measurement_noise={"v": 0.002},
    initial_std={"soc": 0.2, "v1": 0.02, "R0": 0.02},
    guess={"soc": 0.7, "R0": 0.02},  # truth 0.9 and 0.03
    stop_time=STOP_TIME,
)
