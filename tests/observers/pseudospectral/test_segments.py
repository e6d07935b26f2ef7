"""Windows of several segments: the same least squares as one segment, accurate where one polynomial is not, at every size."""

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from components import COMPONENTS
from moving_window import NONLINEAR, coupled, linear, noisy_rows, sampled
from observers.instance import Instance
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral
from observers.pseudospectral.window import problem as problem
from observers.status import CODE
from reference_models.duffing import DUFFING
from reference_models.plant import plant
from slave import Slave

GUESS = {"guess.x1": 0.0, "guess.x2": 0.0, "guess.theta": 0.1}
FAR = {"guess.x1": 0.5, "guess.x2": 0.0, "guess.x3": 0.0, "guess.theta": 0.3, "guess.bias": 0.0}


def duffing(t, x, theta):
    return [x[1], -0.25 * x[1] + x[0] * (1 - x[0] ** 2) + theta * np.cos(t)]


@pytest.fixture(scope="module")
def noisy():
    """61 samples of the paper's Duffing system, every 0.1 s, with noise of 0.02 rms."""
    x = solve_ivp(
        duffing, (0, 6), [2, 1], args=(0.4,), method="DOP853", rtol=1e-12, atol=1e-13, t_eval=0.1 * np.arange(61)
    ).y
    return x[0] + 0.5 * x[1] + 0.02 * np.random.default_rng(7).normal(size=61)


def observed(observer, y, parameters=GUESS):
    """Its estimates of the sample instants, and the instance."""
    run = Instance(observer, parameters)
    rows = []
    for k, value in enumerate(y):
        run.set("y", value)
        run.step(0.1 * k, 0.1)
        rows.append([run.get(f"filtered.{name}") for name in ("x1", "x2", "theta")])
    return np.array(rows), run


