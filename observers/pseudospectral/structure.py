"""What is fixed when the observer is made: the window's shape, checked, and Problem 2 on it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import casadi as ca
import numpy as np

from observers.linearisation import refuse_unobservable
from observers.model import Model, ModelError
from observers.numerics import tiles
from observers.numerics.equations import Equations
from observers.numerics.semilinear import Split, split, thinned
from observers.pseudospectral.window.collocation import segment
from observers.pseudospectral.window.gauss_newton import Constraints
from observers.pseudospectral.window.pointwise import pointwise
from observers.pseudospectral.window.problem import LeastSquares
from observers.pseudospectral.window.rates import are_sparse

MOST_NODES = 200  # of a segment: at 80 the component takes 25 s to make, and the time grows with the square


def check_sample_time(sample_time: float) -> None:
    """Raise as `pseudospectral` says."""
    if not (math.isfinite(sample_time) and sample_time > 0):
        raise ValueError(f"pseudospectral: sample_time = {sample_time:g} must be positive")


def check(model: Model, N: int, L: int, segments: int, cost: str, more: bool) -> None:
    """Raise as `pseudospectral` says; `more`: a noise bound, an arrival cost or process noise is asked for."""
    least = (("N", N, 2), ("L", L, 3 if cost == "spline" else 1), ("segments", segments, 1))
    for name_of, value, lowest in least:
        if not isinstance(value, int) or value < lowest:
            raise ValueError(f"pseudospectral: {name_of} = {value!r} must be a whole number of at least {lowest}")
    if N > MOST_NODES:
        raise ValueError(
            f"pseudospectral: N = {N} is more than {MOST_NODES}, which would take longer than minutes to build: take a lower N (a smooth "
            "window needs 10 to 30), or several segments of it"
        )
    if L % segments:
        raise ValueError(f"pseudospectral: segments = {segments} must divide L = {L}")
    unknowns = len(model.states) + len(model.unknown_parameters)
    if (L + 1) * len(model.outputs) < unknowns:
        raise ValueError(
            f"pseudospectral: L = {L} gives {(L + 1) * len(model.outputs)} measurements in a window, "
            f"too few for the {unknowns} states and unknown parameters of model '{model.name}'"
        )
    if cost not in ("samples", "spline"):
        raise ValueError(f"pseudospectral: cost = {cost!r} must be 'samples' or 'spline'")
    if cost == "spline" and (segments > 1 or more):
        raise ValueError(
            "pseudospectral: the spline cost goes with one segment, without noise bound, arrival cost or process noise"
        )
    refuse_unobservable(model, "pseudospectral")
    for v in model.algebraic:
        if math.isfinite(v.min) or math.isfinite(v.max):
            raise ModelError(
                f"pseudospectral: model '{model.name}' bounds the algebraic variable '{v.name}' by [{v.min:g}, {v.max:g}], which is not "
                "imposed: bound the states that it follows from, or leave its bounds out"
            )
    eq = model.equations
    if model.algebraic and not ca.depends_on(eq.ode, eq.z):
        raise ModelError(
            f"pseudospectral: model '{model.name}' has algebraic variables that no state's equation contains: "
            "write their solution into the outputs"
        )


def noisy(
    model: Model, process_noise: Mapping[str, float] | None, tube: bool, arrival: bool
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Which states and which unknown parameters have process noise inside the window: those to which more than 0 is given.

    None beside a tube, which Problem 3 derives from a model that is exact over the window: there it acts in the arrival cost.

    Raises:
        ModelError: a tube, and no arrival cost for the noise to act in.
    """
    given = {name: value for name, value in (process_noise or {}).items() if value > 0}
    if tube and given and not arrival:
        raise ModelError(
            f"pseudospectral: with noise_bound the model is exact inside the window, so process_noise of {', '.join(given)} acts in the "
            "arrival cost alone: give arrival_cost=True"
        )
    groups = (model.states, model.unknown_parameters)
    states, parameters = (tuple(i for i, v in enumerate(group) if v.name in given and not tube) for group in groups)
    return states, parameters


