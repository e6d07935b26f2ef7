"""What the observer by elementary problems does at a sample instant, step by step, and the state it works on."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers import judgement, ports, undo
from observers.elementary.columns import repeated
from observers.elementary.identifiability import least_visible
from observers.elementary.iteration import acting, measure
from observers.elementary.output_problem import at_samples, explained
from observers.model import Model
from observers.numerics.consistency import chi_square_quantile
from observers.numerics.finite import HUGE, finite, kept
from observers.numerics.layout import Layout
from observers.status import CODE, worst


def layout(model: Model, N: int) -> Layout:
    """The observer's state."""
    n, k, ny, nu = len(model.states), len(model.unknown_disturbances), len(model.outputs), len(model.inputs)
    held = model.input_between_samples == "held"
    return Layout(
        x=n,  # the prediction: the estimate of the current time
        x_filtered=n,
        X=n * N,  # the window: states, disturbances, measurements (oldest first) and their weights (0: rejected)
        W=k * (N - 1),
        Y=ny * N,
        V=ny * N,
        before=n,  # the prediction at the last sample, before it acted
        undoable=1,  # whether to go back to it is worth a try
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
        **judgement.memory(model),
        doubted=1,  # samples until those that contradicted the estimate have left the window
        rejected=1,
        failures=1,
        restarts=1,
    )


def symbols(model: Model, N: int, settings: Layout) -> SimpleNamespace:
    """z, u, p, t, h; `state` (the layout of z), `s` and `c` (the parts of z and p); `read` (the parts of u); `w`: the disturbances now."""
    state, k = layout(model, N), len(model.unknown_disturbances)
    z, u, p, t, h = (
        ca.MX.sym(*shape)
        for shape in (("z", state.total), ("u", ports.n_inputs(model)), ("p", settings.total), ("t",), ("h",))
    )
    s = state.unpack(z)
    w = s.W[s.W.numel() - k :] if k else ca.MX(0, 1)
    return SimpleNamespace(
        z=z, u=u, p=p, t=t, h=h, state=state, s=s, c=settings.unpack(p), read=ports.read(model, u), w=w
    )


