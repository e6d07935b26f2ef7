"""The arrival cost: the Kalman filter where the model is linear, and what a short window gains from it where it is not."""

from collections.abc import Callable

import numpy as np
import pytest

from components import COMPONENTS
from moving_window import NONLINEAR, linear, sampled
from observers.instance import Instance
from observers.model import Model, ModelError, Variable
from observers.pseudospectral import pseudospectral
from observers.status import CODE
from reference_models.duffing import DUFFING, DUFFING_KNOWN
from reference_models.plant import plant
from slave import Slave

TS = 0.1
NOISE = {"y1": 0.3, "y2": 0.5}
STD = {"x1": 1.0, "x2": 2.0, "x3": 0.7, "d": 1.5}


class Filter:
    """The textbook Kalman filter of `moving_window.sampled` with process noise `Q` (covariance of a sample)."""

    def __init__(self, model, mean, P, Q=None):
        self.model, self.x, self.P = model, np.array(mean, float), np.array(P, float)
        self.Q = np.zeros_like(self.P) if Q is None else Q
        self.R = np.diag([NOISE["y1"], NOISE["y2"]]) ** 2

    def correct(self, y, u, valid):
        if valid.any():
            C, R = self.model.C[valid], self.R[np.ix_(valid, valid)]
            G = self.P @ C.T @ np.linalg.inv(C @ self.P @ C.T + R)
            self.x = self.x + G @ (y - self.model.D * u)[valid] - G @ C @ self.x
            self.P = self.P - G @ C @ self.P

    def predict(self, u, u_next):
        F = self.model.F
        self.x = F @ self.x + self.model.G0 * u + self.model.G1 * u_next
        self.P = F @ self.P @ F.T + self.Q


def observer(L, N, segments, disturbed=False, kind="held", **more):
    names = ["x1", "x2", "x3", *(["d"] if disturbed else [])]
    return pseudospectral(
        linear(disturbed=disturbed, input_between_samples=kind),
        sample_time=TS,
        N=N,
        L=L,
        segments=segments,
        arrival_cost=True,
        measurement_noise=NOISE,
        initial_std={name: STD[name] for name in names},
        **more,
    )


def told(run, y, u, valid, k):
    for i in (0, 1):
        run.set(f"y{i + 1}", y[i] if valid[i] else 1e3)
        run.set(f"measurement_valid.y{i + 1}", float(valid[i]))
    run.set("u", u)
    run.step(k * TS, TS)


AS_IT_IS = {"tuning.gate": 1e30}  # the records are no samples of the model


def at_rest(samples):
    """Noise as the observer is told, of a model that stays where the guess is."""
    y, u, valid = record(samples, 0.0)
    return y * list(NOISE.values()), 0 * u, valid


def record(samples, missing, seed=3):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(samples, 2)), rng.normal(size=samples + 1), rng.random((samples, 2)) >= missing


@pytest.mark.parametrize("missing", [0.0, 0.3])
@pytest.mark.parametrize(("L", "N", "segments"), [(2, 10, 1), (5, 12, 1), (8, 8, 4), (3, 7, 3)])
@pytest.mark.parametrize("kind", ["held", "linear"])
@pytest.mark.parametrize("disturbed", [False, True], ids=["states", "states and an unknown parameter"])
def test_on_a_linear_model_the_estimate_is_the_kalman_filters_from_the_first_sample(
    L, N, segments, missing, kind, disturbed
):
    """Through two outputs, samples missing one by one and both at once, whatever the window's length. Where both are missing the estimate
    is the prediction, which can only hold an input whose next value it does not know yet: a linear one is told again from the next."""
    y, u, valid = record(60, missing)
    run = Instance(observer(L, N, segments, disturbed, kind), {"guess.x1": 0.5, **AS_IT_IS})
    names = ["x1", "x2", "x3", *(["d"] if disturbed else [])]
    kalman = Filter(
        sampled(TS, kind == "held", disturbed), [0.5, *[0.0] * (len(names) - 1)], np.diag([STD[n] ** 2 for n in names])
    )
    for k in range(60):
        told(run, y[k], u[k], valid[k], k)
        kalman.correct(y[k], u[k], valid[k])
        if kind == "held" or valid[k].any():
            found = [run.get(f"filtered.{name}") for name in names]
            np.testing.assert_allclose(found, kalman.x, rtol=0, atol=6e-13, err_msg=f"sample {k}")
        kalman.predict(u[k], u[k + 1])
        if kind == "held":
            np.testing.assert_allclose([run.get(f"estimate.{name}") for name in names], kalman.x, rtol=0, atol=6e-13)
    assert run.get("diagnostics.solver_failures") == 0


