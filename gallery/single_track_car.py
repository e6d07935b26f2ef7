"""A car from above, both wheels of an axle drawn together: its side-slip from yaw rate and lateral acceleration; the grip is unknown.

The single-track model of Riekert & Schunck, "Zur Fahrmechanik des gummibereiften Kraftfahrzeugs", Ingenieur-Archiv 11, 1940, as in
Rajamani, "Vehicle Dynamics and Control", Springer 2012, chapter 2; numbers of a middle-sized car.
"""

import casadi as ca

from observers.controller import controller
from observers.model import Model, Variable
from observers.ukf import ukf
from reference_models.plant import plant

SAMPLE_TIME = 0.02  # [s]
STOP_TIME = 20.0  # [s]


def forces(x, u, p):
    """The tyres' lateral forces, front and rear [N]: cornering stiffness times slip angle, as long as that is small."""
    front = u.steering - (x.vy + p.front * x.rate) / u.speed
    rear = -(x.vy - p.rear * x.rate) / u.speed
    return p.grip * p.stiffness_front * front, p.grip * p.stiffness_rear * rear


def rates(x, u, p, t):
    front, rear = forces(x, u, p)
    return [(front + rear) / p.mass - u.speed * x.rate, (p.front * front - p.rear * rear) / p.inertia]


def sensors(x, u, p, t):
    front, rear = forces(x, u, p)
    # The accelerometer feels the forces, and so the steering, at once.
    return [x.rate, (front + rear) / p.mass]


MODEL = Model(
    name="single_track_car",
    description="Single-track car, grip unknown",
    states=[
        Variable("vy", "lateral velocity of the centre of mass", unit="m/s", nominal=0.5),
        Variable("rate", "yaw rate", unit="rad/s", nominal=0.3),
    ],
    inputs=[
        Variable("steering", "angle of the front wheels", unit="rad", nominal=0.05),
        Variable("speed", "forward velocity", unit="m/s", start=25.0, nominal=25.0, min=3.0),  # the model divides by it
    ],
    parameters=[
        Variable("mass", unit="kg", start=1500.0, nominal=1500.0, min=100.0),
        Variable("inertia", "about the vertical axis", unit="kg.m2", start=2500.0, nominal=2500.0, min=100.0),
        Variable("front", "centre of mass to front axle", unit="m", start=1.2, min=0.1),
        Variable("rear", "centre of mass to rear axle", unit="m", start=1.5, min=0.1),
        Variable("stiffness_front", "on a dry road", unit="N/rad", start=9e4, nominal=1e5, min=1e3),
        Variable("stiffness_rear", "on a dry road", unit="N/rad", start=1e5, nominal=1e5, min=1e3),
    ],
    unknown_parameters=[Variable("grip", "part of the stiffness on a dry road", start=0.6, min=0.1, max=1.5)],
    outputs=[
        Variable("yaw_rate", "measured yaw rate", unit="rad/s"),
        Variable("ay", "measured lateral acceleration", unit="m/s2"),
    ],
    ode=rates,
    output=sensors,
)


def ride(x, p, t):
    """A slalom at a speed that rises and falls."""
    return [p.slalom * (0.02 * ca.sin(1.5 * t) + 0.01 * ca.sin(3.7 * t)), 25.0 + 5.0 * ca.sin(0.4 * t)]


driver = controller(
    "single_track_car_driver",
    inputs=[],
    outputs=[
        Variable("steering", "angle of the front wheels", unit="rad"),
        Variable("speed", "forward velocity", unit="m/s", start=25.0),
    ],
    parameters=[Variable("slalom", "1, or 0 to drive straight on", start=1.0)],
    law=ride,
    stop_time=STOP_TIME,
    step_size=SAMPLE_TIME,
)
true_system = plant(MODEL, stop_time=STOP_TIME, step_size=SAMPLE_TIME)
observer = ukf(
    MODEL,
    sample_time=SAMPLE_TIME,
    process_noise={"vy": 0.01, "rate": 0.005, "grip": 0.005},
    measurement_noise={"yaw_rate": 0.003, "ay": 0.1},
    initial_std={"vy": 0.5, "rate": 0.1, "grip": 0.4},
    guess={"grip": 1.0},  # a dry road; truth 0.6, a wet one
    stop_time=STOP_TIME,
)