def jump(v: SimpleNamespace, model: Model, N: int, iterate: ca.Function, waits: bool) -> Any:
    """At t_k: the sample joins the window, the iterations go on, the window's end is the estimate."""
    s, c, ny, shown = v.s, v.c, len(model.outputs), measure(model)

    # 1. The sample joins the window; the iterations start from the last ones, moved on by one sample.
    # A disturbance in an output is what the sample says that it is: an innovation is what none within its bounds explains.
    now, explain = (v.read.known, c.model, v.t), explained(model)
    expected, of_guess = (
        shown(x, explain(x, w, kept(v.read.y, 0), v.read.offered * finite(v.read.y), *now), *now)
        for x, w in ((s.x, v.w), (c.guess, c.guess_w))
    )
    sample = judgement.judged(model, s, v.read.y, v.read.offered, expected, of_guess, c.noise, c.false_alarm)
    # A prediction that rests on the first guess alone says nothing of the samples.
    solved = s.samples >= (N if waits else 2)
    kept_judgement = {part: ca.if_else(solved, value, 0) for part, value in sample.memory.items()}
    valid = sample.valid
    moved = _window(v, model, N, sample)
    window = [moved.Y, moved.V, moved.u0, moved.u1, moved.at_samples, moved.active, v.t, c.sample_time, c.model]

    # 2. The iterations, where there is something to iterate on.
    full = s.samples >= N - 1
    enough = full if waits else s.samples >= 1
    due = ca.logic_and(enough, ca.sum1(valid) > 0)
    X_new, W_new, change, contraction, iterations = iterate(
        due, moved.X, moved.W, *window, c.tuning, c.epsilon, c.iteration_limit
    )
    sound = ca.sumsqr(ca.vertcat(ca.vec(X_new), ca.vec(W_new))) < HUGE
    failed, accepted = ca.logic_and(due, ca.logic_not(sound)), ca.logic_and(due, sound)
    X, W = ca.if_else(accepted, X_new, moved.X), ca.if_else(accepted, W_new, moved.W)
    # A failure begins a new window at the prediction, or, where that left the domain of h, at the one before the last sample. What fails
    # again before that window is full, or predicts worse than the guess, starts from the guess.
    undone, stuck = undo.at_sample(s, ca.logic_not(sample.readable))
    again = ca.logic_or(ca.logic_and(failed, ca.logic_not(full)), stuck)
    again = ca.logic_or(again, kept_judgement["outpredicted"] >= judgement.PATIENCE)
    restarted = ca.logic_or(ca.logic_or(failed, undone), again)
    left = ca.if_else(again, c.guess, ca.if_else(undone, s.before, s.x))
    x = ca.if_else(ca.logic_and(accepted, ca.logic_not(restarted)), X[:, N - 1], left)

    # 3. What the window does not see, and how well it fits.
    seen = least_visible(model, N)(X, W, *window)
    visibility, null = (
        ca.if_else(accepted, found, old) for found, old in zip(seen, (s.visibility, s.null), strict=True)
    )
    times = v.t + c.sample_time * ca.DM(range(1 - N, 1)).T
    apart = acting(model, moved.active) * moved.V
    residual = apart * (moved.Y - shown.map(N)(X, at_samples(W), moved.at_samples, repeated(c.model, N), times))
    cost = ca.sumsqr(residual / ca.repmat(ca.DM([o.nominal for o in model.outputs]), 1, N))
    squared = ca.sumsqr(residual / ca.repmat(c.noise, 1, N))
    misfit = ca.logic_not(squared <= chi_square_quantile(ca.fmax(ca.sum1(ca.sum2(apart)), 1), c.false_alarm))

    # 4. What is to be said of it. Iterations that change less than the samples' noise have nothing left to find.
    unfinished = change > ca.fmax(c.epsilon, ca.mmin(c.noise / ca.DM([o.nominal for o in model.outputs])))
    altered = ca.logic_and(s.samples > 0, ca.sumsqr(c.model - s.model) > 0) if len(model.parameters) else 0
    changed = ca.if_else(altered, N - 1, ca.fmax(s.changed - 1, 0))
    contradicted = ca.logic_or(
        ca.logic_and(solved, sample.contradiction), ca.logic_or(ca.logic_and(accepted, misfit), restarted)
    )
    doubted = ca.if_else(contradicted, N, ca.fmax(s.doubted - 1, 0))
    status = worst(
        (sample.outlier, CODE.outlier),
        (ca.sum1(sample.offered) < ny, CODE.sample_rejected),
        (ca.logic_not(full), CODE.settling),
        (unfinished, CODE.iterating),
        (changed > 0, CODE.parameter_changed),
        (doubted > 0, CODE.inconsistent),
        (visibility < c.visibility_limit, CODE.undetermined),
        (failed, CODE.solver_failed),
        (ca.logic_not(enough), CODE.propagated_guess),
    )
    k = len(model.unknown_disturbances)
    return v.state.pack(
        {
            "x": x,
            "x_filtered": x,
            "before": left,
            "undoable": undo.undoable(s, undone, again),
            "X": ca.if_else(restarted, ca.repmat(left, N, 1), ca.vec(X)),
            "W": ca.if_else(again, ca.repmat(c.guess_w, N - 1, 1), ca.vec(W)) if k else ca.MX(0, 1),
            "Y": ca.vec(moved.Y),
            "V": ca.vec(moved.V),
            "means": ca.vec(moved.means) if s.means.numel() else ca.MX(0, 1),
            "u": ca.vec(moved.at_samples) if s.u.numel() else ca.MX(0, 1),
            "input_integral": ca.MX.zeros(len(model.inputs)),
            "samples": ca.if_else(restarted, 0, ca.fmin(s.samples + 1, N)),
            "changed": changed,
            "model": c.model,
            "innovation": sample.innovation,
            "null": kept(null, s.null),
            "status": status,
            "cost": kept(ca.if_else(failed, s.cost, cost), s.cost),
            "iterations": iterations,
            "change": kept(ca.if_else(sound, change, 0), 0),
            "contraction": kept(ca.if_else(sound, contraction, 0), 0),
            "visibility": kept(visibility, s.visibility),
            "doubted": doubted,
            **{part: ca.if_else(again, 0, value) for part, value in kept_judgement.items()},
            "rejected": s.rejected + sample.rejected,
            "failures": s.failures + failed,
            "restarts": s.restarts + again,
        }
    )


def _window(v: SimpleNamespace, model: Model, N: int, sample: judgement.Judgement) -> SimpleNamespace:
    """The window moved on by one sample: X, W, Y, V, the inputs (`means`, `at_samples`, and `u0`, `u1` of each interval) and `active`."""
    s, eq = v.s, model.equations
    n, k, ny, nu = len(model.states), len(model.unknown_disturbances), len(model.outputs), len(model.inputs)

    def moved_on(column: Any, rows: int, new: Any) -> Any:
        return ca.reshape(ca.vertcat(column[rows:], new), rows, column.numel() // rows) if rows else ca.MX(0, N)

    y, valid = sample.y, sample.valid
    newest = ca.vertsplit(s.x)
    for j in range(n):
        for m in range(ny):
            if ca.is_equal(eq.output[m], eq.x[j]):
                newest[j] = ca.if_else(valid[m], y[m], newest[j])
    means = moved_on(s.means, nu, s.input_integral / v.c.sample_time) if s.means.numel() else ca.MX(nu, N - 1)
    at_samples = moved_on(s.u, nu, v.read.known) if s.u.numel() else ca.MX(nu, N)
    held = model.input_between_samples == "held"
    return SimpleNamespace(
        X=moved_on(s.X, n, ca.vertcat(*newest)),
        W=moved_on(s.W, k, v.w) if k else ca.MX(0, N - 1),
        Y=moved_on(s.Y, ny, y),
        V=moved_on(s.V, ny, valid),
        means=means,
        at_samples=at_samples,
        u0=means if held else at_samples[:, :-1],
        u1=means if held else at_samples[:, 1:],
        active=N - 1 - s.samples <= ca.DM(range(N - 1)).T,
    )


def _sees_inputs(model: Model) -> bool:
    return bool(model.inputs) and bool(ca.depends_on(model.equations.output, model.equations.u))
