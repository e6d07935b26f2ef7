"""The observer of Calvillo-Corona & Alamir, "Towards the construction of a robust optimal observer": elementary problems, solved in turns.

Over the window of the last N samples, states and unknown disturbances are sought that fit the measurements (3). Each state has an
elementary problem (7), (8) of its own, whose controls are the other variables in its equation (`problems`); an iteration solves them
all, independently, and averages what they find for each variable (10) (`iteration`). At each sample instant (`sample`) the window
moves on by one sample, and up to K iterations go on from the trajectories of the last one, until no state changes by more than epsilon.

What deviates from the paper, and why:
- Section 4.1 solves a Hamilton-Jacobi equation always. That is the general level (`hamilton_jacobi`). Where a problem is affine its
  equation is a Riccati equation, solved exactly by one tridiagonal system, and where it is smooth by Gauss-Newton steps on the same
  (`scalar_gauss_newton`).
- The paper claims convergence in 2 to 5 iterations. With its weights it is linear with a ratio of 2/3, (1 + w1) / 2 with
  w1 = (1 / r1) / (1 / r1 + 1 / r2): 23 iterations to its epsilon. And x2 + c, v - c is a one-parameter family of fixed points:
  `diagnostics.null.*` names such a direction (`identifiability`), bounds on a disturbance can resolve it.
- A disturbance in an output has a problem of that output (`output_problem`), of which (8) says nothing.
- A disturbance is constant on each sample interval; (2)'s bounds may be any box. An unknown parameter, which the paper has none of, is a
  state that does not move.
- The trajectories are compared with the equations by Hermite's rule over each interval, not by splines through the window: exact across the
  jumps of held inputs.
- A state that is measured directly starts the iterations at its measurement, any other one at the prediction.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers import judgement, ports, undo
from observers.arguments import checked
from observers.component import Component, Port
from observers.elementary import ports as elementary_ports
from observers.elementary.identifiability import describe as describe_null
from observers.elementary.iteration import iterations
from observers.elementary.problems import METHOD, decompose, with_constants
from observers.elementary.problems import describe as describe_problems
from observers.elementary.sample import jump, symbols
from observers.linearisation import prediction_step, refuse_unobservable
from observers.model import Model
from observers.numerics.finite import HUGE
from observers.numerics.layout import Layout
from observers.numerics.runge_kutta import runge_kutta
from observers.refusal import not_imposed
from observers.status import CODE
from observers.status import shown as verdict


@checked
def elementary(
    model: Model,
    *,
    sample_time: float,
    N: int,
    K: int = 5,
    q: Mapping[str, float] | None = None,
    r: Mapping[str, Mapping[str, float]] | None = None,
    weights: Mapping[str, Mapping[str, float]] | None = None,
    levels: Mapping[str, str] | None = None,
    nodes: int = 81,
    first_guess: Model | None = None,
    measurement_noise: Mapping[str, float] | None = None,
    guess: Mapping[str, float] | None = None,
    name: str | None = None,
    max_step: float = 0.05,
    stop_time: float = 20.0,
) -> Component:
    """The observer for `model` as a component: measurements and known inputs in, `estimate.*` of states and disturbances out.

    The arguments that all observers share are described in `observers.ports`; s is the paper's name of the sample time, a guess may be one
    of a disturbance too.

    Args:
        N: samples in the window, which is (N - 1) s long. K: most iterations a sample.
        q, r, weights: start values of `tuning.q.<state>` (8), `tuning.r.<state>.<control>` (8) and
            `tuning.weight.<variable>.<state>` (10) that are not 1.
        levels: by state, "lq", "gauss_newton" or "grid" instead of the cheapest level that the equation allows.
        nodes: of the grid, between the state's bounds.
        first_guess: equations that make the first trajectories, of the same variables as `model`. With them the observer waits for a full
            window, as the paper does; without, the window grows from the first sample on.
        measurement_noise: start values of `tuning.measurement_noise.<output>`, the standard deviation of a sample, by which innovations and
            the fit are judged; a hundredth of the nominal value if absent.

    Raises:
        ModelError: algebraic variables, a state or unknown parameter that no output can ever see.
        ValueError: sample_time, N, K, nodes, a weight or a level out of range, a grid without bounds, a first guess of other variables.
    """
    _check_options(model, N, K, nodes, first_guess)
    model, first_guess = with_constants(model), first_guess and with_constants(first_guess)
    period = ports.sample_time(METHOD, sample_time)
    problems = decompose(model, levels or {})
    refuse_unobservable(model, METHOD)
    weighed = elementary_ports.tuning(model, problems, q or {}, r or {}, weights or {})
    settings = Layout(
        guess=len(model.states),
        guess_w=len(model.unknown_disturbances),
        model=len(model.parameters),
        tuning=len(weighed),
        epsilon=1,
        iteration_limit=1,
        visibility_limit=1,
        noise=len(model.outputs),
        false_alarm=1,
        sample_time=1,
    )
    v = symbols(model, N, settings)
    s = v.s
    shown = [
        s.x,
        v.w,
        s.x_filtered,
        v.w,
        verdict(s.status),
        s.cost,
        s.iterations,
        s.change,
        s.contraction,
        s.visibility,
    ]
    shown += [s.null, s.innovation, s.rejected, s.failures, s.restarts]
    sampled = jump(v, model, N, iterations(model, problems, N, K, nodes), first_guess is not None)
    null = describe_null(model, N, sample_time)
    return Component(
        name=name or f"{model.name}_elementary",
        description=f"Observer by elementary problems for {model.name} (Calvillo-Corona & Alamir), N = {N}, K = {K}",
        start=ca.Function("start", [v.p, v.t], [_start(v, N)]),
        flow=ca.Function("flow", [v.z, v.u, v.p, v.t, v.h], [_flow(v, model, first_guess, N)]),
        jump=ca.Function("jump", [v.z, v.u, v.p, v.t], [sampled]),
        output=ca.Function("output", [v.z, v.u, v.p, v.t], [ca.vertcat(*shown)]),
        inputs=(*ports.inputs(model), *ports.validity(model)),
        parameters=(
            *elementary_ports.guesses(model, guess or {}),
            *ports.known_parameters(model),
            *weighed,
            *elementary_ports.limits(K),
            *judgement.tuning(METHOD, model, measurement_noise, 1e-2),
            period,
        ),
        outputs=(
            *elementary_ports.estimates(model),
            *elementary_ports.DIAGNOSTICS,
            *elementary_ports.null_direction(model),
            *ports.innovations(model),
            *ports.COUNTERS,
            ports.RESTARTS,
        ),
        constants=tuple(
            Port(f"structure.{what}", text, start=value, kind="Integer", variability="constant", local=True)
            for what, text, value in (("N", "samples in the window", N), ("K", "most iterations a sample", K))
        ),
        sample_time="sample_time",
        samples_inputs=True,
        max_step=prediction_step(model, max_step),
        stop_time=stop_time,
        step_size=sample_time,
        counters=tuple(port.name for port in (*ports.COUNTERS, ports.RESTARTS)),
        documentation=elementary_ports.documentation(model, N, describe_problems(model, problems), null)
        + not_imposed(model),
    )


def _check_options(model: Model, N: int, K: int, nodes: int, first_guess: Model | None) -> None:
    for what, value, least in (("N", N, 3), ("K", K, 1), ("nodes", nodes, 6)):
        if not isinstance(value, int) or value < least:
            raise ValueError(f"{METHOD}: {what} = {value!r} must be a whole number of at least {least}")
    if first_guess is not None and _variables(first_guess) != _variables(model):
        raise ValueError(
            f"{METHOD}: first_guess '{first_guess.name}' and model '{model.name}' have different variables"
        )


def _variables(model: Model) -> list[list[str]]:
    known = (model.states, model.inputs, model.outputs, model.parameters)
    return [[v.name for v in group] for group in (*known, model.unknown_parameters, model.unknown_disturbances)]


def _start(v: SimpleNamespace, N: int) -> Any:
    """A window full of the guess, of which no sample is there yet."""
    c = v.c
    return v.state.pack(
        {part: ca.DM.zeros(size) for part, size in v.state.sizes.items()}
        | {
            "x": c.guess,
            "x_filtered": c.guess,
            "before": c.guess,
            "X": ca.repmat(c.guess, N, 1),
            "W": ca.repmat(c.guess_w, N - 1, 1) if v.w.numel() else ca.MX(0, 1),
            "model": c.model,
            "status": ca.DM(CODE.propagated_guess),
        }
    )


def _flow(v: SimpleNamespace, model: Model, first_guess: Model | None, N: int) -> Any:
    """Between samples the estimate follows the model, before the window is full its first guess.

    Where it escapes, the last sample is undone; a prediction that escapes by itself starts again from the guess.
    """
    s, c = v.s, v.c

    def moved(of: Model) -> Any:
        e = of.equations
        rhs = ca.Function("rhs", [e.x, e.u, e.w, e.p, e.t], [e.ode])
        return runge_kutta(lambda x, time: rhs(x, v.read.known, v.w, c.model, time), s.x, v.t, v.h)

    after = moved(model)
    if first_guess is not None:
        after = ca.if_else(s.samples < N, moved(first_guess), after)
    finite = ca.sumsqr(after) < HUGE
    back, told = undo.escaped(s, c.guess, finite)
    return v.state.replace(
        v.z,
        x=ca.if_else(finite, after, back),
        X=ca.if_else(finite, s.X, ca.repmat(back, N, 1)),
        input_integral=s.input_integral + v.h * v.read.known,
        samples=ca.if_else(finite, s.samples, 0),
        **told,
    )
