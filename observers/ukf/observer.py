"""The unscented Kalman filter in square-root form, the comparator of Gong, Ross & Kang 2007 and an observer in its own right.

Julier & Uhlmann, "Unscented filtering and nonlinear estimation", Proc. IEEE 92 (3), 2004; in the square-root form of van der Merwe &
Wan, 2001.
2 n + 1 sigma points carry mean and covariance P = S S' through the model:

    X = [x, x + sqrt(n + kappa) S_j, x - sqrt(n + kappa) S_j],   weights kappa / (n + kappa) and 1 / (2 (n + kappa))

What deviates, and why:
- Unknown parameters are appended to the state with zero rate; with a process noise of zero they end up frozen, which is all that "the UKF
  fails" in the paper comes from.
- The points move with the flow, continuously, so that outputs between samples are the mean of their own time.
- kappa >= 0: no weight is negative, and every square root is a QR factorisation of a stack of columns. No Cholesky downdate can fail.
- A measurement that is not finite leaves the correction; the others still act.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers import ports
from observers.component import Component, Enumeration, Port
from observers.linearisation import refuse_unobservable
from observers.model import Model, refuse
from observers.numerics import linear
from observers.numerics.finite import HUGE
from observers.numerics.layout import Layout
from observers.numerics.runge_kutta import runge_kutta, stable_step
from observers.numerics.semilinear import split

STATUS = Enumeration(
    "UkfStatus",
    (
        ("propagated_guess", "no sample yet: the estimate is the propagated guess"),
        ("corrected", "the last sample corrected the estimate"),
        (
            "sample_rejected",
            "a measurement was missing or not finite: the estimate is the prediction, or rests on the other outputs",
        ),
        ("solver_failed", "a step was not finite: the estimate is the guess again, its covariance the initial one"),
    ),
)
CODE = SimpleNamespace(**{item: i for i, (item, _) in enumerate(STATUS.items, start=1)})


def ukf(
    model: Model,
    *,
    sample_time: float,
    process_noise: Mapping[str, float] | None = None,
    measurement_noise: Mapping[str, float] | None = None,
    initial_std: Mapping[str, float] | None = None,
    guess: Mapping[str, float] | None = None,
    name: str | None = None,
    max_step: float = 0.1,
    stop_time: float = 50.0,
) -> Component:
    """The filter for `model` as a component: measurements and known inputs in, `estimate.*` and `diagnostics.std.*` out.

    Args:
        sample_time: start value of the fixed parameter `sample_time`, Ts [s].
        process_noise: start values of `tuning.process_noise.<state or unknown parameter>`, intensity in the variable's unit per
            sqrt(s); 1e-3 of the nominal value if absent.
        measurement_noise: start values of `tuning.measurement_noise.<output>`, standard deviation of a sample; 0.1 of the
            nominal value if absent.
        initial_std: start values of `tuning.initial_std.<...>`, standard deviation of the guess; the nominal value if absent.
        guess: start values of `guess.*` that differ from the model's.
        name: the component's name; `<model>_ukf` if absent.
        max_step: the longest prediction step [s]; shortened where the model's constant linear part is stiff.
        stop_time: of the default experiment [s].

    Raises:
        ModelError: algebraic variables or unknown disturbances, a state or unknown parameter that no output can ever see, a tuning of
            something that is not estimated or measured.
        ValueError: sample_time out of range.
    """
    refuse(model, "ukf", "algebraic", "unknown_disturbances")
    period = ports.sample_time("ukf", sample_time)
    eq = model.equations
    estimated = (*model.states, *model.unknown_parameters)
    refuse_unobservable(model, "ukf")
    noise = ports.deviations("ukf", "process_noise", ports.PROCESS_NOISE, estimated, process_noise, 1e-3)
    sensor = ports.deviations(
        "ukf", "measurement_noise", ports.MEASUREMENT_NOISE, model.outputs, measurement_noise, 0.1
    )
    spread = ports.deviations("ukf", "initial_std", ports.INITIAL_STD, estimated, initial_std, 1.0, "fixed")
    kappa = Port(
        "tuning.kappa",
        "spread of the sigma points, sqrt(n + kappa) deviations",
        start=1.0,
        min=0.0,
        variability="tunable",
    )

    n, ny, nx = len(estimated), len(model.outputs), len(model.states)
    points = 2 * n + 1
    state = Layout(points=n * points, filtered=n, innovation=ny, status=1, rejected=1, failures=1)
    settings = Layout(guess=n, model=len(model.parameters), noise=n, sensor=ny, spread=n, kappa=1, sample_time=1)
    z, u, p = ca.SX.sym("z", state.total), ca.SX.sym("u", ports.n_inputs(model)), ca.SX.sym("p", settings.total)
    t, h = ca.SX.sym("t"), ca.SX.sym("h")
    s, q = state.unpack(z), settings.unpack(p)
    read = ports.read(model, u)
    augmented = ca.Function("rhs", [eq.x, eq.theta, eq.u, eq.p, eq.t], [ca.vertcat(eq.ode, ca.SX.zeros(n - nx))])
    measure = ca.Function("measure", [eq.x, eq.theta, eq.u, eq.p, eq.t], [eq.output])
    parts = Layout(x=nx, theta=n - nx)

    def at(function: ca.Function, x: Any, time: Any) -> Any:
        part = parts.unpack(x)
        return function(part.x, part.theta, read.known, q.model, time)

    weights = ca.vertcat(q.kappa / (n + q.kappa), ca.repmat(1 / (2 * (n + q.kappa)), 2 * n, 1))
    fresh = _points(q.guess, ca.diag(q.spread), q.kappa)
    now = ca.reshape(s.points, n, points)

    # Between samples the points follow the model; where one escapes, all start again from the guess.
    moved = ca.horzcat(*[runge_kutta(lambda x, time: at(augmented, x, time), now[:, i], t, h) for i in range(points)])
    sound = ca.sumsqr(moved) < HUGE
    after = {
        "points": ca.vec(ca.if_else(sound, moved, fresh)),
        "status": ca.if_else(sound, s.status, CODE.solver_failed),
        "failures": s.failures + ca.logic_not(sound),
    }

    # At a sample: the points become mean and square root, process noise is added, and new points see the measurement.
    mean, root = _moments(now, weights, ca.diag(q.noise * ca.sqrt(q.sample_time)))
    drawn = _points(mean, root, q.kappa)
    seen = ca.horzcat(*[at(measure, drawn[:, i], t) for i in range(points)])
    expected = ca.mtimes(seen, weights)
    valid, rejected = ports.judged(read.y, read.offered)
    innovation = ca.if_else(valid, read.y - expected, 0)
    dx, dy = drawn - ca.repmat(mean, 1, points), ca.diag(ca.SX(valid)) @ (seen - ca.repmat(expected, 1, points))
    rooted = ca.diag(ca.sqrt(weights))
    noise_root = ca.diag(ca.if_else(valid, q.sensor, 1))
    Sy = linear.square_root(ca.horzcat(ca.mtimes(dy, rooted), noise_root))
    Pxy = ca.mtimes([dx, ca.diag(weights), dy.T])
    half = linear.right_solve(Sy.T, Pxy)  # Pxy = K Sy Sy': upper triangle Sy' first, then Sy by the transposed problem
    K = linear.left_transposed(Sy, half)
    corrected = mean + ca.mtimes(K, innovation)
    root_after = linear.square_root(
        ca.horzcat(ca.mtimes(dx - ca.mtimes(K, dy), rooted), ca.mtimes([K, ca.diag(ca.SX(valid)), noise_root]))
    )
    redrawn = _points(corrected, root_after, q.kappa)
    finite = ca.sumsqr(redrawn) < HUGE
    result = state.pack(
        {
            "points": ca.vec(ca.if_else(finite, redrawn, fresh)),
            "filtered": ca.if_else(finite, corrected, q.guess),
            "innovation": innovation,
            "status": ca.if_else(
                ca.logic_not(finite),
                CODE.solver_failed,
                ca.if_else(ca.sum1(valid) < ny, CODE.sample_rejected, CODE.corrected),
            ),
            "rejected": s.rejected + rejected,
            "failures": s.failures + ca.logic_not(finite),
        }
    )
    start = {
        "points": ca.vec(fresh),
        "filtered": q.guess,
        "innovation": ca.DM.zeros(ny),
        "status": ca.DM(CODE.propagated_guess),
        "rejected": ca.DM(0),
        "failures": ca.DM(0),
    }
    current = ca.mtimes(now, weights)
    deviation = ca.sqrt(ca.mtimes((now - ca.repmat(current, 1, points)) ** 2, weights))
    return Component(
        name=name or f"{model.name}_ukf",
        description=f"Square-root unscented Kalman filter for {model.name}",
        start=ca.Function("start", [p, t], [state.pack(start)]),
        flow=ca.Function("flow", [z, u, p, t, h], [state.replace(z, **after)], {"cse": True}),
        jump=ca.Function("jump", [z, u, p, t], [result], {"cse": True}),
        output=ca.Function(
            "output",
            [z, u, p, t],
            [ca.vertcat(current, s.filtered, s.status, s.innovation, deviation, s.rejected, s.failures)],
        ),
        inputs=(*ports.inputs(model), *ports.validity(model)),
        parameters=(
            *ports.guesses(model, guess or {}),
            *ports.known_parameters(model),
            *noise,
            *sensor,
            *spread,
            kappa,
            period,
        ),
        outputs=(
            *ports.estimates(model),
            ports.status(STATUS),
            *ports.innovations(model),
            *(
                Port(
                    f"diagnostics.std.{v.name}",
                    f"standard deviation of the estimated {v.description or v.name}",
                    v.unit,
                    nominal=v.nominal,
                )
                for v in estimated
            ),
            *ports.COUNTERS,
        ),
        sample_time="sample_time",
        samples_inputs=True,
        max_step=stable_step(split(eq.ode, eq.x, eq.u).A, max_step),
        stop_time=stop_time,
        step_size=sample_time,
        counters=tuple(port.name for port in ports.COUNTERS),
        documentation=(
            f"<p>A square-root unscented Kalman filter for the model {model.name} (Julier and Uhlmann, Proc. IEEE 92 (3), 2004). "
            "<code>tuning.process_noise.*</code> says how fast each state or unknown parameter may wander away from the model: with 0 an "
            "unknown parameter freezes once it is believed. <code>diagnostics.std.*</code> is the estimate's own standard deviation.</p>"
        ),
    )


def _points(mean: Any, root: Any, kappa: Any) -> Any:
    """The sigma points (n x (2 n + 1)) of mean (n) and root (n x n), P = root root'."""
    n = root.shape[0]
    wide = ca.sqrt(n + kappa) * root
    center = ca.repmat(mean, 1, n)
    return ca.horzcat(mean, center + wide, center - wide)


def _moments(points: Any, weights: Any, noise_root: Any) -> tuple[Any, Any]:
    """Mean (n) of the points and the square root (n x n) of their covariance plus noise_root noise_root'."""
    mean = ca.mtimes(points, weights)
    spread = ca.mtimes(points - ca.repmat(mean, 1, points.shape[1]), ca.diag(ca.sqrt(weights)))
    return mean, linear.square_root(ca.horzcat(spread, noise_root))