def problem(
    model: Model,
    eq: Equations,
    N: int,
    L: int,
    segments: int,
    sample_time: float,
    cost: str,
    noisy: tuple[tuple[int, ...], tuple[int, ...]] = ((), ()),
) -> LeastSquares:
    """Problem 2's data: where the outputs are compared, and in which units steps are measured."""
    parts, output = (_with_algebraic(split(f, eq.x, eq.u), eq) for f in (eq.ode, eq.output))
    smooth = not model.inputs or segments == L  # over a segment: an input that is held makes kinks
    if smooth and not model.algebraic and tiles.kind(eq.x.numel() + eq.theta.numel()) is ca.MX:
        thin = thinned(parts, eq.ode, eq.x, eq.u)
        parts = thin if are_sparse(thin, eq.x, N) else parts
    s = segment(parts, N, L // segments, sample_time, model.input_between_samples, noisy[0])
    nominal = np.array([v.nominal for v in (*model.states, *model.unknown_parameters)])
    z_scale = tuple(v.nominal for v in model.algebraic)
    bounded = [i for i, v in enumerate(model.states) if math.isfinite(v.min) or math.isfinite(v.max)]
    made = LeastSquares(
        segment=s,
        count=segments,
        rates=pointwise(parts, eq, z_scale),
        output=output,
        output_rest=pointwise(output, eq, z_scale),
        points=s.node_times if cost == "spline" else np.arange(s.samples + 1) * sample_time,
        scale=nominal,
        rate_scale=2 / s.length * nominal[parts.rows],  # a rate's effect over half a segment, in the state's unit
        output_scale=np.array([v.nominal for v in model.outputs]),
        n_parameters=len(model.parameters),
        n_theta=len(model.unknown_parameters),
        bounded=tuple(bounded),
        noisy_parameters=noisy[1],
        output_sees_theta=bool(ca.depends_on(ca.vertcat(eq.output, eq.algebraic), eq.theta))
        if eq.theta.numel()
        else False,
    )
    return replace(made, path=_path(model, eq, made)) if model.constraints else made


def _path(model: Model, eq: Equations, problem: LeastSquares) -> LeastSquares:
    """`problem` with the model's path constraints (3) for its outputs, at the nodes and the sample instants."""
    s = problem.segment
    times = np.concatenate([s.node_times, np.arange(s.samples + 1) * s.sample_time])
    part = _with_algebraic(split(eq.constraint, eq.x, eq.u), eq)
    return replace(
        problem,
        output=part,
        output_rest=pointwise(part, eq, tuple(v.nominal for v in model.algebraic)),
        points=np.unique(np.round(times / s.length, 12)) * s.length,  # a node may be a sample but for rounding
        output_scale=np.array([v.nominal for v in model.constraints]),
    )


def _with_algebraic(part: Split, eq: Equations) -> Split:
    """`part` with the states that its algebraic variables depend on among those that phi depends on."""
    if not (eq.z.numel() and part.phi.numel() and ca.depends_on(part.phi, eq.z)):
        return part
    everything = ca.vertcat(part.phi, eq.algebraic)
    states = [i for i, x in enumerate(ca.vertsplit(eq.x)) if ca.depends_on(everything, x)]
    return replace(part, states=states)


def constraints(model: Model, problem: LeastSquares, tube: bool) -> Constraints:
    estimated = (*model.states, *model.unknown_parameters)
    states = [model.states[i] for i in problem.bounded]
    return Constraints(
        lower=np.array([v.min for v in estimated]),
        upper=np.array([v.max for v in estimated]),
        node_lower=np.array([v.min for v in states]),
        node_upper=np.array([v.max for v in states]),
        tube=tube,
        path=bool(model.constraints),
    )
