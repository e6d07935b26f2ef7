"""Closed loops: the chaotic Duffing oscillator stabilised at the origin, and the motor at an angle, each from measured outputs only.

The observers are those of the papers; the feedbacks are ours. Beside each loop with an observer there is one with the true state.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca

from observers import units
from observers.canonical_dae import canonical_dae
from observers.component import SHORTEST_SAMPLE_TIME, Component
from observers.compose import compose
from observers.controller import controller
from observers.model import Variable
from observers.pseudospectral import pseudospectral
from observers.ukf import ukf
from reference_models import gong_2007, nikoukhah_1995
from reference_models.duffing import DUFFING
from reference_models.motor import MOTOR
from reference_models.recipe import Recipe, Source

DUFFING_SAMPLE_TIME = 0.1  # [s]
MOTOR_SAMPLE_TIME = nikoukhah_1995.SAMPLE_TIME
# Eigenvalues at -2 and -2 +- 8i of the motor linearised where it rests at an angle of 0.8 rad.
MOTOR_GAINS = {"x1": 24.605, "x2": -1.3543, "x3": 5.4075}


def _limited(value: Any, low: Any, high: Any) -> Any:
    return ca.fmin(ca.fmax(value, low), high)


def _stabilise(x: Any, p: Any, t: Any) -> list[Any]:
    """Cancels the forcing and the instability of the origin, x1; the cubic restores by itself. The forcing is that of the hold's middle."""
    u = -x.theta * ca.cos(t + p.hold / 2) - x.x1 - p.stiffness * x.x1 - p.damping * x.x2
    return [_limited(u, -p.limit, p.limit)]


def _hold_angle(x: Any, p: Any, t: Any) -> list[Any]:
    """u = u_r - K (x - x_r) around the equilibrium with x1 = angle; its field and input follow from the motor's equations."""
    field = (p.B1 - 0.5 * p.B2 * ca.sin(2 * p.angle)) / (p.A2 * ca.sin(p.angle))
    rest = p.D1 * field - p.D2 * ca.cos(p.angle)
    u = rest - p.gain_x1 * (x.x1 - p.angle) - p.gain_x2 * x.x2 - p.gain_x3 * (x.x3 - field)
    return [_limited(u, p.min, p.max)]


@cache
def duffing_controller() -> Component:
    return controller(
        "duffing_controller",
        description="stabilises the Duffing oscillator at the origin",
        inputs=[*DUFFING.states, *DUFFING.unknown_parameters],
        outputs=DUFFING.inputs,
        law=_stabilise,
        parameters=[
            Variable("stiffness", "of the stabilised oscillator", "1/s2", 1.0),
            Variable("damping", "added to the oscillator's own", "1/s", 1.8),
            Variable("hold", "how long the output is held", "s", DUFFING_SAMPLE_TIME, min=0.0),
            Variable("limit", "largest magnitude of the output", "m/s2", 5.0, min=0.0),
        ],
        stop_time=40.0,
        step_size=DUFFING_SAMPLE_TIME,
    )


@cache
def motor_controller() -> Component:
    return controller(
        "motor_controller",
        description="holds the motor's angle",
        inputs=MOTOR.states,
        outputs=MOTOR.inputs,
        law=_hold_angle,
        parameters=[
            *(v for v in MOTOR.parameters if v.name != "A1"),
            Variable("angle", "angle to hold", "rad", 0.8, min=0.1, max=1.5),
            *(
                Variable(
                    f"gain_{v.name}",
                    f"gain of the {v.description}",
                    units.product([(MOTOR.inputs[0].unit, 1), (v.unit, -1)]),
                    start=MOTOR_GAINS[v.name],
                )
                for v in MOTOR.states
            ),
            Variable("min", "smallest output", "1/s", MOTOR.inputs[0].min),
            Variable("max", "largest output", "1/s", MOTOR.inputs[0].max),
        ],
        stop_time=10.0,
        step_size=MOTOR_SAMPLE_TIME,
    )


def _sampled(plant: Component, sample_time: float) -> Component:
    """A plant whose sensor always samples, so that a feedback inside it has sample instants."""
    parameters = tuple(
        replace(port, start=sample_time, min=SHORTEST_SAMPLE_TIME) if port.name == plant.sample_time else port
        for port in plant.parameters
    )
    return replace(plant, parameters=parameters)


def _duffing_observer(name: str = "duffing_pseudospectral_loop") -> Component:
    return pseudospectral(
        DUFFING, sample_time=DUFFING_SAMPLE_TIME, N=20, L=30, guess=gong_2007.GUESS, name=name, stop_time=40.0
    )


def _duffing_filter() -> Component:
    return ukf(
        DUFFING,
        sample_time=DUFFING_SAMPLE_TIME,
        process_noise={"x1": 1e-4, "x2": 1e-4, "theta": 0.03},
        measurement_noise={"y": 0.006},  # of uniform noise in [-0.01, 0.01]
        guess=gong_2007.GUESS,
        stop_time=40.0,
    )


