"""The observer of Calvillo-Corona & Alamir, "Towards the construction of a robust optimal observer": elementary problems, solved in turns.

Over the window of the last N samples, states and unknown disturbances are sought that fit the measurements (3). Each state has an
elementary problem (7), (8) of its own, whose controls are the other variables in its equation (`problems`); an iteration solves them
all, independently, and averages what they find for each variable (10) (`iteration`). At each sample instant the window moves
on by one sample, and up to K iterations go on from the trajectories of the last one, until no state changes by more than epsilon.

What deviates from the paper, and why:
- Section 4.1 solves a Hamilton-Jacobi equation always. That is the general level (`hamilton_jacobi`). Where a problem is affine
its
  equation is a Riccati equation, solved exactly by one tridiagonal system, and where it is smooth by Gauss-Newton steps on the same
  (`scalar_gauss_newton`).
- The paper claims convergence in 2 to 5 iterations. With its weights it is linear with a ratio of 2/3, (1 + w1) / 2 with
  w1 = (1 / r1) / (1 / r1 + 1 / r2): 23 iterations to its epsilon. And x2 + c, v - c is a one-parameter family of fixed points:
  `diagnostics.null.*` names such a direction (`identifiability`), bounds on a disturbance can resolve it.
- A disturbance is constant on each sample interval; (2)'s bounds may be any box.
- The trajectories are compared with the equations by Hermite's rule over each interval, not by splines through the window: exact across the
  jumps of held inputs.
- A state that is measured directly starts the iterations at its measurement, any other one at the prediction.
"""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers import ports
from observers.component import Component, Port
from observers.elementary import ports as elementary_ports
from observers.elementary.columns import repeated
from observers.elementary.identifiability import describe as describe_null
from observers.elementary.identifiability import least_visible
from observers.elementary.iteration import active_nodes, iterations
from observers.elementary.ports import CODE
from observers.elementary.problems import METHOD, decompose
from observers.elementary.problems import describe as describe_problems
from observers.linearisation import refuse_unobservable
from observers.model import Model
from observers.numerics.finite import HUGE
from observers.numerics.layout import Layout
from observers.numerics.runge_kutta import runge_kutta


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
    guess: Mapping[str, float] | None = None,
    name: str | None = None,
    max_step: float = 0.05,
    stop_time: float = 20.0,
) -> Component:
    """The observer for `model` as a component: measurements and known inputs in, `estimate.*` of states and disturbances out.

    Args:
        sample_time: start value of the parameter `sample_time`, s [s].
        N: samples in the window, which is (N - 1) s long. K: most iterations a sample.
        q, r, weights: start values of `tuning.q.<state>` (8), `tuning.r.<state>.<control>` (8) and `tuning.weight.<variable>.<state>`
        (10) that
            are not 1.
        levels: by state, "lq", "gauss_newton" or "grid" instead of the cheapest level that the equation allows.
        nodes: of the grid, between the state's bounds.
        first_guess: equations that make the first trajectories, of the same variables as `model`. With them the observer waits for a full
        window, as
            the paper does; without, the window grows from the first sample on.
        guess: start values of `guess.*` that differ from the model's.
        name: the component's name; `<model>_elementary` if absent.
        max_step: the longest prediction step [s] (Dormand-Prince, order 8).
        stop_time: of the default experiment [s].

    Raises:
        ModelError: algebraic variables or unknown parameters, a state that no output can ever see.
        ValueError: N, K, nodes, a weight or a level out of range, a grid without bounds, a first guess of other variables.
    """
    for what, value, least in (("N", N, 3), ("K", K, 1), ("nodes", nodes, 6)):
        if not isinstance(value, int) or value < least:
            raise ValueError(f"{METHOD}: {what} = {value!r} must be a whole number of at least {least}")
    problems = decompose(model, levels or {})
    refuse_unobservable(model, METHOD)
    if first_guess is not None and _variables(first_guess) != _variables(model):
        raise ValueError(
            f"{METHOD}: first_guess '{first_guess.name}' and model '{model.name}' have different variables"
        )
    n, k, ny, nu = (
        len(model.states),
        len(model.unknown_disturbances),
        len(model.outputs),
        len(model.inputs),
    )
    held = model.input_between_samples == "held"
    state = Layout(
        x=n,  # the prediction: the estimate of the current time
        x_filtered=n,
        X=n * N,  # the window: states, disturbances, measurements (oldest first) and their weights (0: rejected)
        W=k * (N - 1),
        Y=ny * N,
        V=ny * N,
        means=nu * (N - 1) if held else 0,  # known inputs: means over the intervals
        u=nu * N if not held or _sees_inputs(model) else 0,  # and values at the samples
        input_integral=nu,
        samples=1,  # in the window before the present one
        changed=1,  # samples until a changed model parameter has left the window
        model=len(model.parameters),
        innovation=ny,
        null=n + k,
        status=1,
        cost=1,
        iterations=1,
        change=1,
        contraction=1,
        visibility=1,
        rejected=1,
        failures=1,
    )
    weighed = elementary_ports.tuning(model, problems, q or {}, r or {}, weights or {})
    guessed = elementary_ports.guesses(model, guess or {})
    settings = Layout(
        guess=n,
        guess_w=k,
        model=len(model.parameters),
        tuning=len(weighed),
        epsilon=1,
        visibility_limit=1,
        sample_time=1,
    )
    z, u, p, t, h = (
        ca.MX.sym(*shape)
        for shape in (("z", state.total), ("u", ports.n_inputs(model)), ("p", settings.total), ("t",), ("h",))
    )
    s, c = state.unpack(z), settings.unpack(p)
    read = ports.read(model, u)
    inner = SimpleNamespace(
        z=z, y=read.y, u=read.known, offered=read.offered, p=p, t=t, s=s, c=c, state=state, held=held
    )
    w_now = s.W[s.W.numel() - k :] if k else ca.MX(0, 1)

    def moved(of: Model) -> Any:
        e = of.equations
        rhs = ca.Function("rhs", [e.x, e.u, e.w, e.p, e.t], [e.ode])
        return runge_kutta(lambda x, time: rhs(x, inner.u, w_now, c.model, time), s.x, t, h)

    after = moved(model)
    if first_guess is not None:
        after = ca.if_else(s.samples < N, moved(first_guess), after)
    finite = ca.sumsqr(after) < HUGE
    flowed = state.replace(
        z,
        x=ca.if_else(finite, after, c.guess),
        input_integral=s.input_integral + h * inner.u,
        samples=ca.if_else(finite, s.samples, 0),
        status=ca.if_else(finite, s.status, CODE.solver_failed),
        failures=s.failures + ca.logic_not(finite),
    )
    start = {part: ca.DM.zeros(size) for part, size in state.sizes.items()} | {
        "x": c.guess,
        "x_filtered": c.guess,
        "X": ca.repmat(c.guess, N, 1),
        "W": ca.repmat(c.guess_w, N - 1, 1) if k else ca.MX(0, 1),
        "model": c.model,
        "status": ca.DM(CODE.propagated_guess),
    }
    measured = [s.x, w_now, s.x_filtered, w_now, s.status, s.cost, s.iterations, s.change, s.contraction, s.visibility]
    measured += [s.null, s.innovation, s.rejected, s.failures]
    iterate = iterations(model, problems, N, K, nodes)
    interval = ports.sample_time(METHOD, sample_time)
    null = describe_null(model, N, sample_time)
    return Component(
        name=name or f"{model.name}_elementary",
        description=f"Observer by elementary problems for {model.name} (Calvillo-Corona & Alamir), N = {N}, K = {K}",
        start=ca.Function("start", [p, t], [state.pack(start)]),
        flow=ca.Function("flow", [z, u, p, t, h], [flowed]),
        jump=ca.Function("jump", [z, u, p, t], [_jump(inner, model, N, iterate, first_guess is not None)]),
        output=ca.Function("output", [z, u, p, t], [ca.vertcat(*measured)]),
        inputs=(*ports.inputs(model), *ports.validity(model)),
        parameters=(*guessed, *ports.known_parameters(model), *weighed, *elementary_ports.LIMITS, interval),
        outputs=(
            *elementary_ports.estimates(model),
            *elementary_ports.DIAGNOSTICS,
            *elementary_ports.null_direction(model),
            *ports.innovations(model),
            *ports.COUNTERS,
        ),
        constants=tuple(
            Port(f"structure.{what}", text, start=value, kind="Integer", variability="constant", local=True)
            for what, text, value in (("N", "samples in the window", N), ("K", "most iterations a sample", K))
        ),
        sample_time="sample_time",
        samples_inputs=True,
        max_step=max_step,
        stop_time=stop_time,
        step_size=sample_time,
        counters=tuple(port.name for port in ports.COUNTERS),
        documentation=_documentation(model, N, describe_problems(model, problems), null),
    )


