"""A model whose rates and outputs depend on t by themselves, and every observer of it."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from observers.canonical_dae import canonical_dae
from observers.component import Component
from observers.elementary import elementary
from observers.least_squares import least_squares
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral
from observers.riccati import riccati
from observers.ukf import ukf

T0, TS, SPAN = 2.7, 0.05, 2.0

SWING = Model(
    name="swing",
    states=[Variable("a", start=0.8, min=-9, max=9), Variable("b", start=-0.3, min=-9, max=9)],
    inputs=[Variable("u")],
    outputs=[Variable("y")],
    ode=lambda x, u, p, t: [x.b, -2 * x.a - (0.3 + 0.2 * ca.cos(2 * t)) * x.b + u.u + ca.sin(1.7 * t)],
    output=lambda x, u, p, t: [(1 + 0.2 * ca.sin(1.3 * t)) * x.a + 0.1 * t],
)
# How it is made with a sample time, and how far its estimates may be off: ten times what they are.
EXACT: dict[str, tuple[Callable[..., Component], float]] = {
    "ukf": (lambda Ts, model=SWING: ukf(model, sample_time=Ts), 1e-14),
    "riccati": (lambda Ts, model=SWING: riccati(model, sample_time=Ts), 1e-14),
    "least_squares": (lambda Ts, model=SWING: least_squares(model, sample_time=Ts, T=0.3), 2e-14),
    "pseudospectral": (lambda Ts, model=SWING: pseudospectral(model, sample_time=Ts, N=10, L=6), 2e-12),
    "segments": (lambda Ts, model=SWING: pseudospectral(model, sample_time=Ts, N=6, L=6, segments=3), 8e-10),
    "arrival cost": (lambda Ts, model=SWING: pseudospectral(model, sample_time=Ts, N=8, L=6, arrival_cost=True), 1e-9),
    "elementary": (lambda Ts, model=SWING: elementary(model, sample_time=Ts, N=8), 6e-7),
}
# What it is off by goes down with a power of the sample time, a time that is wrong by a part of a sample with the first.
CONVERGENT: dict[str, tuple[Callable[..., Component], int]] = {
    "riccati, stiff": (lambda Ts, model=SWING: riccati(model, sample_time=Ts, stiff=True), 2),
    "spline": (lambda Ts, model=SWING: pseudospectral(model, sample_time=Ts, N=8, L=6, cost="spline"), 4),
    "canonical_dae": (lambda Ts, model=SWING: canonical_dae(model, sample_time=Ts), 4),
    "canonical_dae, bdf": (lambda Ts, model=SWING: canonical_dae(model, sample_time=Ts, form="bdf"), 2),
}
