"""The least-squares observer: its contraction identity, its sums against batch least squares, and what it refuses."""

import math
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import linear_models
from observers.instance import Instance
from observers.least_squares import least_squares
from observers.model import Model, ModelError, Variable
from observers.status import CODE
from reference_models.chen_yen import CHEN_YEN
from reference_models.duffing import DUFFING
from reference_models.plant import plant

TEXTBOOK = {"tuning.gate": 1e9}  # measurements of no motion act all the same
A = np.array([[0.1, 1.0, 0.0], [-1.0, -0.2, 0.5], [0.2, 0.0, -0.4]])
C = np.array([[1.0, 0.0, 0.3]])


def linear():
    return Model(
        name="invariant",
        states=[Variable(f"x{i}") for i in range(3)],
        inputs=[Variable("u")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [sum(a * s for a, s in zip(row, (x.x0, x.x1, x.x2), strict=True)) + u.u for row in A],
        output=lambda x, u, p, t: [x.x0 + 0.3 * x.x2],
    )


def drive(observer, true, Ts, count, first=0):
    """`count` samples; yields the error and the observer after each step."""
    states = [port.name.removeprefix("estimate.") for port in observer.component.outputs if "estimate." in port.name]
    for k in range(first, first + count):
        for name in [port.name for port in true.component.outputs if not port.name.startswith("x.")]:
            observer.set(name, true.get(name))
        for one in (observer, true):
            one.step(k * Ts, Ts)
        yield np.array([observer.get(f"estimate.{s}") - true.get(f"x.{s}") for s in states])


def test_within_an_interval_it_is_batch_least_squares_with_the_guess_as_prior():
    gamma, p0, Ts, rng = 2.0, 0.7, 0.1, np.random.default_rng(0)
    observer = Instance(least_squares(linear(), sample_time=Ts, T=100.0, gamma=gamma, p0=p0), TEXTBOOK)
    samples, guess = rng.normal(size=20), np.zeros(3)
    rows, right = [np.eye(3) / math.sqrt(p0)], [guess / math.sqrt(p0)]
    for k, y in enumerate(samples):
        observer.set("y", y)
        observer.step(k * Ts, Ts)
        weight = math.sqrt(gamma * Ts * (0.5 if k == 0 else 1.0))
        rows.append(weight * C @ expm(A * k * Ts))
        right.append([weight * y])
        x0 = np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]
        found = [observer.get(f"estimate.x{i}") for i in range(3)]
        np.testing.assert_allclose(found, expm(A * (k + 1) * Ts) @ x0, rtol=0, atol=1e-12)


