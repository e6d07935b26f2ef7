"""The least-squares observer with covariance reset of Chen & Yen, "Application of the least squares algorithm to the observer design for
linear time-varying systems", IEEE Trans. Automat. Contr. 44 (9), 1999.

    xhat' = A(t) xhat + B(t) u + L(t) (y - C(t) xhat)                                  (8)
    L = gamma Phi P_o w_o,  w_o = Phi' C',  Phi(t, kT) the transition matrix since kT   (11) to (13)
    P_o' = -gamma P_o w_o w_o' P_o,  P_o(kT) = p0 I                                    (15)

For linear models, time-varying or not; within each interval [kT, (k+1)T) recursive least squares for the state at its start, forgotten at
its end (covariance reset). Symbols are the paper's.

What deviates from the paper, and why:
- Information form: Y = P_o^-1 obeys Y' = gamma w_o w_o', a sum over the samples, Y = I / p0 + gamma sum Ts w_o w_o'. A sample corrects
  xhat by gamma Ts Phi Y^-1 w_o (y - C xhat), with the Y that includes it: the same estimate as that of the sums Y and
  b = gamma sum Ts w_o r, without the reference to the interval's start. The gain form (13) with Runge-Kutta blows up at
  Ts >= 0.125; this does not.
- The integral of w_o w_o' over an interval is summed by the trapezoidal rule: the sample at a reset weighs half in the interval that ends
  and half in the one that begins. On the paper's example, T = 0.25, Ts = 0.01, |e| at 20 s is then 7.15e-6, against 7.16e-6 of the
  continuous observer (scipy, 1e-12); with the whole sample in the new interval it is 7.60e-6, in the old one 6.82e-6, of first order in Ts.
- The lemma's m1^2 is dropped: with the Gramian W referenced to the interval's start, an interval contracts by at most
  mu / (1 + gamma p0 lmin(W)), mu = |Phi((k+1)T, kT)|. Each interval has its own mu and W here; the theorem's mu and alpha1 are the largest
  and the smallest of all. Both that factor and the actual |Phi Y^-1| / p0 are outputs. The first need not be below 1 for convergence: on
  the paper's own example it is not.
- `linearise=True` treats a nonlinear model along the estimate: xhat' = f(xhat, u), A = Df, C = Dh there. The theorem then says nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers import ports
from observers.component import Component, Enumeration, Port
from observers.least_squares.information import contraction, information_update
from observers.linearisation import Linearisation, linearisation, refuse_unobservable
from observers.model import Model, ModelError, refuse
from observers.numerics.finite import HUGE
from observers.numerics.layout import Layout
from observers.numerics.riccati import UNROLLED
from observers.numerics.runge_kutta import runge_kutta

STATUS = Enumeration(
    "LeastSquaresStatus",
    (
        ("propagated_guess", "no sample yet: the estimate is the propagated guess"),
        ("corrected", "the last sample corrected the estimate"),
        (
            "sample_rejected",
            "a measurement was missing or not finite: the estimate is the prediction, or rests on the other outputs",
        ),
        ("solver_failed", "a step was not finite: the estimate was held, a new interval begins"),
    ),
)
CODE = SimpleNamespace(**{item: i for i, (item, _) in enumerate(STATUS.items, start=1)})

STATUS_PORT = ports.status(STATUS)
CONTRACTION = (
    Port(
        "diagnostics.contraction",
        "|Phi Y^-1| / p0 of the last whole interval: no error has grown by more",
        variability="discrete",
    ),
    Port(
        "diagnostics.certified_contraction",
        "mu / (1 + gamma p0 lmin(W)) of the last whole interval, the theorem's bound",
        variability="discrete",
    ),
    Port("diagnostics.intervals", "intervals completed so far", kind="Integer", variability="discrete"),
)


def least_squares(
    model: Model,
    *,
    sample_time: float,
    T: float,
    gamma: float = 1.0,
    p0: float = 1.0,
    linearise: bool = False,
    guess: Mapping[str, float] | None = None,
    name: str | None = None,
    max_step: float = 0.01,
    stop_time: float = 20.0,
) -> Component:
    """The observer for `model` as a component: measurements and known inputs in, `estimate.*` out.

    Args:
        sample_time: start value of the parameter `sample_time`, Ts [s].
        T, gamma, p0: start values of `tuning.T`, the time between resets [s], a whole number of sample times (rounded to one),
            `tuning.gamma`, the least-squares gain, and `tuning.p0`, what P_o is reset to.
        linearise: treat a nonlinear model along its estimate instead of refusing it.
        guess: start values of `guess.*` that differ from the model's.
        name: the component's name; `<model>_least_squares` if absent.
        max_step: the longest prediction step [s] (Dormand-Prince, order 8). Where A(t) switches between samples it bounds the error, which
            is of first order in it; a smooth A(t) allows ten times the default, and a cheaper sample where Ts is longer.
        stop_time: of the default experiment [s].

    Raises:
        ModelError: algebraic variables or unknown disturbances, a state or unknown parameter that no output can ever see, a model that
            is not linear in its states and unknown parameters (without `linearise`).
        ValueError: T, gamma or p0 is not positive, T is shorter than the sample time.
    """
    refuse(model, "least_squares", "algebraic", "unknown_disturbances")
    refuse_unobservable(model, "least_squares")
    period = ports.sample_time("least_squares", sample_time)
    line = linearisation(model)
    if not linearise:
        _refuse_nonlinear(model, line)
    for what, value in (("gamma", gamma), ("p0", p0)):
        if not 0 < value < HUGE:
            raise ValueError(f"least_squares: {what} = {value:g} must be positive and finite")
    if not sample_time <= T < HUGE:
        raise ValueError(f"least_squares: T = {T:g} s must be finite and at least the sample time, {sample_time:g} s")

    n, ny = len(line.variables), len(model.outputs)
    state = Layout(
        x=n, Phi=n * n, Y=n * n, x_filtered=n, samples=1, innovation=ny, status=1, contraction=1, certified=1, intervals=1,
        rejected=1, failures=1,
    )  # fmt: skip
    settings = Layout(guess=n, model=len(model.parameters), T=1, gamma=1, p0=1, sample_time=1)
    z, u, p, t, h = (
        ca.MX.sym(*shape)
        for shape in (("z", state.total), ("u", ports.n_inputs(model)), ("p", settings.total), ("t",), ("h",))
    )
    s, q = state.unpack(z), settings.unpack(p)
    read = ports.read(model, u)
    inner = SimpleNamespace(z=z, y=read.y, u=read.known, offered=read.offered, p=p, t=t, h=h, s=s, q=q, state=state)
    one = ca.vec(ca.DM.eye(n).full())
    start = {part: ca.DM.zeros(size) for part, size in state.sizes.items()} | {
        "x": q.guess,
        "Phi": one,
        "Y": one / q.p0,
        "x_filtered": q.guess,
        "status": ca.DM(CODE.propagated_guess),
    }
    measured = [
        s.x,
        s.x_filtered,
        s.status,
        s.innovation,
        s.contraction,
        s.certified,
        s.intervals,
        s.rejected,
        s.failures,
    ]
    tuned = (
        Port("tuning.T", "time between covariance resets", "s", T, min=1e-6, variability="tunable"),
        Port("tuning.gamma", "least-squares gain", start=gamma, min=1e-12, variability="tunable"),
        Port("tuning.p0", "what P_o is reset to", start=p0, min=1e-12, variability="tunable"),
        period,
    )
    return Component(
        name=name or f"{model.name}_least_squares",
        description=f"Least-squares observer with covariance reset for {model.name} (Chen & Yen 1999)",
        start=ca.Function("start", [p, t], [state.pack(start)]),
        flow=ca.Function("flow", [z, u, p, t, h], [_flow(inner, line)]),
        jump=ca.Function("jump", [z, u, p, t], [_jump(inner, line)]),
        output=ca.Function("output", [z, u, p, t], [ca.vertcat(*measured)]),
        inputs=(*ports.inputs(model), *ports.validity(model)),
        parameters=(*ports.guesses(model, guess or {}), *ports.known_parameters(model), *tuned),
        outputs=(*ports.estimates(model), STATUS_PORT, *ports.innovations(model), *CONTRACTION, *ports.COUNTERS),
        sample_time="sample_time",
        samples_inputs=True,
        max_step=max_step,
        stop_time=stop_time,
        step_size=sample_time,
        counters=tuple(port.name for port in ports.COUNTERS),
        documentation=_documentation(model, linearise),
    )


def _refuse_nonlinear(model: Model, line: Linearisation) -> None:
    """Raise a ModelError that names the first equation which is not linear in states and unknown parameters, and the variable."""
    for group, column, names in (
        ("the rate of", line.f, [v.name for v in line.variables]),
        ("the output", line.h, [v.name for v in model.outputs]),
    ):
        for expression, name in zip(ca.vertsplit(column), names, strict=True):
            bent = ca.which_depends(expression, line.m, 2, False)
            if any(bent):
                variable = line.variables[bent.index(True)].name
                raise ModelError(
                    f"least_squares: model '{model.name}' is not linear: {group} '{name}' is nonlinear in '{variable}' "
                    "(linearise=True treats it along the estimate)"
                )


def _flow(v: SimpleNamespace, line: Linearisation) -> Any:
    """(8) without correction, and (11), over h."""
    s = v.s
    n = len(line.variables)
    rate = ca.Function(
        "moving",
        [moving := ca.SX.sym("moving", n + n * n), line.u, line.p, line.t],
        [
            ca.vertcat(
                line.rate(moving[:n], line.u, line.p, line.t),
                ca.vec(line.jacobian(moving[:n], line.u, line.p, line.t) @ ca.reshape(moving[n:], n, n)),
            )
        ],
    )
    moved = runge_kutta(lambda x, time: rate(x, v.u, v.q.model, time), ca.vertcat(s.x, s.Phi), v.t, v.h)
    finite = ca.sumsqr(moved) < HUGE
    one = ca.DM.eye(n).full().ravel()
    return v.state.replace(
        v.z,
        x=ca.if_else(finite, moved[:n], s.x),
        Phi=ca.if_else(finite, moved[n:], one),
        Y=ca.if_else(finite, s.Y, one / v.q.p0),
        samples=ca.if_else(finite, s.samples, 0),
        status=ca.if_else(finite, s.status, CODE.solver_failed),
        failures=s.failures + ca.logic_not(finite),
    )


def _jump(v: SimpleNamespace, line: Linearisation) -> Any:
    """At t_k: the sample, as the last one of an interval that ends here, then, after the reset, as the first one of the next."""
    s, q = v.s, v.q
    n, ny = len(line.variables), v.y.numel()
    one = ca.DM.eye(n).full().ravel()
    ended = s.samples >= ca.fmax(ca.floor(q.T / q.sample_time + 0.5), 1)
    residual = v.y - line.measure(s.x, v.u, q.model, v.t)
    valid, rejected = ports.judged(residual, v.offered)
    innovation = ca.if_else(valid, residual, 0)

    sample = _sample(line, ny)
    given = (v.u, q.model, v.t, ca.if_else(valid, v.y, 0), valid, q.gamma * q.sample_time)
    at_end = ca.logic_or(ended, s.samples == 0)
    x, Y = sample(s.x, s.Phi, s.Y, *given, ca.if_else(at_end, 0.5, 1))
    x, Phi, Y, factors = _reset(line, sample)(ended, x, s.Phi, Y, *given, q.p0, ca.vertcat(s.contraction, s.certified))
    finite = ca.sumsqr(ca.vertcat(x, Y, factors)) < HUGE
    incomplete = ca.sum1(valid) < ny
    x = ca.if_else(finite, x, s.x)
    return v.state.replace(
        v.z,
        x=x,
        Phi=ca.if_else(finite, Phi, one),
        Y=ca.if_else(finite, Y, one / q.p0),
        x_filtered=x,
        samples=ca.if_else(finite, ca.if_else(ended, 0, s.samples) + 1, 0),
        innovation=innovation,
        status=ca.if_else(incomplete, CODE.sample_rejected, ca.if_else(finite, CODE.corrected, CODE.solver_failed)),
        contraction=ca.if_else(finite, factors[0], s.contraction),
        certified=ca.if_else(finite, factors[1], s.certified),
        intervals=s.intervals + ended,
        rejected=s.rejected + rejected,
        failures=s.failures + ca.logic_not(finite),
    )


def _sample(line: Linearisation, ny: int) -> ca.Function:
    """sample(x, Phi, Y, u, p, t, y, valid, g, weight) -> (x, Y) after a sample of that weight; where `valid` is 0 it has none."""
    n = len(line.variables)
    x, Phi, Y, u, p, t, y, valid, g, weight = (
        ca.MX.sym(*shape)
        for shape in (
            ("x", n), ("Phi", n * n), ("Y", n * n), ("u", line.u.numel()), ("p", line.p.numel()), ("t",), ("y", ny),
            ("valid", ny), ("g",), ("weight",),
        )
    )  # fmt: skip
    C = ca.diag(valid) @ line.gradient(x, u, p, t)
    r = ca.if_else(valid, y - line.measure(x, u, p, t), 0)
    update = information_update(n, ny)
    x_after, Y_after = update(x, ca.reshape(Phi, n, n), ca.reshape(Y, n, n), C, r, weight * g)
    function = ca.Function("sample", [x, Phi, Y, u, p, t, y, valid, g, weight], [x_after, ca.vec(Y_after)])
    return function.expand() if n <= UNROLLED else function


def _reset(line: Linearisation, sample: ca.Function) -> ca.Function:
    """reset(ended, x, Phi, Y, u, p, t, y, valid, g, p0, factors) -> (x, Phi, Y, factors); nothing changes unless `ended`.

    `factors` are the actual and the certified contraction of the interval that ended.
    """
    n = len(line.variables)
    p0, old = ca.MX.sym("p0"), ca.MX.sym("old", 2)
    x, Phi, Y, *given = (ca.MX.sym(sample.name_in(i), sample.numel_in(i)) for i in range(sample.n_in() - 1))
    one = ca.DM.eye(n).full().ravel()
    factors = contraction(n)(ca.reshape(Phi, n, n), ca.reshape(Y, n, n), p0)
    x_new, Y_new = sample(x, one, one / p0, *given, 0.5)
    arguments = [x, Phi, Y, *given, p0, old]
    begin = ca.Function("begin", arguments, [x_new, ca.MX(one), Y_new, factors])
    go_on = ca.Function("go_on", arguments, [x, Phi, Y, old])
    return ca.Function.if_else("reset", begin, go_on)


def _documentation(model: Model, linearise: bool) -> str:
    along = ", linearised along its estimate" if linearise else ""
    return (
        f"<p>Between two resets the samples fit the state of the model {model.name}{along} at the interval's start by recursive "
        "least squares; each reset forgets them (Chen and Yen, IEEE Trans. Automat. Contr., 1999). Connect the measurements and "
        "the known inputs, and step with at most the sample time.</p>"
        "<p><code>diagnostics.contraction</code> is the factor by which the error of the last interval can have grown or shrunk at most, "
        "<code>diagnostics.certified_contraction</code> the theorem's bound of it.</p>"
        "<p><code>diagnostics.status</code> says whether the estimate can be trusted; <code>estimate.*</code> is of the current time, "
        f"<code>filtered.*</code> of the last sample instant.</p>{ports.VALIDITY_HTML}"
    )