def noisy_duffing(noise, samples, seed):
    p = Instance(plant(DUFFING), {"sensor.noise_bound": noise, "sensor.sample_time": TS, "sensor.seed": seed})
    y, x = [], []
    for k in range(samples):
        y.append(p.get("y"))
        x.append([p.get(f"x.{name}") for name in ("x1", "x2", "theta")])
        p.step(k * TS, TS)
    return np.array(y), np.array(x)


def settled_rms(component, y, x):
    run, errors = Instance(component, {"guess.x1": 0.0, "guess.x2": 0.0, "guess.theta": 0.1}), []
    for k, value in enumerate(y):
        run.set("y", value)
        run.step(k * TS, TS)
        errors.append([run.get(f"filtered.{name}") for name in ("x1", "x2", "theta")] - x[k])
    assert np.isfinite(errors).all()
    return np.sqrt(np.mean(np.array(errors)[100:] ** 2, axis=0))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_short_window_under_noise_is_several_times_more_accurate_with_it(seed):
    y, x = noisy_duffing(0.1, 300, seed)
    plain = pseudospectral(DUFFING, sample_time=TS, N=15, L=8)
    costed = pseudospectral(
        DUFFING,
        sample_time=TS,
        N=15,
        L=8,
        arrival_cost=True,
        measurement_noise={"y": 0.1 / np.sqrt(3)},
        process_noise={"x1": 1e-3, "x2": 1e-3, "theta": 0.01},
    )
    without, with_it = settled_rms(plain, y, x), settled_rms(costed, y, x)
    assert np.all(with_it < without / 3), (without, with_it)
    assert with_it[0] < 0.03 and with_it[2] < 0.03


def test_without_noise_it_costs_no_accuracy_once_the_guess_is_forgotten():
    y, x = noisy_duffing(0.0, 150, 0)
    component = pseudospectral(
        DUFFING, sample_time=TS, N=15, L=8, arrival_cost=True, measurement_noise={"y": 1e-3}, initial_std={"theta": 1.0}
    )
    assert settled_rms(component, y, x).max() < 2e-7


def test_nonlinear_outputs_two_unknowns_and_an_input_inside_the_nonlinearity_take_it_too():
    component = pseudospectral(
        NONLINEAR, sample_time=TS, N=7, L=6, segments=6, arrival_cost=True, measurement_noise={"y1": 1e-3, "y2": 1e-3}
    )
    guess = {"guess.x1": 0.5, "guess.x2": 0.0, "guess.x3": 0.0, "guess.theta": 0.3, "guess.bias": 0.0}
    p, run = Instance(plant(NONLINEAR)), Instance(component, guess)
    for k in range(120):
        for one in (p, run):
            one.set("u", np.sin(0.3 * k))
        for name in ("y1", "y2"):
            run.set(name, p.get(name))
        true = [p.get(f"x.{name}") for name in ("x1", "x2", "x3", "theta", "bias")]
        p.step(k * TS, TS)
        run.step(k * TS, TS)
    found = [run.get(f"filtered.{name}") for name in ("x1", "x2", "x3", "theta", "bias")]
    np.testing.assert_allclose(found, true, rtol=0, atol=1e-6)
    assert run.get("diagnostics.solver_failures") == 0


