"""The experiments of Nikoukhah, "A new methodology for observer design and implementation", 1995: section 5, Examples 2.1 to 2.3."""

from __future__ import annotations

from functools import cache

from observers.canonical_dae import canonical_dae
from observers.component import Component
from reference_models.chua import CHUA
from reference_models.double_integrator import DOUBLE_INTEGRATOR, MASS_WITH_UNKNOWN_FORCE, PUSHED_MASS
from reference_models.modulated import MODULATED, lyapunov_gain
from reference_models.motor import FAULTY_MOTOR, MOTOR
from reference_models.plant import plant
from reference_models.recipe import Recipe, Source
from reference_models.sine import sine

SAMPLE_TIME = 1e-3  # [s]
# x3 is the state that is not measured; the first sample sets the others.
GUESS = {"x1": 0.0, "x2": 0.0, "x3": 0.0}
CHUA_POLES = (-2.0, -3.0, -4.0)


@cache
def motor() -> Component:
    jumps = {"actuator_fault": 1, "bias_y1": 1, "bias_y2": 1}
    return plant(FAULTY_MOTOR, jumps=jumps, max_step=0.01, stop_time=6.0, step_size=SAMPLE_TIME)


@cache
def modulated() -> Component:
    return plant(MODULATED, stop_time=30.0, step_size=0.01)


@cache
def chua() -> Component:
    return plant(CHUA, stop_time=10.0, step_size=0.01)


@cache
def double_integrator() -> Component:
    return plant(DOUBLE_INTEGRATOR, stop_time=5.0, step_size=0.01)


@cache
def pushed_mass() -> Component:
    return plant(PUSHED_MASS, jumps={"force": 2}, stop_time=5.0, step_size=0.01)


def _motor_observer(suffix: str = "", **options: object) -> Source:
    name = f"motor_canonical_dae{suffix}"
    return (
        lambda: canonical_dae(MOTOR, sample_time=SAMPLE_TIME, guess=GUESS, name=name, stop_time=6.0, **options),  # type: ignore[arg-type]
        motor,
    )


FMUS: dict[str, Source] = {
    "motor": (motor, None),
    "motor_canonical_dae": _motor_observer(),
    "motor_canonical_dae_regional": _motor_observer("_regional", gain="regional", alpha=10.0),
    "motor_canonical_dae_bdf": _motor_observer("_bdf", form="bdf", order=2),
    "modulated": (modulated, None),
    "modulated_canonical_dae": (
        lambda: canonical_dae(
            MODULATED, sample_time=0.01, gain=lyapunov_gain, guess={"x1": 0.0, "x2": 0.0}, stop_time=30.0
        ),
        modulated,
    ),
    "chua": (chua, None),
    "chua_canonical_dae": (
        lambda: canonical_dae(
            CHUA, sample_time=0.01, poles=CHUA_POLES, guess={"x1": 1.0, "x2": 1.0, "x3": 1.0}, stop_time=10.0
        ),
        chua,
    ),
    "double_integrator": (double_integrator, None),
    "double_integrator_canonical_dae": (
        # Poles at -0.1/Ts: a cubic between samples would miss (2.66) by 0.006 at a tenth of the sampling frequency.
        lambda: canonical_dae(
            DOUBLE_INTEGRATOR, sample_time=0.01, degree=9, guess={"x1": 0.0, "x2": 0.0}, stop_time=5.0
        ),
        double_integrator,
    ),
    "pushed_mass": (pushed_mass, None),
    "pushed_mass_canonical_dae": (
        lambda: canonical_dae(MASS_WITH_UNKNOWN_FORCE, sample_time=0.01, guess={"x2": 0.0}, stop_time=5.0),
        pushed_mass,
    ),
    "sine": (sine, None),
}

_DRIVE = {"amplitude": 2.0, "frequency": 2.0, "offset": 2.0}  # u = 2 (1 + sin 2t)
_MEASURED = (("plant.y1", "observer.y1"), ("plant.y2", "observer.y2"))
_DRIVEN = (("source.y", "plant.u"), ("source.y", "observer.u"))


# Gaussian noise of 1e-3 drives the residual to 0.006 now and then, but not for five samples.
DETECTOR = {"tuning.fault_threshold": 0.006}


def _motor(description: str, observer: str = "motor_canonical_dae") -> Recipe:
    fmus = {"source": "sine", "plant": "motor", "observer": observer}
    parameters = {"source": _DRIVE, "observer": DETECTOR}
    return Recipe(description, fmus, parameters, 6.0, SAMPLE_TIME, (*_DRIVEN, *_MEASURED))


SYSTEMS: dict[str, Recipe] = {
    "nikoukhah_motor": _motor("Section 5: three-phase motor, exact placement at -10"),
    "nikoukhah_motor_regional": _motor("Section 5 with regional placement, alpha = 10", "motor_canonical_dae_regional"),
    "nikoukhah_motor_bdf": _motor("Section 5 by backward differentiation of order 2", "motor_canonical_dae_bdf"),
    "nikoukhah_example_2_1": Recipe(
        "Example 2.1: Lyapunov gain, u = sin t",
        {"source": "sine", "plant": "modulated", "observer": "modulated_canonical_dae"},
        {"plant": {"start.x1": 1.0, "start.x2": 0.5}},
        30.0,
        0.01,
        (*_DRIVEN, ("plant.y", "observer.y")),
    ),
    "nikoukhah_example_2_2": Recipe(
        "Example 2.2: Chua's circuit, error dynamics that are linear",
        {"plant": "chua", "observer": "chua_canonical_dae"},
        {},
        10.0,
        0.01,
    ),
    "nikoukhah_example_2_3": Recipe(
        "Example 2.3: double integrator",
        {"plant": "double_integrator", "observer": "double_integrator_canonical_dae"},
        {},
        5.0,
        0.01,
    ),
    "nikoukhah_unknown_force": Recipe(
        "Unknown input: a force that comes at 1 s and changes at 3 s",
        {"plant": "pushed_mass", "observer": "pushed_mass_canonical_dae"},
        {
            "plant": {
                "parameter.force_jump_time[1]": 1.0,
                "parameter.force_jump_value[1]": 2.0,
                "parameter.force_jump_time[2]": 3.0,
                "parameter.force_jump_value[2]": -1.0,
            }
        },
        5.0,
        0.01,
        _MEASURED,
    ),
}