def _variables(model: Model) -> list[list[str]]:
    groups = (model.states, model.inputs, model.outputs, model.parameters, model.unknown_disturbances)
    return [[v.name for v in group] for group in groups]


def _sees_inputs(model: Model) -> bool:
    return bool(model.inputs) and bool(ca.depends_on(model.equations.output, model.equations.u))


def _jump(v: SimpleNamespace, model: Model, N: int, iterate: ca.Function, waits: bool) -> Any:
    """At t_k: the sample joins the window, the iterations go on, the window's end is the estimate."""
    s, c, eq = v.s, v.c, model.equations
    n, k, ny, nu = len(model.states), len(model.unknown_disturbances), len(model.outputs), len(model.inputs)
    measure = ca.Function("measure", [eq.x, eq.u, eq.p, eq.t], [ca.densify(eq.output)])
    valid, rejected = ports.judged(v.y, v.offered)
    y = ca.if_else(valid, v.y, 0)
    innovation = ca.if_else(valid, v.y - measure(s.x, v.u, c.model, v.t), 0)

    def moved_on(column: Any, rows: int, new: Any) -> Any:
        return ca.reshape(ca.vertcat(column[rows:], new), rows, column.numel() // rows) if rows else ca.MX(0, N)

    # The iterations start from the last ones, moved on by one sample.
    newest = ca.vertsplit(s.x)
    for j in range(n):
        for m in range(ny):
            if ca.is_equal(eq.output[m], eq.x[j]):
                newest[j] = ca.if_else(valid[m], y[m], newest[j])
    X = moved_on(s.X, n, ca.vertcat(*newest))
    W = moved_on(s.W, k, s.W[s.W.numel() - k :]) if k else ca.MX(0, N - 1)
    Y, V = moved_on(s.Y, ny, y), moved_on(s.V, ny, valid)
    means = moved_on(s.means, nu, s.input_integral / c.sample_time) if s.means.numel() else ca.MX(nu, N - 1)
    at_samples = moved_on(s.u, nu, v.u) if s.u.numel() else ca.MX(nu, N)
    u0, u1 = (means, means) if v.held else (at_samples[:, :-1], at_samples[:, 1:])
    active = N - 1 - s.samples <= ca.DM(range(N - 1)).T
    window = [Y, V, u0, u1, at_samples, active, v.t, c.sample_time, c.model]

    full = s.samples >= N - 1
    enough = full if waits else s.samples >= 1
    due = ca.logic_and(enough, ca.sum1(valid) > 0)
    X_new, W_new, change, contraction, iterations = iterate(due, X, W, *window, c.tuning, c.epsilon)
    finite = ca.sumsqr(ca.vertcat(ca.vec(X_new), ca.vec(W_new))) < HUGE
    failed, accepted = ca.logic_and(due, ca.logic_not(finite)), ca.logic_and(due, finite)
    X, W = ca.if_else(accepted, X_new, X), ca.if_else(accepted, W_new, W)
    x = ca.if_else(accepted, X[:, N - 1], s.x)
    seen = least_visible(model, N)(X, W, *window)
    visibility, null = (
        ca.if_else(accepted, found, old) for found, old in zip(seen, (s.visibility, s.null), strict=True)
    )

    times = v.t + c.sample_time * ca.DM(range(1 - N, 1)).T
    nominal = ca.repmat(ca.DM([o.nominal for o in model.outputs]), 1, N)
    residual = (Y - measure.map(N)(X, at_samples, repeated(c.model, N), times)) / nominal
    cost = ca.sumsqr(active_nodes(active, ny) * V * residual)

    altered = ca.logic_and(s.samples > 0, ca.sumsqr(c.model - s.model) > 0) if len(model.parameters) else 0
    changed = ca.if_else(altered, N - 1, ca.fmax(s.changed - 1, 0))
    status = ca.if_else(full, CODE.converged, CODE.growing_window)
    for condition, code in (
        (change > c.epsilon, CODE.iterating),
        (ca.sum1(valid) < ny, CODE.sample_rejected),
        (changed > 0, CODE.parameter_changed),
        (visibility < c.visibility_limit, CODE.undetermined),
        (failed, CODE.solver_failed),
        (ca.logic_not(enough), CODE.propagated_guess),
        (ca.sum1(valid) == 0, CODE.sample_rejected),
    ):
        status = ca.if_else(condition, code, status)

    return v.state.pack(
        {
            "x": x,
            "x_filtered": x,
            "X": ca.if_else(failed, ca.repmat(s.x, N, 1), ca.vec(X)),
            "W": ca.vec(W),
            "Y": ca.vec(Y),
            "V": ca.vec(V),
            "means": ca.vec(means) if s.means.numel() else ca.MX(0, 1),
            "u": ca.vec(at_samples) if s.u.numel() else ca.MX(0, 1),
            "input_integral": ca.MX.zeros(nu),
            "samples": ca.if_else(failed, 0, ca.fmin(s.samples + 1, N)),
            "changed": changed,
            "model": c.model,
            "innovation": innovation,
            "null": null,
            "status": status,
            "cost": ca.if_else(failed, s.cost, cost),
            "iterations": iterations,
            "change": ca.if_else(finite, change, 0),
            "contraction": ca.if_else(finite, contraction, 0),
            "visibility": visibility,
            "rejected": s.rejected + rejected,
            "failures": s.failures + failed,
        }
    )


def _documentation(model: Model, N: int, problems: list[str], null: str) -> str:
    listed = "".join(f"<li>{escape(line)}</li>" for line in problems)
    open_ = (
        f"<p>Not determined by a window, along the model's own motion: {escape(null)}. <code>diagnostics.null.*</code> shows such a "
        "direction, <code>diagnostics.visibility</code> how little the measurements see of it; bounds on the disturbance can determine it."
        "</p>"
        if null
        else ""
    )
    return (
        f"<p>States and unknown disturbances of the model {model.name} that fit the last {N} samples, by elementary problems: one scalar "
        "optimal control problem for each state, solved in turns (Calvillo-Corona and Alamir). Connect the measurements and the known "
        f"inputs, and step with at most the sample time.</p><ul>{listed}</ul>{open_}"
        "<p><code>diagnostics.status</code> says whether the estimate can be trusted; <code>estimate.*</code> is of the current time, "
        "<code>filtered.*</code> of the last sample instant. A disturbance is the mean over the last sample interval.</p>"
        f"{ports.VALIDITY_HTML}"
    )