def test_it_converges_to_the_papers_continuous_observer_of_second_order_in_the_sample_time():
    gamma, p0, T = 20.0, 0.1, 2.0

    def A_t(t):
        s, c = math.sin(t), math.cos(t)
        return np.array([[-1 + 1.5 * c * c, 1 - 1.5 * s * c], [-1 + 1.5 * s * c, -1 + 1.5 * s * s]])

    def C_t(t):
        r = math.sqrt(t)
        return np.array([[math.cos(r) + math.sin(r), 3 * math.cos(r) ** 2]])

    def rhs(t, z):
        e, Phi, P = z[:2], z[2:6].reshape(2, 2), z[6:].reshape(2, 2)
        w = Phi.T @ C_t(t).T
        gain = gamma * Phi @ P @ w
        return np.concatenate(
            [A_t(t) @ e - gain @ (C_t(t) @ e), (A_t(t) @ Phi).ravel(), (-gamma * P @ w @ w.T @ P).ravel()]
        )

    z = np.concatenate([[-5, 5], np.eye(2).ravel(), p0 * np.eye(2).ravel()])
    for k in range(3):
        z[2:] = np.concatenate([np.eye(2).ravel(), p0 * np.eye(2).ravel()])
        z = solve_ivp(rhs, (k * T, (k + 1) * T), z, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    gaps = []
    for Ts in (0.1, 0.05, 0.025):
        observer = Instance(least_squares(CHEN_YEN, sample_time=Ts, T=T, gamma=gamma, p0=p0, guess={"x1": 0, "x2": 0}))
        true = Instance(plant(CHEN_YEN))
        *_, _ = drive(observer, true, Ts, round(3 * T / Ts))
        # The sample at t = 6 s still has to end the interval: its half weight is what the trapezoid lacks.
        observer.set("y", true.get("y"))
        state = observer.z.copy()
        Phi, Y = state[2:6].reshape(2, 2).T, state[6:10].reshape(2, 2).T
        w = Phi.T @ C_t(6.0).T
        x = state[:2] + gamma * Ts / 2 * Phi @ np.linalg.solve(
            Y + gamma * Ts / 2 * w @ w.T, w @ [true.get("y") - C_t(6.0) @ state[:2]]
        )
        gaps.append(np.linalg.norm(x - [true.get("x.x1"), true.get("x.x2")] - z[:2]))
    orders = np.log2(np.array(gaps[:-1]) / gaps[1:])
    # C(t) holds sqrt t, whose derivative is unbounded at t = 0: order 3/2 at first, 2 beyond.
    assert np.all(orders > 1.3), (gaps, orders)


def test_half_a_second_between_samples_and_p0_of_1e4_are_stable():
    observer = Instance(least_squares(CHEN_YEN, sample_time=0.5, T=2.0, gamma=20.0, p0=1e4, guess={"x1": 0, "x2": 0}))
    errors = [np.linalg.norm(e) for e in drive(observer, Instance(plant(CHEN_YEN)), 0.5, 80)]
    true_growth = 10.0 * math.exp(0.5 * 40)
    assert max(errors) < 10 and errors[-1] < 1e-12 * true_growth
    assert observer.get("diagnostics.solver_failures") == 0


def switched(period=0.37):
    """A(t) that switches between samples, and between substeps: 0.37 s is no multiple of theirs."""
    return Model(
        name="switched",
        states=[Variable("x1", start=1.0), Variable("x2", start=-1.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [
            x.x2,
            ca.if_else(ca.fmod(t, 2 * period) < period, -4 * x.x1, 0.5 * x.x1) - 0.1 * x.x2,
        ],
        output=lambda x, u, p, t: [x.x1],
    )


def switched_error(max_step):
    observer = Instance(
        least_squares(switched(), sample_time=0.1, T=1.0, gamma=20.0, max_step=max_step), {"guess.x1": 3.0}
    )
    x, gap = np.array([1.0, -1.0]), 0.0
    for k in range(80):
        observer.set("y", x[0])
        observer.step(0.1 * k, 0.1)
        cuts = [0.1 * k, *[c for c in 0.37 * np.arange(60) if 0.1 * k + 1e-9 < c < 0.1 * (k + 1) - 1e-9], 0.1 * (k + 1)]
        for begin, end in pairwise(cuts):
            stiffness = -4.0 if math.fmod((begin + end) / 2, 0.74) < 0.37 else 0.5
            x = expm(np.array([[0, 1], [stiffness, -0.1]]) * (end - begin)) @ x
        if k >= 40:
            scale = max(1.0, np.linalg.norm(x))
            gap = max(gap, np.hypot(observer.get("estimate.x1") - x[0], observer.get("estimate.x2") - x[1]) / scale)
    return gap


def test_an_A_that_switches_between_samples_stays_stable_and_substeps_bound_its_error():
    coarse, default, fine = switched_error(0.05), switched_error(0.01), switched_error(0.002)
    assert fine < 1e-3 and fine < default < 5e-3 and 10 * default < coarse


def test_gaussian_noise_of_0_1_leaves_an_rms_error_of_at_most_0_025():
    observer = Instance(least_squares(CHEN_YEN, sample_time=0.05, T=0.25, gamma=20.0, p0=0.1, guess={"x1": 0, "x2": 0}))
    noisy = {"sensor.noise_std": 0.1, "sensor.sample_time": 0.05, "sensor.seed": 1}
    errors = np.array(list(drive(observer, Instance(plant(CHEN_YEN), noisy), 0.05, 1200)))[200:]
    assert np.sqrt(np.mean(errors**2)) <= 0.025


def test_a_nonlinear_model_is_refused_by_name_unless_it_may_be_linearised():
    with pytest.raises(ModelError, match=r"duffing.*x2.*linearise=True"):
        least_squares(DUFFING, sample_time=0.01, T=1.0)
    observer = Instance(
        least_squares(
            DUFFING, sample_time=0.01, T=1.0, gamma=100.0, p0=10.0, linearise=True, guess={"x1": 1.5, "theta": 0.3}
        )
    )
    errors = [np.linalg.norm(e) for e in drive(observer, Instance(plant(DUFFING)), 0.01, 2000)]
    assert errors[-1] < 1e-6


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"T": 0.001}, ("T", "0.001", "0.01")),
        ({"gamma": 0.0}, ("gamma", "0")),
        ({"p0": math.nan}, ("p0", "nan")),
    ],
)
def test_impossible_tuning_is_refused_by_name(arguments, words):
    with pytest.raises(ValueError) as caught:
        least_squares(CHEN_YEN, **{"sample_time": 0.01, "T": 0.25, **arguments})
    for word in words:
        assert word in str(caught.value)


