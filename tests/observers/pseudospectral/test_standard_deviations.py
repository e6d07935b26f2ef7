"""`diagnostics.std.*`: the covariance of textbook filters and least squares on linear models; calibrated on others, over many runs."""

import casadi as ca
import numpy as np
import pytest
from scipy.stats import chi2

from moving_window import linear, sampled
from observers.instance import Instance
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral
from observers.status import CODE
from reference_models.cell import CELL
from reference_models.duffing import DUFFING
from reference_models.plant import plant

TS = 0.1
NOISE = {"y1": 0.3, "y2": 0.5}
STD = {"x1": 1.0, "x2": 2.0, "x3": 0.7, "d": 1.5}
NAMES = ("x1", "x2", "x3", "d")
R_INVERSE = np.diag([NOISE["y1"] ** -2, NOISE["y2"] ** -2])


def stds(run, names=NAMES):
    return np.array([run.get(f"diagnostics.std.{name}") for name in names])


def sampled_run(observer, samples, seed=0, missing=0.0, then=None):
    """Yields (k, run, valid) after each sample of noise."""
    rng = np.random.default_rng(seed)
    run = Instance(observer, {"tuning.gate": 1e30})  # its samples are none of the model
    for k in range(samples):
        valid = rng.random(2) >= missing
        for i in (0, 1):
            run.set(f"y{i + 1}", rng.normal())
            run.set(f"measurement_valid.y{i + 1}", float(valid[i]))
        run.step(k * TS, TS)
        yield k, run, valid


def information(model, valid):
    C = model.C[valid]
    return C.T @ R_INVERSE[np.ix_(valid, valid)] @ C


@pytest.mark.parametrize(("L", "segments"), [(3, 1), (6, 3), (4, 4)])
@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_with_an_arrival_cost_it_is_the_kalman_filters_from_the_first_sample(L, segments, missing):
    """Of the current time, a sample after the measurement: to what the propagation between samples costs."""
    observer = pseudospectral(
        linear(disturbed=True),
        sample_time=TS,
        N=10,
        L=L,
        segments=segments,
        arrival_cost=True,
        measurement_noise=NOISE,
        initial_std=STD,
    )
    model = sampled(TS, disturbed=True)
    P = np.diag([STD[name] ** 2 for name in NAMES])
    for k, run, valid in sampled_run(observer, 30, missing=missing):
        P = np.linalg.inv(np.linalg.inv(P) + information(model, valid))
        P = model.F @ P @ model.F.T
        np.testing.assert_allclose(stds(run), np.sqrt(np.diag(P)), rtol=1e-4, err_msg=f"sample {k}")


@pytest.mark.parametrize(("L", "segments"), [(6, 1), (6, 2)])
def test_without_one_it_is_that_of_the_windows_least_squares(L, segments):
    """While the window grows too, where its last sample is not its end."""
    observer = pseudospectral(
        linear(disturbed=True), sample_time=TS, N=10, L=L, segments=segments, measurement_noise=NOISE
    )
    model = sampled(TS, disturbed=True)
    seen = []
    for k, run, valid in sampled_run(observer, 20, missing=0.1):
        seen.append(valid)
        back = np.linalg.inv(model.F)
        steps = range(min(k, L) + 1)
        total = sum(
            np.linalg.matrix_power(back, i).T @ information(model, seen[k - i]) @ np.linalg.matrix_power(back, i)
            for i in steps
        )
        if k >= 4 and valid.any():
            P = model.F @ np.linalg.inv(total) @ model.F.T
            np.testing.assert_allclose(stds(run), np.sqrt(np.diag(P)), rtol=1e-4, err_msg=f"sample {k}")


def test_noise_that_nobody_gives_is_what_the_fit_leaves():
    """Student's variance: the sum of squares over the degrees of freedom less two, times that of the unit noise."""
    L, model = 8, sampled(TS)
    unit = pseudospectral(linear(), sample_time=TS, N=10, L=L, measurement_noise={"y1": 1.0, "y2": 1.0})
    plain = pseudospectral(linear(), sample_time=TS, N=10, L=L)
    rng = np.random.default_rng(1)
    runs = [Instance(unit), Instance(plain)]
    Y = rng.normal(size=(30, 2)) * 0.01
    for k, y in enumerate(Y):
        for run in runs:
            run.set("y1", y[0])
            run.set("y2", y[1])
            run.step(k * TS, TS)
    A = np.vstack([model.C @ np.linalg.matrix_power(model.F, i) for i in range(L + 1)])
    _, (left,), _, _ = np.linalg.lstsq(A, Y[-L - 1 :].ravel(), rcond=None)
    expected = np.sqrt(left / (2 * (L + 1) - 3 - 2)) * stds(runs[0], NAMES[:3])
    np.testing.assert_allclose(stds(runs[1], NAMES[:3]), expected, rtol=3e-13)


