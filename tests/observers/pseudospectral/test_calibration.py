"""Process noise inside the window: over a hundred runs the errors are as large as the observer says."""

import casadi as ca
import numpy as np
import pytest
from scipy.stats import chi2

from advice.streams.native import sampled
from advice.streams.verdicts import Tried, driven
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral

TS = 0.1


def maps(model):
    """The outputs, and the states a sample later, with a noise that is held over it: h(x, u, p, theta, t), move(x, u, p, theta, t, w)."""
    eq = model.equations
    f = ca.Function("f", [eq.x, eq.u, eq.p, eq.theta, eq.t], [eq.ode])
    h = ca.Function("h", [eq.x, eq.u, eq.p, eq.theta, eq.t], [eq.output])
    x, w, p = eq.x, ca.SX.sym("w", eq.x.numel()), eq.p
    step = TS / 10
    for i in range(10):
        rate = lambda a, t: f(a, eq.u, p, eq.theta, t) + w  # noqa: E731
        t = eq.t + i * step
        k1 = rate(x, t)
        k2 = rate(x + step / 2 * k1, t + step / 2)
        k3 = rate(x + step / 2 * k2, t + step / 2)
        x = x + step / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + step * k3, t + step))
    return h, ca.Function("move", [eq.x, eq.u, eq.p, eq.theta, eq.t, w], [x])


def discrete(model, h, move, rng, samples, q, theta_q, x0, theta, noise):
    """A run of the model with noise held over a sample: y (samples, ny), and [x; theta] at each sample."""
    known = [[v.start for v in group] for group in (model.inputs, model.parameters)]
    value, theta, Y, truth = np.array(x0, float), np.array(theta, float), [], []
    for k in range(samples + 1):
        truth.append([*value, *theta])
        clean = h(value, *known, theta, k * TS).full().ravel()
        Y.append(clean + noise * rng.normal(size=clean.size))
        w_now = np.array(q) / np.sqrt(TS) * rng.normal(size=value.size)
        value = move(value, *known, theta, k * TS, w_now).full().ravel()
        theta = theta + np.array(theta_q) * np.sqrt(TS) * rng.normal(size=theta.size)
    return np.array(Y), np.array(truth)


def oscillator():
    return Model(
        name="oscillator",
        states=[Variable("p"), Variable("v")],
        unknown_parameters=[Variable("d")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.v, -x.p - 0.2 * x.v + p.d],
        output=lambda x, u, p, t: [x.p],
    )


def duffing():
    return Model(
        name="duffing",
        states=[Variable("x1"), Variable("x2")],
        unknown_parameters=[Variable("theta")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.x2, x.x1 - x.x1**3 - 0.25 * x.x2 + p.theta * ca.cos(t)],
        output=lambda x, u, p, t: [x.x1 + 0.5 * x.x2],
    )


def chemostat():
    """Biomass X on a substrate S, Monod's growth; X is measured."""
    growth = lambda x, p: p.mu * x.S / (0.5 + x.S)  # noqa: E731
    return Model(
        name="chemostat",
        states=[Variable("X", start=3.0, nominal=2.0, min=0.0), Variable("S", start=2.0, nominal=2.0, min=0.0)],
        unknown_parameters=[Variable("mu", start=0.4, nominal=0.3, min=0.01, max=2.0)],
        outputs=[Variable("y", start=3.0, nominal=2.0)],
        ode=lambda x, u, p, t: [
            (growth(x, p) - 0.2 - 0.1 * ca.sin(t)) * x.X,
            (0.2 + 0.1 * ca.sin(t)) * (10 - x.S) - 2 * growth(x, p) * x.X,
        ],
        output=lambda x, u, p, t: [x.X],
    )