def test_what_the_window_leaves_open_the_past_decides():
    """A window of two samples determines neither three states nor a disturbance: with the arrival cost that is no reason to give up."""
    y, u, valid = at_rest(30)
    run = Instance(
        observer(2, 10, 1, disturbed=True), {"tuning.conditioning_limit": 1.0, "tuning.deviation_limit": 1e30}
    )
    statuses = set()
    for k in range(30):
        told(run, y[k], u[k], valid[k], k)
        statuses.add(int(run.get("diagnostics.status")))
    assert statuses == {CODE.settling, CODE.estimating}


def test_a_gap_longer_than_the_window_is_bridged_with_the_filters_accuracy():
    y, u, valid = at_rest(60)
    valid[20:32] = False
    run = Instance(observer(5, 12, 1))
    kalman = Filter(sampled(TS), np.zeros(3), np.diag([STD[n] ** 2 for n in ("x1", "x2", "x3")]))
    for k in range(60):
        told(run, y[k], u[k], valid[k], k)
        kalman.correct(y[k], u[k], valid[k])
        np.testing.assert_allclose([run.get(f"filtered.x{i}") for i in (1, 2, 3)], kalman.x, rtol=0, atol=1e-13)
        if valid[k].all() and k >= 5:  # the first sample after the gap may leave the estimate open
            assert run.get("diagnostics.status") in (CODE.estimating, CODE.uncertain)
        kalman.predict(u[k], u[k + 1])


def test_the_cost_is_that_of_the_windows_samples_alone_in_units_of_their_noise():
    L = 5
    y, u, valid = record(30, 0.0)
    run, model = Instance(observer(L, 12, 1), AS_IT_IS), sampled(TS)
    for k in range(30):
        told(run, y[k], u[k], valid[k], k)
    x, total = np.array([run.get(f"filtered.x{i}") for i in (1, 2, 3)]), 0.0
    for k in range(29, 28 - L, -1):
        total += TS * np.sum(((model.C @ x + model.D * u[k] - y[k]) / [NOISE["y1"], NOISE["y2"]]) ** 2)
        x = np.linalg.solve(model.F, x - model.G0 * u[k - 1])
    assert run.get("diagnostics.cost") == pytest.approx(total, rel=1e-8)


def test_it_goes_with_a_tube():
    """A window of 10 samples under noise of 0.577 rms, bounded by 1; the plain window and either help alone."""
    rms = {}
    for arrival in (False, True):
        for bound in (None, 1.0):
            own = {"process_noise": {"x1": 0.01, "x2": 0.01}, "measurement_noise": {"y": 0.577}} if arrival else {}
            component = pseudospectral(
                DUFFING_KNOWN, sample_time=TS, N=15, L=10, noise_bound=bound, arrival_cost=arrival, **own
            )
            sensor = {"sensor.noise_bound": 1.0, "sensor.sample_time": TS, "sensor.seed": 4}
            p, run, errors = Instance(plant(DUFFING_KNOWN), sensor), Instance(component), []
            for k in range(150):
                true = p.get("x.x1") + 0.5 * p.get("x.x2")
                run.set("y", p.get("y"))
                p.step(k * TS, TS)
                run.step(k * TS, TS)
                errors.append(run.get("filtered.x1") + 0.5 * run.get("filtered.x2") - true)
            assert np.isfinite(errors).all()
            rms[arrival, bound is not None] = np.sqrt(np.mean(np.square(errors[50:])))
    assert rms[True, True] < 0.6 * rms[False, False] and rms[True, True] < 1.1 * min(rms.values()), rms


def test_a_deviation_of_the_guess_without_an_arrival_cost_is_refused():
    with pytest.raises(ModelError, match="initial_std belongs to an arrival cost: give arrival_cost=True"):
        pseudospectral(DUFFING, sample_time=TS, arrival_cost=False, initial_std={"x1": 1.0})


