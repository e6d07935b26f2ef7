"""How often to sample: by the fastest mode of the model that its outputs show.

A mode of the linearised model is shown where, as large as one of its states' nominal value, it moves an output by more than the noise. What
is faster than that cannot be followed by any sampling. Looked at are points of the region, and the motion from the start values.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import casadi as ca
import numpy as np

from advice.region import AdviceError, Region
from observers.free_motion import free_motion
from observers.model import Model
from observers.numerics.algebraic import measurement, motion

POINTS = 60  # drawn from the region, and taken from the motion
USUAL = 0.9  # of the points' rates: a burst that passes does not set the pace
PER_TIME_CONSTANT = 5  # samples
NICE = (1.0, 2.0, 5.0)


def sample_time(model: Model, region: Region, noise: Mapping[str, float]) -> tuple[float, float]:
    """Ts [s], a nice number, and the rate of the fastest mode that the outputs show [1/s].

    A model without such a mode, a chain of integrators, is sampled by how fast it crosses the nominal values of its states.

    Raises:
        AdviceError: nothing moves at all.
    """
    fastest, crossing = _rates(model, region, noise)
    rate = float(np.quantile(fastest, USUAL)) or float(np.quantile(crossing, USUAL))
    if not rate > 0:
        raise AdviceError(f"model '{model.name}': nothing moves within the region: give --sample-time")
    return nice(1 / (PER_TIME_CONSTANT * rate)), rate


def nice(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above `value`."""
    power = math.floor(math.log10(value))
    return max(float(f"{digit}e{p}") for p in (power - 1, power) for digit in NICE if digit * 10.0**p <= value * 1.001)


def _rates(model: Model, region: Region, noise: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """At each point: the largest |eigenvalue| of a mode that is shown, and |rate of change| of a state in its nominal values [1/s]."""
    eq = replace(model.equations, u=ca.vertcat(model.equations.u, model.equations.w), w=ca.SX(0, 1))
    z0 = ca.SX.sym("z0", eq.z.numel())
    symbols = [eq.x, eq.u, eq.p, eq.theta, eq.t, z0]
    rate, seen = motion(eq)(*symbols)[0], measurement(eq)(*symbols)[0]
    A, C = ca.jacobian(rate, eq.x), ca.jacobian(seen, eq.x)
    at = ca.Function("at", symbols, [ca.densify(e) for e in (rate, A, C)])
    nominal = np.array([v.nominal for v in model.states])
    deviation = np.array([noise[v.name] for v in model.outputs])
    p, algebraic = ([v.start for v in group] for group in (model.parameters, model.algebraic))
    fastest, crossing = [], []
    for x, u, theta, t, z in _points(model, region):
        f, jacobian, gradient = (value.full() for value in at(x, u, p, theta, t, z if len(z) else algebraic))
        if not (np.isfinite(jacobian).all() and np.isfinite(gradient).all() and np.isfinite(f).all()):
            continue
        values, modes = np.linalg.eig(jacobian)
        modes = modes / np.max(np.abs(modes) / nominal[:, None], axis=0)
        shown = (np.abs(gradient @ modes) > deviation[:, None]).any(axis=0)
        fastest.append(float(np.abs(values[shown]).max(initial=0.0)))
        crossing.append(float(np.max(np.abs(f[:, 0]) / nominal)))
    if not fastest:
        raise AdviceError(f"model '{model.name}': its equations are finite nowhere around the start values")
    return np.array(fastest), np.array(crossing)


def _points(model: Model, region: Region) -> list[tuple[np.ndarray, ...]]:
    """(x, u with disturbances, theta, t, z) drawn from the region, and of the motion from the start values, inputs held."""
    driven = (*model.inputs, *model.unknown_disturbances)
    u_start, theta_start = (np.array([v.start for v in group]) for group in (driven, model.unknown_parameters))
    found: list[tuple[np.ndarray, ...]] = []
    for seed in range(POINTS):
        drawn, rng = region.start(seed), np.random.default_rng([seed, 5])
        x, theta = (np.array([drawn[v.name] for v in group]) for group in (model.states, model.unknown_parameters))
        u = np.array([rng.uniform(*region.driven[v.name]) for v in driven])
        found.append((x, u, theta, np.array(0.0), np.zeros(0)))
    moving = free_motion(model, _step(model))
    if moving is not None:
        some = moving.thinned(POINTS)
        found += [
            (some.states[:, k], u_start, theta_start, np.array(t), some.algebraic[:, k])
            for k, t in enumerate(some.times)
        ]
    return found


def _step(model: Model) -> float:
    """A small part of the time in which the model moves at its start values [s]."""
    eq = replace(model.equations, u=ca.vertcat(model.equations.u, model.equations.w), w=ca.SX(0, 1))
    z0 = ca.SX.sym("z0", eq.z.numel())
    symbols = [eq.x, eq.u, eq.p, eq.theta, eq.t, z0]
    rate = motion(eq)(*symbols)[0]
    at = ca.Function("at", symbols, [rate, ca.densify(ca.jacobian(rate, eq.x))])
    driven = (*model.inputs, *model.unknown_disturbances)
    groups = (model.states, driven, model.parameters, model.unknown_parameters)
    f, A = (v.full() for v in at(*[[v.start for v in g] for g in groups], 0.0, [v.start for v in model.algebraic]))
    fastest = float(np.abs(np.linalg.eigvals(A)).max())
    crossing = float(np.max(np.abs(f[:, 0]) / [v.nominal for v in model.states]))
    return 0.1 / (max(fastest, crossing) or 1.0)