def stiff():
    """A fast mode, decayed long before the window's end, whose first value the window hardly sees."""
    return Model(
        name="stiff",
        states=[Variable("fast", start=1.0), Variable("slow", start=1.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-200 * (x.fast - x.slow), -0.5 * x.slow],
        output=lambda x, u, p, t: [x.slow + 1e-3 * x.fast],
    )


def test_a_stiff_model_is_as_certain_as_its_current_state():
    """The window's first fast state is open to 40 and more; that of the current one follows the slow state."""
    observer = pseudospectral(stiff(), sample_time=0.05, N=20, L=4, measurement_noise={"y": 0.01}, max_step=0.05)
    run = Instance(observer)
    for k in range(40):
        run.set("y", 1.001 * np.exp(-0.5 * 0.05 * k))
        run.step(0.05 * k, 0.05)
        if k >= 4:
            assert run.get("diagnostics.status") == CODE.estimating
    fast, slow = stds(run, ("fast", "slow"))
    assert fast == pytest.approx(slow, rel=0.01)
    # y = slow, nearly, in the last four samples; the first one goes into the fast state that nothing else tells.
    ages = np.exp(0.5 * 0.05 * np.arange(4))
    assert slow == pytest.approx(0.01 / np.sqrt((ages**2).sum()) * np.exp(-0.5 * 0.05), rel=0.01)


def scatter(observer, plant, names, guess, samples, noise, runs, settle):
    """Normalised errors of `runs` runs after `settle` samples: (runs, kept, len(names)) of error over std; `plant(rng) -> y, truth`."""
    ratios = []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        Y, truth = plant(rng)
        run, own = Instance(observer, guess), []
        for k in range(samples):
            run.set("y", Y[k] + noise * rng.normal())
            run.step(k * TS, TS)
            if k >= settle:
                error = np.array([run.get(f"estimate.{name}") for name in names]) - truth[k + 1]
                own.append(error / stds(run, names))
        ratios.append(own)
    return np.array(ratios)


def duffing(samples):
    eq = DUFFING.equations
    model = ca.Function("f", [eq.x, eq.theta, eq.t, eq.p, eq.u], [eq.ode])
    damping = [v.start for v in DUFFING.parameters]

    def f(x, theta, t):
        return model(x, theta, t, damping, 0).full().ravel()

    x, theta, out, Y = np.array([2.0, 1.0]), 0.4, [], []
    h = TS / 10
    for k in range(samples + 1):
        out.append([*x, theta])
        Y.append(x[0] + 0.5 * x[1])
        for i in range(10):
            t = k * TS + i * h
            k1 = f(x, theta, t)
            k2 = f(x + h / 2 * k1, theta, t + h / 2)
            k3 = f(x + h / 2 * k2, theta, t + h / 2)
            k4 = f(x + h * k3, theta, t + h)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return np.array(Y), np.array(out)


@pytest.mark.long
@pytest.mark.parametrize("given", [True, False], ids=["noise given", "noise estimated"])
def test_over_a_hundred_runs_of_the_duffing_system_the_errors_are_as_large_as_it_says(given):
    """+-2 std covers 93 to 97 %, each state and theta; where the noise is estimated from 18 residuals, by Student's quantile."""
    more = {"measurement_noise": {"y": 0.02}} if given else {}
    observer = pseudospectral(DUFFING, sample_time=TS, N=15, L=20, **more)
    fixed = duffing(60)
    ratios = scatter(observer, lambda rng: fixed, ("x1", "x2", "theta"), {}, 60, 0.02, 100, 25)
    covered = (np.abs(ratios) < 2).mean(axis=(0, 1))
    assert (covered > 0.93).all() and (covered < 0.97).all(), covered
    late = (ratios[:, -1] ** 2).sum(axis=0)  # a run's samples are correlated: one of each run
    assert ((late > chi2.ppf(0.001, 100)) & (late < chi2.ppf(0.999, 100) * (1 if given else 1.3))).all(), late


def test_a_bound_that_the_past_meets_does_not_contradict_the_samples() -> None:
    """A voltage of ten times the noise that is assumed fixes 0.9 soc - v1 to a thousandth, each of the two hardly.

    A cut of soc alone to its bound of 1 takes v1 off to thousands of volts.
    """
    truth, current = Instance(plant(CELL)), np.repeat(np.random.default_rng(1).uniform(-2, 5, 40), 10)
    run = Instance(pseudospectral(CELL, sample_time=1.0, guess={"soc": 0.6, "R0": 0.02}))
    rng, off = np.random.default_rng(0), []
    for k, i in enumerate(current):
        truth.set("i", i)
        run.set("i", i)
        run.set("v", truth.get("v") + 0.002 * rng.normal())
        truth.step(float(k), 1.0)
        run.step(float(k), 1.0)
        names = ("soc", "v1")
        off.append([truth.get(f"x.{v}") - run.get(f"estimate.{v}") for v in names])
        off[-1] += [run.get(f"diagnostics.std.{v}") for v in names]
        assert abs(run.get("estimate.v1")) < 1.0 and run.get("diagnostics.solver_failures") == 0
    late = np.array(off[50:])
    assert np.abs(late[:, :2]).max() < 0.03
    # Nobody has said what the noise is: the deviations are in the scale of what was seen.
    assert np.mean(np.abs(late[:, :2]) < 2 * late[:, 2:]) > 0.8