def test_rejected_samples_weigh_nothing():
    observer, other = (Instance(least_squares(linear(), sample_time=0.1, T=0.5), {"guess.x0": 1.0}) for _ in range(2))
    observer.set("y", 1.7)
    observer.step(0.0, 0.1)
    before = [observer.get(f"estimate.x{i}") for i in range(3)]
    observer.set("y", math.nan)
    observer.step(0.1, 0.1)
    assert observer.get("diagnostics.status") >= CODE.sample_rejected  # or what is graver, such as the start
    assert observer.get("diagnostics.rejected_samples") == 1
    np.testing.assert_allclose(
        [observer.get(f"estimate.x{i}") for i in range(3)], expm(0.1 * A) @ before, rtol=0, atol=1e-14
    )
    assert np.isfinite(observer.z).all()
    other.set("y", math.inf)
    for k in range(20):
        other.step(0.1 * k, 0.1)
        assert np.isfinite(other.z).all()


NOISE = {"measurement_noise": {"y0": 0.1, "y1": 3.0}, "initial_std": {"x0": 0.5, "x1": 2.0, "x2": 1.0}}


def with_two_outputs(**options):
    return least_squares(linear_models.linear(3, 2), sample_time=0.1, **NOISE, **options)


@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_given_standard_deviations_an_interval_is_the_kalman_filter_without_process_noise(missing):
    """From diag(initial_std^2) at each reset; the samples there weigh half on either side, which doubles their variance."""
    per_interval, Ts, rng = 8, 0.1, np.random.default_rng(6)
    C2 = rng.normal(size=(2, 3))
    sigma, P0 = np.array([0.1, 3.0]), np.diag([0.25, 4.0, 1.0])
    observer = Instance(with_two_outputs(T=per_interval * Ts), linear_models.entries(A, C2) | TEXTBOOK)
    Phi = expm(A * Ts)
    held = expm(Ts * np.block([[A, np.ones((3, 1))], [np.zeros((1, 4))]]))[:3, 3]

    def corrected(x, P, y, weight):
        there = np.isfinite(y)
        H, R = C2[there], np.diag(sigma[there] ** 2) / weight
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        return x + K @ (y[there] - H @ x), P - K @ H @ P

    x, P = np.zeros(3), P0
    for k in range(30):
        y, u = rng.normal(size=2), rng.normal()
        y[rng.random(2) < missing] = np.nan
        for i in range(2):
            observer.set(f"y{i}", 1e6 if np.isnan(y[i]) else y[i])
            observer.set(f"measurement_valid.y{i}", float(np.isfinite(y[i])))
        observer.set("u", u)
        observer.step(k * Ts, Ts)
        if k % per_interval == 0 and k:
            x, _ = corrected(x, P, y, 0.5)
            P = P0
        x, P = corrected(x, P, y, 0.5 if k % per_interval == 0 else 1.0)
        x, P = Phi @ x + held * u, Phi @ P @ Phi.T
        np.testing.assert_allclose([observer.get(f"estimate.x{i}") for i in range(3)], x, rtol=0, atol=5e-12)
    assert observer.get("diagnostics.rejected_samples") == 0 and observer.get("diagnostics.intervals") == 3


