"""The Silverbox, an electronic circuit that obeys a forced Duffing equation, and observers of its unknown stiffness.

Wigren & Schoukens, "Three free data sets for development and benchmarking in nonlinear system identification", ECC 2013
(nonlinearbenchmark.org); the measurement is in data/silverbox.csv.gz.
"""

from __future__ import annotations

from functools import cache

from observers.component import Component
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral
from observers.ukf import ukf
from reference_models.plant import plant
from reference_models.recipe import Recipe, Source

SAMPLE_TIME = 2**14 / 1e7  # [s]: 610.35 Hz
# Fitted by simulation error over 2,000 samples of the measurement; the free run then differs from it by 0.88 mV rms.
K1, K3 = 1.8430e5, 7.365e5
OFF = 0.7  # times the fitted values, where an observer starts
LEAST, MOST = 0.2, 3.0  # times the fitted values

SILVERBOX = Model(
    name="silverbox",
    description="Silverbox: electronic circuit that obeys a forced Duffing equation (Wigren & Schoukens 2013)",
    states=[
        Variable("x1", "output voltage", unit="V", start=0.1, nominal=0.1),
        Variable("x2", "rate of the output voltage", unit="V/s", nominal=43.0),  # the circuit oscillates at 430 rad/s
    ],
    inputs=[Variable("u", "input voltage", unit="V", nominal=0.1)],
    parameters=[
        Variable("d", "damping", unit="1/s", start=41.81, min=0.0),
        Variable("c", "gain of the input", unit="1/s2", start=1.9366e5),
    ],
    unknown_parameters=[
        Variable("k1", "linear stiffness", unit="1/s2", start=K1, nominal=K1, min=LEAST * K1, max=MOST * K1),
        Variable("k3", "cubic stiffness", unit="1/(V2.s2)", start=K3, nominal=K3, min=LEAST * K3, max=MOST * K3),
    ],
    outputs=[Variable("y", "measured output voltage", unit="V", nominal=0.1)],
    input_between_samples="linear",
    ode=lambda x, u, p, t: [x.x2, -p.d * x.x2 - p.k1 * x.x1 - p.k3 * x.x1**3 + p.c * u.u],
    output=lambda x, u, p, t: [x.x1],
)


@cache
def silverbox() -> Component:
    return plant(SILVERBOX, max_step=SAMPLE_TIME, stop_time=0.3, step_size=SAMPLE_TIME)


GUESS = {"x1": 0.0, "k1": OFF * K1, "k3": OFF * K3}
PROCESS_NOISE = {"x1": 1e-3, "x2": 5.0, "k1": 100.0, "k3": 1e4}
INITIAL_STD = {"x1": 0.1, "x2": 43.0, "k1": 0.3 * K1, "k3": 0.3 * K3}

FMUS: dict[str, Source] = {
    "silverbox": (silverbox, None),
    "silverbox_pseudospectral": (
        lambda: pseudospectral(
            SILVERBOX, sample_time=SAMPLE_TIME, N=6, L=200, segments=100, guess=GUESS, stop_time=1.0
        ),
        silverbox,
    ),
    "silverbox_pseudospectral_short": (
        lambda: pseudospectral(
            SILVERBOX,
            sample_time=SAMPLE_TIME,
            N=6,
            L=50,
            segments=25,
            arrival_cost=True,
            process_noise=PROCESS_NOISE,
            measurement_noise={"y": 1e-3},
            initial_std=INITIAL_STD,
            guess=GUESS,
            name="silverbox_pseudospectral_short",
            stop_time=1.0,
        ),
        silverbox,
    ),
    "silverbox_ukf": (
        lambda: ukf(
            SILVERBOX,
            sample_time=SAMPLE_TIME,
            process_noise=PROCESS_NOISE,
            measurement_noise={"y": 1e-3},
            initial_std=INITIAL_STD,
            guess=GUESS,
            stop_time=0.3,
        ),
        silverbox,
    ),
}

SYSTEMS: dict[str, Recipe] = {}
