"""Which way a body points, from a gyroscope, an accelerometer that feels gravity, and a compass; the gyroscope's bias is unknown.

Farrenkopf, "Analytic steady-state accuracy solutions for two common spacecraft attitude estimators", Journal of Guidance and
Control 1 (4), 1978: the measured rates drive the model, and their bias is estimated. Angles of roll, pitch and yaw as in
Markley & Crassidis, "Fundamentals of Spacecraft Attitude Determination and Control", Springer 2014, chapter 2.
"""

import math

import casadi as ca

from observers.controller import controller
from observers.model import Model, Variable
from observers.ukf import ukf
from reference_models.plant import plant

SAMPLE_TIME = 0.02  # [s]
STOP_TIME = 60.0  # [s]
GRAVITY = 9.81  # [m/s2]


def rates(x, u, p, t):
    wx, wy, wz = u.gyro_x - p.bias_x, u.gyro_y - p.bias_y, u.gyro_z - p.bias_z
    across = wy * ca.sin(x.roll) + wz * ca.cos(x.roll)
    return [
        wx + across * ca.tan(x.pitch),
        wy * ca.cos(x.roll) - wz * ca.sin(x.roll),
        across / ca.cos(x.pitch),
    ]


MODEL = Model(
    name="gyro_attitude",
    description="Attitude of a body, bias of its gyroscope unknown",
    states=[
        Variable("roll", unit="rad", start=0.3),
        Variable("pitch", unit="rad", start=-0.2, min=-1.4, max=1.4),  # at 90 degrees roll and yaw are the same turn
        Variable("yaw", "heading; it may be any number of turns", unit="rad", start=2.5),
    ],
    inputs=[Variable(f"gyro_{axis}", f"measured rate about {axis}", unit="rad/s") for axis in "xyz"],
    unknown_parameters=[
        Variable("bias_x", "of the gyroscope about x", unit="rad/s", start=0.02, nominal=0.02),
        Variable("bias_y", "of the gyroscope about y", unit="rad/s", start=-0.03, nominal=0.02),
        Variable("bias_z", "of the gyroscope about z", unit="rad/s", start=0.01, nominal=0.02),
    ],
    outputs=[
        *(Variable(f"a{axis}", f"measured acceleration along {axis}", unit="m/s2") for axis in "xyz"),
        # An angle: what the compass shows may be any number of turns off.
        Variable("compass", "measured heading", unit="rad", wrap=2 * math.pi),
    ],
    ode=rates,
    # At rest or in steady flight an accelerometer feels what carries it: gravity, upside down.
    output=lambda x, u, p, t: [
        -GRAVITY * ca.sin(x.pitch),
        GRAVITY * ca.cos(x.pitch) * ca.sin(x.roll),
        GRAVITY * ca.cos(x.pitch) * ca.cos(x.roll),
        x.yaw,
    ],
)


def turn(x, p, t):
    """What the gyroscope shows while the body sways and circles: the rates about its own axes, and its bias."""
    roll, pitch, turning = 0.3 * ca.cos(0.5 * t), -0.2 * ca.cos(0.37 * t), 0.2
    rolling, pitching = -0.15 * ca.sin(0.5 * t), 0.074 * ca.sin(0.37 * t)
    return [
        0.02 + rolling - turning * ca.sin(pitch),
        -0.03 + pitching * ca.cos(roll) + turning * ca.sin(roll) * ca.cos(pitch),
        0.01 - pitching * ca.sin(roll) + turning * ca.cos(roll) * ca.cos(pitch),
    ]


gyroscope = controller(
    "gyro_attitude_gyroscope",
    inputs=[],
    outputs=[Variable(f"gyro_{axis}", f"measured rate about {axis}", unit="rad/s") for axis in "xyz"],
    law=turn,
    stop_time=STOP_TIME,
    step_size=SAMPLE_TIME,
)
# The gyroscope's noise: the plant moves by what it shows plus actuator.noise_std, which the observer does not know.
true_system = plant(MODEL, input_noise=True, stop_time=STOP_TIME, step_size=SAMPLE_TIME)
observer = ukf(
    MODEL,
    sample_time=SAMPLE_TIME,
    # The rates' noise is 0.01 rad/s in a sample of 0.02 s: as a wandering angle 0.01 sqrt(0.02) rad/sqrt(s).
    process_noise={"roll": 1.5e-3, "pitch": 1.5e-3, "yaw": 1.5e-3, "bias_x": 1e-5, "bias_y": 1e-5, "bias_z": 1e-5},
    measurement_noise={"ax": 0.1, "ay": 0.1, "az": 0.1, "compass": 0.05},
    initial_std={"roll": 0.5, "pitch": 0.5, "yaw": 1.0, "bias_x": 0.05, "bias_y": 0.05, "bias_z": 0.05},
    guess={"roll": 0.0, "pitch": 0.0, "yaw": 2.0, "bias_x": 0.0, "bias_y": 0.0, "bias_z": 0.0},
    stop_time=STOP_TIME,
)