def cell():
    """A lithium-ion cell: state of charge, one RC element, an unknown series resistance."""
    current = lambda t: 3 * ca.sin(0.5 * t) + 1.0  # noqa: E731
    return Model(
        name="cell",
        states=[Variable("soc", start=0.6, nominal=0.5, min=0.0, max=1.0), Variable("v1", nominal=0.05)],
        unknown_parameters=[Variable("R0", start=0.03, nominal=0.03, min=0.0, max=0.2)],
        outputs=[Variable("v", start=3.8, nominal=0.1)],
        ode=lambda x, u, p, t: [-current(t) / 1000, -x.v1 / 40 + current(t) / 2000],
        output=lambda x, u, p, t: [
            3.685 + 0.2156 * x.soc - 0.1178 * x.soc**2 + 0.3201 * x.soc**3 - x.v1 - p.R0 * current(t)
        ],
    )


ENSEMBLES = {
    "oscillator": (oscillator, [0.05, 0.3], [0.2], [1.0, 0.0], [0.3], 0.05, [0.5, 0.5, 0.3]),
    "duffing": (duffing, [0.02, 0.05], [0.05], [1.0, 0.5], [0.4], 0.05, [0.3, 0.3, 0.1]),
    "chemostat": (chemostat, [0.02, 0.02], [0.01], [3.0, 2.0], [0.4], 0.05, [0.5, 0.5, 0.08]),
    "cell": (cell, [1e-3, 1e-3], [1e-3], [0.6, 0.0], [0.03], 0.002, [0.05, 0.01, 0.005]),
}


@pytest.mark.long
@pytest.mark.parametrize("L", [5, 20])
@pytest.mark.parametrize("name", ENSEMBLES)
def test_over_a_hundred_runs_the_errors_are_as_large_as_it_says(name, L):
    """The mean of the squared errors over variances in its 95 % band, for each state and parameter, with Bonferroni's share for three of
    them; +-2 standard deviations cover about 95 %."""
    make, q, theta_q, x0, theta, noise, std = ENSEMBLES[name]
    model, runs, samples = make(), 100, 60
    variables = (*model.states, *model.unknown_parameters)
    names = [v.name for v in variables]
    observer = pseudospectral(
        model,
        sample_time=TS,
        N=4,
        L=L,
        segments=L,
        arrival_cost=True,
        measurement_noise={model.outputs[0].name: noise},
        process_noise=dict(zip(names, [*q, *theta_q], strict=True)),
        initial_std=dict(zip(names, std, strict=True)),
    )
    sample, shown = sampled(observer, TS), [port.name for port in observer.outputs]
    ratios, failures, functions = [], 0.0, maps(model)
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        guess = np.array([*x0, *theta]) + np.array(std) * rng.normal(size=3)
        guess = np.clip(guess, [v.min for v in variables], [v.max for v in variables])
        Y, truth = discrete(model, *functions, rng, samples, q, theta_q, x0, theta, noise)
        tried = Tried(observer, {f"guess.{n}": value for n, value in zip(names, guess, strict=True)}, sample)
        rows, _ = driven(tried, {model.outputs[0].name: np.ravel(Y)[:samples]}, samples, TS)
        estimate, stated = (
            rows[:, [shown.index(f"{branch}.{n}") for n in names]] for branch in ("estimate", "diagnostics.std")
        )
        failures += rows[-1, shown.index("diagnostics.solver_failures")]
        ratios.append((estimate - np.array(truth)[1 : samples + 1]) / stated)
    assert failures <= 10  # of 6000 solves; measured 2, from one guess of the chemostat that is far off, else none
    late = np.array(ratios)[:, samples // 2 :]
    covered = (np.abs(late) < 2).mean(axis=(0, 1))
    # 93 to 97 %, and a standard error of a hundred runs whose samples are correlated: the smallest measured is 92.97 % (chemostat, S).
    assert (covered > 0.92).all() and (covered < 0.98).all(), covered
    nees = (late[:, -1] ** 2).sum(axis=0)
    assert (nees > chi2.ppf(0.025 / 3, runs)).all() and (nees < chi2.ppf(1 - 0.025 / 3, runs)).all(), nees / runs