def _motor_observer() -> Component:
    return canonical_dae(MOTOR, sample_time=MOTOR_SAMPLE_TIME, guess=nikoukhah_1995.GUESS, stop_time=10.0)


FMUS: dict[str, Source] = {
    "duffing": gong_2007.FMUS["duffing"],
    "motor": nikoukhah_1995.FMUS["motor"],
    "motor_canonical_dae": nikoukhah_1995.FMUS["motor_canonical_dae"],
    "duffing_controller": (duffing_controller, None),
    "motor_controller": (motor_controller, None),
    "duffing_pseudospectral_loop": (_duffing_observer, gong_2007.duffing),
    "duffing_pseudospectral_controller": (
        lambda: compose(_duffing_observer(), duffing_controller(), name="duffing_pseudospectral_controller"),
        gong_2007.duffing,
    ),
    "duffing_ukf_controller": (
        lambda: compose(_duffing_filter(), duffing_controller(), name="duffing_ukf_controller"),
        gong_2007.duffing,
    ),
    "duffing_with_controller": (
        lambda: compose(
            _sampled(gong_2007.duffing(), DUFFING_SAMPLE_TIME),
            duffing_controller(),
            source="x",
            name="duffing_with_controller",
        ),
        None,
    ),
    "motor_canonical_dae_controller": (
        lambda: compose(_motor_observer(), motor_controller(), name="motor_canonical_dae_controller"),
        nikoukhah_1995.motor,
    ),
    "motor_with_controller": (
        lambda: compose(
            _sampled(nikoukhah_1995.motor(), MOTOR_SAMPLE_TIME),
            motor_controller(),
            source="x",
            name="motor_with_controller",
        ),
        None,
    ),
}

_NOISY_DUFFING = {**gong_2007.START, "sensor.noise_bound": 0.01, "sensor.sample_time": DUFFING_SAMPLE_TIME}
_NOISY_MOTOR = {"sensor.noise_bound.y1": 0.01, "sensor.noise_bound.y2": 0.01, "sensor.sample_time": MOTOR_SAMPLE_TIME}


def _loop(plant: str, observer: str, *outputs: str) -> tuple[tuple[str, str], ...]:
    return (*((f"{plant}.{y}", f"{observer}.{y}") for y in outputs), (f"{observer}.u", f"{plant}.u"))


SYSTEMS: dict[str, Recipe] = {
    "closed_loop_duffing": Recipe(
        "The Duffing oscillator stabilised at the origin: by the pseudospectral observer, by a UKF, by the true state",
        {
            "plant": "duffing",
            "observer": "duffing_pseudospectral_controller",
            "plant_ukf": "duffing",
            "observer_ukf": "duffing_ukf_controller",
            "plant_true": "duffing_with_controller",
        },
        {"plant": _NOISY_DUFFING, "plant_ukf": _NOISY_DUFFING, "plant_true": gong_2007.START},
        40.0,
        DUFFING_SAMPLE_TIME,
        (*_loop("plant", "observer", "y"), *_loop("plant_ukf", "observer_ukf", "y")),
    ),
    "closed_loop_duffing_controller": Recipe(
        "The same with the controller as an FMU of its own, which has direct feedthrough",
        {"plant": "duffing", "observer": "duffing_pseudospectral_loop", "controller": "duffing_controller"},
        {"plant": _NOISY_DUFFING},
        40.0,
        DUFFING_SAMPLE_TIME,
        (
            ("plant.y", "observer.y"),
            *((f"observer.estimate.{x}", f"controller.{x}") for x in ("x1", "x2", "theta")),
            ("controller.u", "observer.u"),
            ("controller.u", "plant.u"),
        ),
    ),
    "closed_loop_motor": Recipe(
        "The motor held at an angle: by the DAE observer, by the true state",
        {"plant": "motor", "observer": "motor_canonical_dae_controller", "plant_true": "motor_with_controller"},
        {"plant": _NOISY_MOTOR},
        10.0,
        MOTOR_SAMPLE_TIME,
        _loop("plant", "observer", "y1", "y2"),
    ),
    "closed_loop_motor_controller": Recipe(
        "The same with the controller as an FMU of its own, which has direct feedthrough",
        {"plant": "motor", "observer": "motor_canonical_dae", "controller": "motor_controller"},
        {"plant": _NOISY_MOTOR},
        10.0,
        MOTOR_SAMPLE_TIME,
        (
            ("plant.y1", "observer.y1"),
            ("plant.y2", "observer.y2"),
            *((f"observer.estimate.{x}", f"controller.{x}") for x in ("x1", "x2", "x3")),
            ("controller.u", "observer.u"),
            ("controller.u", "plant.u"),
        ),
    ),
}