def test_with_initial_std_the_contraction_is_that_of_errors_in_its_units():
    """Phi Y^-1 D^-2 for e / D, D = diag(initial_std), over one interval."""
    Ts, count = 0.1, 5
    C2 = np.array([[1.0, 0.0, 0.3], [0.0, 1.0, 0.0]])
    observer = Instance(with_two_outputs(T=count * Ts), linear_models.entries(A, C2) | TEXTBOOK)
    for k in range(count + 1):
        observer.step(k * Ts, Ts)
    D, Y = np.diag([0.5, 2.0, 1.0]), np.diag([4.0, 0.25, 1.0])
    for i in range(count + 1):
        w = expm(A * i * Ts).T @ C2.T
        Y += (0.5 if i in (0, count) else 1.0) * w @ np.diag([100.0, 1 / 9]) @ w.T
    Phi, inverse = expm(A * count * Ts), np.linalg.inv(D)
    factor = np.linalg.norm(inverse @ Phi @ np.linalg.inv(Y) @ inverse, 2)
    bound = np.linalg.norm(inverse @ Phi @ D, 2) * np.linalg.norm(np.linalg.inv(D @ Y @ D), 2)
    assert factor * (1 - 1e-9) <= observer.get("diagnostics.contraction") <= factor * 1.004
    assert bound * (1 - 1e-9) <= observer.get("diagnostics.certified_contraction") <= bound * 1.008


def test_the_deviations_of_an_equal_gamma_and_p0_give_the_same_estimate():
    gamma, p0, Ts, rng = 2.0, 0.7, 0.1, np.random.default_rng(0)
    states = {f"x{i}": math.sqrt(p0) for i in range(3)}
    by_name = {"measurement_noise": {"y": 1 / math.sqrt(gamma * Ts)}, "initial_std": states}
    made = [
        least_squares(linear(), sample_time=Ts, T=0.5, **tuning) for tuning in ({"gamma": gamma, "p0": p0}, by_name)
    ]
    runs = [Instance(component, TEXTBOOK) for component in made]
    for k, y in enumerate(rng.normal(size=20)):
        for run in runs:
            run.set("y", y)
            run.step(k * Ts, Ts)
        names = [
            port.name
            for port in made[0].outputs
            if port.name.startswith(("estimate", "filtered")) or "contr" in port.name
        ]
        found = [[run.get(name) for name in names] for run in runs]
        np.testing.assert_allclose(*found, rtol=0, atol=1e-13)


def test_a_weight_in_both_ways_and_a_process_noise_are_refused_by_name():
    for tuning, words in (
        ({"gamma": 1.0, "measurement_noise": {}}, "gamma and measurement_noise say the same"),
        ({"p0": 1.0, "initial_std": {}}, "p0 and initial_std say the same"),
        ({"process_noise": {"x1": 0.1}}, "process_noise has no meaning here: a reset every T"),
        ({"measurement_noise": {"x1": 0.1}}, "measurement_noise of 'x1'; known: y"),
        ({"initial_std": {"x1": 0.0}}, "tuning.initial_std.x1"),
    ):
        with pytest.raises(ValueError, match=words):
            least_squares(CHEN_YEN, sample_time=0.01, T=0.25, **tuning)


def test_the_time_between_resets_may_be_the_shortest_sample_time() -> None:
    made = least_squares(CHEN_YEN, sample_time=1e-6, T=1e-6)
    assert {port.name: port.min for port in made.parameters}["tuning.T"] == 1e-6
