"""The pseudospectral observer's estimates against closed forms, scipy's least squares and the truth, on models of every shape."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import least_squares

from moving_window import NONLINEAR, A, B, coupled, linear, noisy_rows
from observers.instance import Instance
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral
from observers.status import CODE
from reference_models.duffing import DUFFING
from reference_models.plant import plant


def closed_form(y, u, first, L, Ts):
    """Least squares over the samples first..first + L by the matrix exponential, inputs held; the state at the last one."""
    augmented = np.zeros((4, 4))
    augmented[:3, :3], augmented[:3, 3] = A, B
    step = expm(augmented * Ts)
    C = np.array([[1.0, 0, 0], [1, 0, 0.5]])
    F, c, rows, right = np.eye(3), np.zeros(3), [], []
    for i in range(L + 1):
        rows.append(C @ F)
        right.append(y[first + i] - C @ c - [0, 0.2 * u[first + i]])
        if i < L:
            F, c = step[:3, :3] @ F, step[:3, :3] @ c + step[:3, 3] * u[first + i]
    x0 = np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]
    return F @ x0 + c


@pytest.mark.parametrize(("L", "N"), [(5, 12), (12, 14)])
@pytest.mark.parametrize("damping", [None, 0.3], ids=["constant", "settable"])
def test_on_a_linear_model_with_noise_the_estimate_is_the_least_squares_one(damping, L, N):
    """Held inputs where A is constant; with a settable entry none, because phi sees their kinks."""
    Ts, rng = 0.1, np.random.default_rng(4)
    samples = 30
    u, y = (0.0 if damping else 1.0) * rng.normal(size=samples), rng.normal(size=(samples, 2))
    run = Instance(
        pseudospectral(linear(damping), sample_time=Ts, N=N, L=L),
        {"tuning.conditioning_limit": 0.0, "tuning.deviation_limit": 1e30},
    )
    for k in range(samples):
        run.set("y1", y[k, 0])
        run.set("y2", y[k, 1])
        run.set("u", u[k])
        run.step(k * Ts, Ts)
        if k >= L:
            expected = closed_form(y, u, k - L, L, Ts)
            found = [run.get(f"filtered.x{i}") for i in (1, 2, 3)]
            np.testing.assert_allclose(found, expected, rtol=0, atol=3e-14 * (1 + np.abs(expected).max()))
            assert run.get("diagnostics.status") == CODE.estimating


@pytest.mark.parametrize("structure", [dict(N=10, L=8), dict(N=16, L=12)], ids=["one function", "tiles"])
def test_nonlinear_outputs_two_unknowns_and_an_input_inside_the_nonlinearity_are_estimated_exactly(structure):
    guess = {"guess.x1": 0.5, "guess.x2": 0.0, "guess.x3": 0.0, "guess.theta": 0.3, "guess.bias": 0.0}
    observer = pseudospectral(NONLINEAR, sample_time=0.1, **structure)
    errors, run = coupled(NONLINEAR, observer, 60, 0.1, guess=guess)
    assert errors[structure["L"] :].max() < 2e-9
    assert run.get("diagnostics.solver_failures") == 0


def test_the_tiled_step_and_the_straight_line_step_are_the_same_algorithm(monkeypatch):
    from observers.pseudospectral.window import problem as least_squares

    runs = []
    for small in (least_squares.SMALL, 0):
        monkeypatch.setattr(least_squares, "SMALL", small)
        observer = pseudospectral(NONLINEAR, sample_time=0.1, N=7, L=6)
        runs.append(noisy_rows(observer))
    np.testing.assert_allclose(runs[0], runs[1], rtol=0, atol=3e-13)


def test_with_noise_the_estimate_minimises_the_cost_that_scipy_minimises():
    Ts, L = 0.1, 10
    rng = np.random.default_rng(7)
    truth = solve_ivp(
        lambda t, x: DUFFING_RHS(t, x, 0.4),
        (0, 3),
        [2, 1],
        method="DOP853",
        rtol=1e-12,
        atol=1e-12,
        t_eval=Ts * np.arange(31),
    )
    y = truth.y[0] + 0.5 * truth.y[1] + 0.02 * rng.normal(size=31)
    run = Instance(pseudospectral(DUFFING, sample_time=Ts, N=18, L=L), {"tuning.tolerance": 1e-10})
    for k in range(31):
        run.set("y", y[k])
        run.step(k * Ts, Ts)

    def residual(s):
        times = Ts * np.arange(20, 31)
        x = solve_ivp(
            lambda t, x: DUFFING_RHS(t, x, s[2]),
            (2, 3.001),
            s[:2],
            method="DOP853",
            rtol=1e-12,
            atol=1e-13,
            t_eval=times,
        ).y
        return x[0] + 0.5 * x[1] - y[20:]

    best = least_squares(residual, [*truth.y[:, 20], 0.4], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    end = solve_ivp(
        lambda t, x: DUFFING_RHS(t, x, best.x[2]), (2, 3), best.x[:2], method="DOP853", rtol=1e-12, atol=1e-13
    ).y[:, -1]
    np.testing.assert_allclose(
        [run.get("filtered.x1"), run.get("filtered.x2"), run.get("filtered.theta")],
        [*end, best.x[2]],
        rtol=0,
        atol=2e-7,
    )
    assert run.get("diagnostics.cost") == pytest.approx(Ts * np.sum(best.fun**2), rel=2e-9)


def DUFFING_RHS(t, x, theta):
    return [x[1], -0.25 * x[1] + x[0] * (1 - x[0] ** 2) + theta * np.cos(t)]


def test_the_error_falls_spectrally_with_N():
    def worst(order):
        errors, _ = coupled(
            DUFFING, pseudospectral(DUFFING, sample_time=0.1, N=order, L=8), 100, 0.1, guess={"guess.theta": 0.1}
        )
        return errors[20:].max()

    errors = np.array([worst(order) for order in (5, 7, 9, 11, 13)])
    assert np.all(errors[:-1] / errors[1:] > 4), errors
    assert errors[-1] < 1e-6 and errors[0] > 1e-3, errors  # two nodes more gain a digit or so, all the way down


@pytest.mark.parametrize("kind", ["held", "linear"])
def test_an_input_that_enters_linearly_costs_no_accuracy_held_or_linear(kind):
    model = linear(input_between_samples=kind, outputs=[Variable("y1")], output=lambda x, u, p, t: [x.x1])
    Ts, samples = 0.1, 60
    u = np.random.default_rng(3).normal(size=samples + 1)

    def rhs(t, x, k):
        value = u[k] if kind == "held" else u[k] + (u[k + 1] - u[k]) * (t / Ts - k)
        return A @ x + B * value

    x, run = np.array([1.0, -0.5, 0.3]), Instance(pseudospectral(model, sample_time=Ts, N=12, L=10))
    for k in range(samples):
        run.set("y1", x[0])
        run.set("u", u[k])
        run.step(k * Ts, Ts)
        if k >= 10:
            np.testing.assert_allclose([run.get(f"filtered.x{i}") for i in (1, 2, 3)], x, rtol=0, atol=4e-13)
        x = solve_ivp(rhs, (k * Ts, (k + 1) * Ts), x, args=(k,), method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]


def test_200_random_first_guesses_all_converge():
    observer = pseudospectral(DUFFING, sample_time=0.1, N=15, L=8)
    rng = np.random.default_rng(0)
    true = Instance(plant(DUFFING))
    y, x = [], []
    for k in range(12):
        y.append(true.get("y"))
        x.append([true.get("x.x1"), true.get("x.x2"), true.get("x.theta")])
        true.step(0.1 * k, 0.1)
    for guess in rng.uniform(-3, 3, (200, 2)):
        run = Instance(observer, {"guess.x1": guess[0], "guess.x2": guess[1], "guess.theta": 0.1})
        for k in range(12):
            run.set("y", y[k])
            run.step(0.1 * k, 0.1)
        error = np.abs([run.get(f"filtered.{v}") for v in ("x1", "x2", "theta")] - np.array(x[-1]))
        assert error.max() < 2e-8, (guess, error)


def started(samples=20, observer=None, **parameters):
    """A Duffing observer after `samples` clean samples, and the plant beside it."""
    p = Instance(plant(DUFFING))
    o = Instance(
        observer or pseudospectral(DUFFING, sample_time=0.1, N=15),
        {name.replace("__", "."): v for name, v in parameters.items()},
    )
    for k in range(samples):
        o.set("y", p.get("y"))
        p.step(0.1 * k, 0.1)
        o.step(0.1 * k, 0.1)
    return p, o


def go_on(p, o, first, samples, measured=lambda y, k: y):
    statuses = []
    for k in range(first, first + samples):
        o.set("y", measured(p.get("y"), k))
        p.step(0.1 * k, 0.1)
        o.step(0.1 * k, 0.1)
        statuses.append(int(o.get("diagnostics.status")))
    return statuses


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e200])
def test_a_measurement_that_is_not_finite_is_rejected_counted_and_predicted_over(bad):
    p, o = started()
    statuses = go_on(p, o, 20, 1, lambda y, k: bad)
    assert statuses == [CODE.sample_rejected]
    assert abs(o.get("estimate.x1") - p.get("x.x1")) < 2e-12
    assert go_on(p, o, 21, 30) == [CODE.estimating] * 30
    assert o.get("diagnostics.rejected_samples") == 1
    assert abs(o.get("filtered.theta") - 0.4) < 8e-13


def test_an_outage_longer_than_the_window_is_bridged_by_the_model_and_recovered_from():
    p, o = started()
    statuses = go_on(p, o, 20, 15, lambda y, k: np.nan)
    # Of nine samples in the window three are needed.
    assert list(statuses) == [CODE.sample_rejected] * 6 + [CODE.propagated_guess] * 9
    assert abs(o.get("estimate.x1") - p.get("x.x1")) < 2e-10
    after = go_on(p, o, 35, 20)
    assert after[-1] == CODE.estimating and o.get("diagnostics.rejected_samples") == 15
    assert np.isfinite(o.outputs()).all() and abs(o.get("estimate.x2") - p.get("x.x2")) < 1e-8


def test_a_solve_that_does_not_converge_keeps_the_prediction_is_counted_and_the_next_starts_clean():
    p, o = started()
    o.set("tuning.iteration_limit", 1)
    prediction = o.get("estimate.x1")
    statuses = go_on(p, o, 20, 1, lambda y, k: y + 0.5)
    assert statuses == [CODE.solver_failed] and o.get("filtered.x1") == prediction
    assert o.get("diagnostics.solver_failures") == 1
    o.set("tuning.iteration_limit", 40)
    assert go_on(p, o, 21, 30)[-1] == CODE.estimating
    assert abs(o.get("estimate.x1") - p.get("x.x1")) < 1e-13


def test_absurd_measurements_never_make_an_output_that_is_not_finite():
    p, o = started()
    rng = np.random.default_rng(1)
    go_on(p, o, 20, 60, lambda y, k: float(rng.choice([1e149, -1e80, 1e9, np.nan, y])))
    assert np.isfinite(o.outputs()).all()
    assert go_on(p, o, 80, 120)[-1] == CODE.estimating
    assert abs(o.get("filtered.theta") - 0.4) < 3e-12


def test_a_prediction_cheaper_than_the_threshold_is_kept_without_a_solve():
    p, o = started(tuning__cost_threshold=1e-10)
    statuses = go_on(p, o, 20, 100)
    assert statuses.count(CODE.prediction_kept) > 50
    assert abs(o.get("estimate.x1") - p.get("x.x1")) < 1e-5
    assert o.get("diagnostics.solver_failures") == 0


@pytest.mark.parametrize(("threshold", "kept"), [(0.0, 0), (1e-300, 19)])
def test_a_prediction_is_kept_where_its_cost_is_below_the_threshold_not_where_it_is_the_threshold(threshold, kept):
    """At rest without noise the cost is exactly 0; the first sample has no prediction that a solve has found."""
    model = Model(
        name="rest",
        states=[Variable("x")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-x.x],
        output=lambda x, u, p, t: [x.x],
    )
    run = Instance(pseudospectral(model, sample_time=0.1, N=5, L=4), {"tuning.cost_threshold": threshold})
    iterations = []
    for k in range(20):
        run.set("y", 0.0)
        run.step(0.1 * k, 0.1)
        assert run.get("diagnostics.cost") == 0
        iterations.append(run.get("diagnostics.iterations"))
    assert iterations.count(0) == kept and iterations[0] > 0


def test_a_changed_model_parameter_is_said_for_a_windows_length():
    p, o = started()
    for run in (p, o):
        run.set("parameter.damping", 0.3)
    statuses = go_on(p, o, 20, 20)
    assert statuses[:8] == [CODE.parameter_changed] * 8 and CODE.parameter_changed not in statuses[8:]
    assert abs(o.get("filtered.theta") - 0.4) < 7e-10


def test_a_window_that_does_not_determine_the_state_is_said_and_the_prediction_kept():
    """At rest at x = 1 without forcing the gain a of a x (1 - x^2) leaves no trace in the output."""
    model = Model(
        name="resting",
        states=[Variable("x1", start=1.0), Variable("x2")],
        unknown_parameters=[Variable("a", start=1.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.x2, -0.2 * x.x2 + p.a * x.x1 * (1 - x.x1**2)],
        output=lambda x, u, p, t: [x.x1],
    )
    run = Instance(pseudospectral(model, sample_time=0.1, N=15), {"guess.a": 2.0})
    for k in range(30):
        run.set("y", 1.0)
        run.step(0.1 * k, 0.1)
    assert run.get("diagnostics.status") == CODE.undetermined
    assert run.get("estimate.a") == 2.0 and run.get("diagnostics.conditioning") < 1e-7


def test_a_window_too_long_for_its_order_is_said():
    _, o = started(observer=pseudospectral(DUFFING, sample_time=0.5, N=5, L=10), samples=0)
    p = Instance(plant(DUFFING))
    statuses = set()
    for k in range(40):
        o.set("y", p.get("y"))
        p.step(0.5 * k, 0.5)
        o.step(0.5 * k, 0.5)
        statuses.add(int(o.get("diagnostics.status")))
        if o.get("diagnostics.status") == CODE.coarse_collocation:
            assert o.get("diagnostics.node0_residual") > (5 - 1) ** -0.5
    assert CODE.estimating not in statuses


def test_before_enough_samples_the_estimate_is_the_propagated_guess():
    run = Instance(
        pseudospectral(DUFFING, sample_time=0.1, N=15), {"guess.x1": 0.3, "guess.x2": -0.2, "guess.theta": 0.1}
    )
    for k in range(2):
        run.set("y", 0.7)
        run.step(0.1 * k, 0.1)
    free = solve_ivp(
        lambda t, x: DUFFING_RHS(t, x, 0.1), (0, 0.2), [0.3, -0.2], method="DOP853", rtol=1e-12, atol=1e-13
    ).y[:, -1]
    np.testing.assert_allclose([run.get("estimate.x1"), run.get("estimate.x2")], free, rtol=0, atol=5e-15)
    assert run.get("diagnostics.status") == CODE.propagated_guess


def scalar(**changes):
    """x' = -x with one output: the smallest model there is."""
    arguments = dict(
        name="scalar",
        states=[Variable("a", start=1.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-x.a],
        output=lambda x, u, p, t: [x.a],
    )
    return Model(**{**arguments, **changes})


def test_a_model_of_one_state_and_nothing_else_is_estimated():
    errors, _ = coupled(scalar(), pseudospectral(scalar(), sample_time=0.1, N=15), 20, 0.1, guess={"guess.a": 5.0})
    assert errors[1:].max() < 1e-13


@pytest.mark.parametrize("through", ["linear", "product"])
def test_an_output_sees_the_input_of_its_own_instant(through):
    model = linear(
        outputs=[Variable("y1"), Variable("y2")],
        output=lambda x, u, p, t: [x.x1 + u.u, x.x3] if through == "linear" else [x.x1 * (1 + 0.3 * u.u), x.x3],
    )
    u = np.random.default_rng(6).normal(size=100)
    p, o = Instance(plant(model), {"start.x1": 1.0}), Instance(pseudospectral(model, sample_time=0.1, N=12, L=6))
    for k in range(60):
        for one in (p, o):
            one.set("u", u[k])
        o.set("y1", p.get("y1"))
        o.set("y2", p.get("y2"))
        true = p.get("x.x2")
        p.step(0.1 * k, 0.1)
        o.step(0.1 * k, 0.1)
        if k >= 2:
            assert abs(o.get("filtered.x2") - true) < 1e-13


def test_an_input_behind_a_settable_gain_costs_no_more_than_one_without():
    def worst(gain):
        model = Model(
            name="forced",
            states=DUFFING.states,
            inputs=DUFFING.inputs,
            parameters=[Variable("gain", start=1.0)] if gain else [],
            unknown_parameters=DUFFING.unknown_parameters,
            outputs=DUFFING.outputs,
            ode=lambda x, u, p, t: [
                x.x2,
                -0.25 * x.x2 + x.x1 * (1 - x.x1**2) + p.theta * ca.cos(t) + (p.gain * u.u if gain else u.u),
            ],
            output=DUFFING.output,
        )
        observer = pseudospectral(model, sample_time=0.1, N=15)
        return coupled(model, observer, 100, 0.1, inputs=np.sin, guess={"guess.theta": 0.1})[0][8:].max()

    assert worst(gain=True) == pytest.approx(worst(gain=False), rel=1e-3)
    assert worst(gain=True) < 2e-4


@pytest.mark.parametrize("outlier", [2e2, 1e4, 1e6, 1e10])
def test_no_outlier_locks_the_observer_out(outlier):
    p, o = started()
    go_on(p, o, 20, 3, lambda y, k: y + outlier if k != 21 else y - outlier)
    go_on(p, o, 23, 60)
    assert abs(o.get("estimate.x1") - p.get("x.x1")) < 6e-12
    assert o.get("diagnostics.status") == CODE.estimating


def test_a_guess_from_which_the_prediction_overflows_is_left_behind():
    p, o = started(samples=40, guess__x1=50.0, guess__x2=-50.0)
    assert abs(o.get("estimate.x1") - p.get("x.x1")) < 5e-11


@pytest.mark.parametrize("rate", [60.0, 1000.0])
def test_a_stiff_linear_part_shortens_the_prediction_step(rate):
    model = Model(
        name="stiff",
        states=[Variable("a", start=1.0), Variable("b", start=0.5)],
        outputs=[Variable("y1"), Variable("y2")],
        ode=lambda x, u, p, t: [-rate * (x.a - x.b), ca.sin(t) - x.b],
        output=lambda x, u, p, t: [x.a, x.b],
    )
    p, o = Instance(plant(model)), Instance(pseudospectral(model, sample_time=0.1, N=15, L=4))
    for k in range(40):
        o.set("y1", p.get("y1"))
        o.set("y2", p.get("y2"))
        p.step(0.1 * k, 0.1)
        o.step(0.1 * k, 0.1)
        if k > 4:
            assert abs(o.get("estimate.a") - p.get("x.a")) < 3e-8


def test_a_window_without_any_information_is_said_not_to_determine_the_state():
    model = Model(
        name="square",
        states=[Variable("a", start=1.0), Variable("b", start=0.5)],
        outputs=[Variable("y1"), Variable("y2")],
        ode=lambda x, u, p, t: [-x.a, -0.5 * x.b],
        output=lambda x, u, p, t: [x.a**2, x.b**2],
    )
    _, o = coupled(model, pseudospectral(model, sample_time=0.1, N=15), 20, 0.1, guess={"guess.a": 0.0, "guess.b": 0.0})
    assert o.get("diagnostics.status") == CODE.undetermined


def test_an_output_that_jumps_is_not_taken_for_a_linear_one():
    model = Model(
        name="pendulum",
        states=[Variable("angle", start=1.0), Variable("rate", start=5.5)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.rate, -ca.sin(x.angle)],
        output=lambda x, u, p, t: [ca.fmod(x.angle, 2 * ca.pi)],
    )
    errors, _ = coupled(model, pseudospectral(model, sample_time=0.05, N=12, L=10), 60, 0.05)
    assert errors.max() < 3e-9


@pytest.mark.parametrize("unit", [1e-8, 1.0, 1e6])
def test_the_estimate_does_not_depend_on_the_outputs_unit(unit):
    model = Model(
        name="scaled",
        states=DUFFING.states,
        parameters=DUFFING.parameters,
        inputs=DUFFING.inputs,
        unknown_parameters=DUFFING.unknown_parameters,
        outputs=[Variable("y", nominal=unit)],
        ode=DUFFING.ode,
        output=lambda x, u, p, t: [unit * (x.x1 + 0.5 * x.x2)],
    )
    errors, o = coupled(model, pseudospectral(model, sample_time=0.1, N=15), 60, 0.1, guess={"guess.theta": 0.1})
    assert errors[8:].max() < 1e-7 and o.get("diagnostics.solver_failures") == 0


@pytest.mark.parametrize("missing", [[0], [3], [3, 4]])
def test_with_the_spline_cost_a_flat_guess_is_never_taken_for_data(missing):
    p = Instance(plant(DUFFING))
    o = Instance(
        pseudospectral(DUFFING, sample_time=0.1, cost="spline"), {"guess.x1": 0.0, "guess.x2": 0.0, "guess.theta": 0.1}
    )
    for k in range(60):
        true = p.get("x.x1")
        o.set("y", np.nan if k in missing else p.get("y"))
        p.step(0.1 * k, 0.1)
        o.step(0.1 * k, 0.1)
        if o.get("diagnostics.status") == CODE.estimating:
            assert abs(o.get("filtered.x1") - true) < 8e-4
    assert o.get("diagnostics.status") == CODE.estimating


@pytest.mark.parametrize(("N", "L"), [(3, 8), (4, 8)])
def test_an_order_too_low_for_the_window_is_said_where_it_costs_most(N, L):
    p, o = Instance(plant(DUFFING)), Instance(pseudospectral(DUFFING, sample_time=0.1, N=N, L=L))
    wrong = []
    for k in range(200):
        true = p.get("x.theta")
        o.set("y", p.get("y"))
        p.step(0.1 * k, 0.1)
        o.step(0.1 * k, 0.1)
        if o.get("diagnostics.status") == CODE.estimating:
            wrong.append(abs(o.get("filtered.theta") - true))
    assert max(wrong, default=0.0) < 1.0  # up to 7 with the paper's bound on the residual as the limit


def test_one_dead_sensor_of_two_does_not_hide_what_the_other_says():
    observer = pseudospectral(linear(), sample_time=0.1, N=12, L=6)
    p, o = Instance(plant(linear()), {"start.x1": 1.0}), Instance(observer, {"tuning.residual_limit": 0.1})
    statuses = []
    for k in range(40):
        o.set("y1", p.get("y1") + (3.0 * (-1) ** k if k >= 30 else 0.0))
        o.set("y2", np.nan if k >= 10 else p.get("y2"))
        p.step(0.1 * k, 0.1)
        o.step(0.1 * k, 0.1)
        statuses.append(int(o.get("diagnostics.status")))
    assert set(statuses[10:30]) == {CODE.sample_rejected}
    assert CODE.inconsistent in statuses[30:]
    assert o.get("diagnostics.rejected_samples") == 30


def test_windows_that_can_never_suffice_and_orders_that_are_no_numbers_are_refused():
    with pytest.raises(ValueError, match=r"L = 1 gives 2 measurements in a window, too few for the 3 states"):
        pseudospectral(DUFFING, sample_time=0.1, L=1)
    with pytest.raises(ValueError, match=r"N = the number 15\.0, where a whole number is wanted"):
        pseudospectral(DUFFING, sample_time=0.1, N=15.0)  # type: ignore[arg-type]