@pytest.mark.parametrize(("segments", "N"), [(1, 18), (2, 12), (5, 8), (10, 6)])
def test_with_noise_the_estimate_minimises_the_cost_that_scipy_minimises(noisy, segments, N):
    observer = pseudospectral(DUFFING, sample_time=0.1, N=N, L=10, segments=segments)
    found, run = observed(observer, noisy[:31], GUESS | {"tuning.tolerance": 1e-10})

    def trajectory(s):
        return solve_ivp(
            duffing,
            (2, 3.001),
            s[:2],
            args=(s[2],),
            method="DOP853",
            rtol=1e-12,
            atol=1e-13,
            t_eval=0.1 * np.arange(20, 31),
        ).y

    def residual(s):
        x = trajectory(s)
        return x[0] + 0.5 * x[1] - noisy[20:31]

    best = least_squares(residual, [0.5, 0.5, 0.4], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    np.testing.assert_allclose(found[-1], [*trajectory(best.x)[:, -1], best.x[2]], rtol=0, atol=1e-6)
    assert run.get("diagnostics.cost") == pytest.approx(0.1 * np.sum(best.fun**2), rel=7e-8)


@pytest.mark.parametrize(("segments", "N"), [(2, 12), (4, 9), (8, 7)])
def test_several_segments_estimate_what_one_does_within_the_collocation_error(noisy, segments, N):
    one, _ = observed(pseudospectral(DUFFING, sample_time=0.1, N=16, L=8), noisy)
    several, run = observed(pseudospectral(DUFFING, sample_time=0.1, N=N, L=8, segments=segments), noisy)
    assert np.abs(several - one)[8:].max() < 2e-7
    assert run.get("diagnostics.solver_failures") == 0


@pytest.mark.parametrize("segments", [1, 2, 3, 6])
@pytest.mark.parametrize("kind", ["held", "linear"])
@pytest.mark.parametrize("disturbed", [False, True], ids=["states", "states and an unknown parameter"])
def test_on_a_linear_model_with_noise_the_estimate_is_the_least_squares_one(segments, kind, disturbed):
    Ts, L, rng = 0.1, 6, np.random.default_rng(4)
    u, y = rng.normal(size=25), rng.normal(size=(25, 2))
    model = linear(disturbed=disturbed, input_between_samples=kind)
    run = Instance(pseudospectral(model, sample_time=Ts, N=10, L=L, segments=segments))
    run.set("tuning.conditioning_limit", 0.0)
    reference = sampled(Ts, kind == "held", disturbed)
    for k in range(25):
        for name, value in (("y1", y[k, 0]), ("y2", y[k, 1]), ("u", u[k])):
            run.set(name, value)
        run.step(k * Ts, Ts)
        if k >= L:
            window = slice(k - L, k + 1)
            expected = reference.smoothed(y[window], u[window])
            found = [run.get(f"filtered.{v}") for v in ("x1", "x2", "x3", *(["d"] if disturbed else []))]
            np.testing.assert_allclose(found, expected, rtol=0, atol=5e-11 * (1 + np.abs(expected).max()))


@pytest.mark.parametrize("segments", [2, 6])
def test_a_settable_parameter_inside_the_linear_part_costs_no_accuracy_with_a_segment_for_every_sample(segments):
    """The rates then see the held input's kinks, which lie between the segments where every interval is one."""
    Ts, L, rng = 0.1, 6, np.random.default_rng(4)
    u, y = rng.normal(size=25), rng.normal(size=(25, 2))
    run = Instance(pseudospectral(linear(damping=0.3), sample_time=Ts, N=10, L=L, segments=segments))
    reference, worst = sampled(Ts), 0.0
    for k in range(25):
        for name, value in (("y1", y[k, 0]), ("y2", y[k, 1]), ("u", u[k])):
            run.set(name, value)
        run.step(k * Ts, Ts)
        if k >= L:
            expected = reference.smoothed(y[k - L : k + 1], u[k - L : k + 1])
            worst = max(worst, np.abs([run.get(f"filtered.x{i}") for i in (1, 2, 3)] - expected).max())
    assert worst < 1e-9 if segments == L else worst > 1e-7


def test_a_held_input_that_multiplies_a_state_needs_a_segment_for_every_sample():
    """Its kinks make the one polynomial of the paper's window wrong by 1e-2 and more; segments end where they are."""
    u = np.random.default_rng(3).normal(size=61)

    def errors(segments, N):
        observer = pseudospectral(NONLINEAR, sample_time=0.1, N=N, L=8, segments=segments)
        found, run = coupled(NONLINEAR, observer, 60, 0.1, lambda t: u[round(t / 0.1)], guess=FAR)
        assert run.get("diagnostics.solver_failures") == 0 or segments == 1
        return found[8:].max()

    assert errors(segments=1, N=15) > 1e-2
    assert errors(segments=8, N=7) < 8e-12


def test_the_error_falls_spectrally_with_the_nodes_of_a_segment():
    def worst(order):
        observer = pseudospectral(DUFFING, sample_time=0.1, N=order, L=8, segments=2)
        return coupled(DUFFING, observer, 100, 0.1, guess=GUESS)[0][20:].max()

    errors = np.array([worst(order) for order in (4, 6, 8, 10)])
    assert np.all(errors[:-1] / errors[1:] > 8), errors
    assert errors[0] > 1e-4 and errors[-1] < 1e-7, errors


def test_halving_the_segments_gains_most_of_a_digit_or_more_at_order_5():
    def worst(segments):
        observer = pseudospectral(DUFFING, sample_time=0.1, N=5, L=8, segments=segments)
        return coupled(DUFFING, observer, 100, 0.1, guess=GUESS)[0][20:].max()

    errors = np.array([worst(segments) for segments in (1, 2, 4, 8)])
    assert np.all(errors[:-1] / errors[1:] > 8), errors
    assert errors[0] > 1e-3 and errors[-1] < 5e-6, errors


@pytest.mark.parametrize(("segments", "N"), [(2, 9), (4, 7), (8, 6)])
def test_while_the_window_grows_segments_without_samples_wait_and_the_estimate_is_exact_from_the_third_sample(
    segments, N
):
    observer = pseudospectral(DUFFING, sample_time=0.1, N=N, L=8, segments=segments)
    p, o = Instance(plant(DUFFING)), Instance(observer, GUESS)
    statuses, errors = [], []
    for k in range(12):
        true = [p.get(f"x.{v}") for v in ("x1", "x2", "theta")]
        o.set("y", p.get("y"))
        p.step(0.1 * k, 0.1)
        o.step(0.1 * k, 0.1)
        statuses.append(int(o.get("diagnostics.status")))
        errors.append(np.abs([o.get(f"filtered.{v}") for v in ("x1", "x2", "theta")] - np.array(true)).max())
    assert statuses == [CODE.propagated_guess] * 2 + [CODE.settling] * 6 + [CODE.estimating] * 4
    assert max(errors[2:]) < 1e-5 and o.get("diagnostics.solver_failures") == 0


@pytest.mark.parametrize(("segments", "N"), [(2, 9), (3, 8)])
def test_the_tiled_step_of_a_segment_is_the_straight_line_one(monkeypatch, segments, N):
    runs = []
    for small in (1000, 0):
        monkeypatch.setattr(problem, "SMALL", small)
        monkeypatch.setattr(problem, "SMALL_POINTS", 100 * small)
        observer = pseudospectral(NONLINEAR, sample_time=0.1, N=N, L=6, segments=segments)
        runs.append(noisy_rows(observer))
    np.testing.assert_allclose(runs[0], runs[1], rtol=0, atol=5e-13)


def test_a_larger_model_in_segments_is_estimated_as_a_chain_of_tiles():
    """Eight coupled pendulums: 16 states, 8 of them with nonlinear rates."""
    count = 8
    names = [f"{kind}{i}" for kind in ("q", "w") for i in range(count)]

    def rates(x, u, p, t):
        q = [getattr(x, f"q{i}") for i in range(count)]
        force = [
            sum(0.5 * (q[j] - q[i]) for j in (i - 1, i + 1) if 0 <= j < count)
            - ca.sin(q[i])
            - 0.1 * getattr(x, f"w{i}")
            for i in range(count)
        ]
        return [*(getattr(x, f"w{i}") for i in range(count)), *force]

    model = Model(
        name="chain",
        states=[Variable(name, start=0.3 * (-1) ** i + 0.1 * i) for i, name in enumerate(names)],
        outputs=[Variable(f"y{i}") for i in range(0, count, 2)],
        ode=rates,
        output=lambda x, u, p, t: [getattr(x, f"q{i}") for i in range(0, count, 2)],
    )
    guess = {f"guess.{name}": 0.0 for name in names}
    observer = pseudospectral(model, sample_time=0.1, N=6, L=12, segments=4)
    errors, run = coupled(model, observer, 25, 0.1, guess=guess)
    assert errors[12:].max() < 1e-4 and run.get("diagnostics.status") == CODE.estimating


@pytest.mark.parametrize(
    ("structure", "message"),
    [
        (dict(segments=3), r"segments = 3 must divide L = 8"),
        (dict(segments=0), r"segments = 0 must be a whole number of at least 1"),
        (dict(segments=2.0), r"segments = the number 2\.0, where a whole number is wanted"),
        (dict(segments=2, cost="spline"), r"the spline cost goes with one segment"),
    ],
)
def test_segments_that_do_not_make_a_window_are_refused(structure, message):
    with pytest.raises(ValueError, match=message):
        pseudospectral(DUFFING, sample_time=0.1, L=8, **structure)


def test_the_fmu_of_a_window_in_segments_is_the_python_face_and_shows_its_structure(
    slave: Callable[..., Slave], noisy
) -> None:
    fmu, face = slave("duffing_segments").initialize(GUESS), Instance(COMPONENTS["duffing_segments"](), GUESS)
    assert [fmu.get(f"structure.{name}") for name in ("N", "L", "segments")] == [7, 8, 4]
    for k, value in enumerate(noisy):
        for one in (fmu, face):
            one.set("y", np.nan if k == 20 else value)
            one.step(0.1 * k, 0.1)
        names = [port.name for port in face.component.outputs]
        np.testing.assert_allclose([fmu.get(name) for name in names], face.outputs(), rtol=0, atol=1e-12)
    assert fmu.get("diagnostics.rejected_samples") == 1