@pytest.mark.parametrize(
    ("deviations", "named"),
    [
        ({"process_noise": {"x9": 1.0}}, "x9"),
        ({"measurement_noise": {"x1": 1.0}}, "x1"),
        ({"initial_std": {"y": 1.0}}, "y"),
        ({"measurement_noise": {"y": -1.0}}, "y"),
        ({"measurement_noise": {"y": 0.0}}, "y"),
        ({"initial_std": {"theta": 0.0}}, "theta"),
        ({"process_noise": {"theta": float("nan")}}, "theta"),
    ],
)
def test_deviations_of_something_else_or_out_of_range_are_refused_by_name(deviations, named):
    with pytest.raises(ValueError, match=rf"{next(iter(deviations))}\W.*{named}"):
        pseudospectral(DUFFING, sample_time=TS, arrival_cost=True, **deviations)


def test_the_spline_cost_has_none():
    with pytest.raises(
        ValueError, match="the spline cost goes with one segment, without noise bound, arrival cost or process noise"
    ):
        pseudospectral(DUFFING, sample_time=TS, cost="spline", arrival_cost=True)


def test_the_fmu_with_an_arrival_cost_is_the_kalman_filter(slave: Callable[..., Slave]) -> None:
    y, u, valid = record(60, 0.25)
    fmu = slave("linear_arrival").initialize(AS_IT_IS)
    face = Instance(COMPONENTS["linear_arrival"](), AS_IT_IS)
    kalman = Filter(sampled(TS), np.zeros(3), np.eye(3))
    for k in range(60):
        for run in (fmu, face):
            told(run, y[k], u[k], valid[k], k)
        kalman.correct(y[k], u[k], valid[k])
        np.testing.assert_allclose([fmu.get(f"filtered.x{i}") for i in (1, 2, 3)], kalman.x, rtol=0, atol=1e-8)
        names = [port.name for port in face.component.outputs]
        np.testing.assert_allclose([fmu.get(name) for name in names], face.outputs(), rtol=1e-9, atol=1e-11)
        kalman.predict(u[k], u[k + 1])


def test_the_fmus_state_holds_the_arrival_cost(slave: Callable[..., Slave]) -> None:
    y, u, valid = record(40, 0.25)
    fmu = slave("linear_arrival").initialize()
    for k in range(20):
        told(fmu, y[k], u[k], valid[k], k)
    handle = fmu.fmu.getFMUState()
    ends = []
    for _ in range(2):
        fmu.fmu.setFMUState(handle)
        for k in range(20, 40):
            told(fmu, y[k], u[k], valid[k], k)
        ends.append(fmu.outputs())
    fmu.fmu.freeFMUState(handle)
    assert ends[0] == ends[1]


def test_with_one_state_and_no_parameter_it_is_the_kalman_filter() -> None:
    """The smallest moving horizon there is, x' = -0.7 x."""
    decay = Model(
        name="decay",
        states=[Variable("x", start=1.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-0.7 * x.x],
        output=lambda x, u, p, t: [x.x],
    )
    deviations = {"process_noise": {"x": 0.0}, "measurement_noise": {"y": 0.2}, "initial_std": {"x": 0.5}}
    run = Instance(pseudospectral(decay, sample_time=0.1, N=5, L=3, arrival_cost=True, **deviations), AS_IT_IS)
    m, P, phi, rng = 1.0, 0.25, np.exp(-0.07), np.random.default_rng(5)
    for k, y in enumerate(rng.normal(size=30)):
        run.set("y", y)
        run.step(0.1 * k, 0.1)
        K = P / (P + 0.04)
        m, P = phi * (m + K * (y - m)), phi**2 * (1 - K) * P
        assert run.get("estimate.x") == pytest.approx(m, rel=0, abs=1e-9)
