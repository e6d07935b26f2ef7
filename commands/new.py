"""observer-fmus new: a model file to start from."""

from __future__ import annotations

import keyword
import re
from pathlib import Path
from typing import Annotated

import typer

from commands.console import fail, out
from cosim.whole import whole

TEMPLATE = '''\
"""{name}: a model, its plant and an observer. Build it: observer-fmus build --file {name}.py"""

import casadi as ca

from observers.model import Model, Variable
from observers.ukf import ukf
from reference_models.plant import plant

# A pendulum with friction; put your equations in its place. A Variable has a name, a description, a unit ("m/s2", "1" for none), the
# value that it starts at, and min and max where it has bounds.
MODEL = Model(
    name="{name}",
    states=[
        Variable("angle", "angle from the vertical", unit="rad", start=1.0),
        Variable("rate", "angular rate", unit="rad/s"),
    ],
    # What drives the system, and the observer is told: an input of both FMUs.
    inputs=[Variable("torque", "torque over inertia", unit="1/s2")],
    # Constants that are known: they can be set in both FMUs.
    parameters=[Variable("stiffness", "gravity over length", unit="1/s2", start=9.81)],
    # Constants that are not: the observer estimates them beside the states.
    unknown_parameters=[Variable("friction", "friction over inertia", unit="1/s", start=0.2, min=0.0, max=5.0)],
    # What the sensors measure.
    outputs=[Variable("y", "measured angle", unit="rad")],
    # The derivatives of the states, in their order, at time t [s]. Use CasADi's functions: ca.sin, ca.exp, ca.if_else(condition, a, b).
    ode=lambda x, u, p, t: [
        x.rate,
        -p.stiffness * ca.sin(x.angle) - p.friction * x.rate + u.torque,
    ],
    output=lambda x, u, p, t: [x.angle],
)

# The FMU {name}.fmu: the true system, with noise of sensor.noise_std when sensor.sample_time is set.
true_system = plant(MODEL, stop_time=20.0, step_size=0.05)

# The FMU {name}_ukf.fmu. process_noise: how fast the model may be wrong (per square root of a second); measurement_noise: standard
# deviation of a sample; initial_std: how wrong the guess may be. The first guess of the friction is 0, the truth 0.2.
observer = ukf(
    MODEL,
    sample_time=0.05,
    process_noise={{"angle": 1e-4, "rate": 1e-3, "friction": 1e-3}},
    measurement_noise={{"y": 0.01}},
    initial_std={{"angle": 0.5, "rate": 0.5, "friction": 0.3}},
    guess={{"friction": 0.0}},
    stop_time=20.0,
)
'''


def new(
    name: Annotated[str, typer.Argument(help="Of the model, and of the file NAME.py.", show_default=False)],
) -> None:
    """Write NAME.py, a model file with comments that runs as it is: put your equations in its place.

    \b
    Example:
      observer-fmus new tank
    """
    if not re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII) or keyword.iskeyword(name):
        fail(f"{name}: letters, digits and _ name a model, and no digit first", 2)
    path = Path(f"{name}.py")
    if path.exists():
        fail(f"{path}: is there already, and stays as it is", 2)
    with whole(path) as partial:
        partial.write_text(TEMPLATE.format(name=name), encoding="utf-8")
    out.print(f"{path}: now observer-fmus build --file {path}", markup=False, soft_wrap=True)
