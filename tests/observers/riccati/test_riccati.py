"""The Riccati observer: against Kalman filters and scipy's integration, and where a step, a sample or a design fails."""

import math

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from linear_models import entries, kalman, linear
from observers.instance import Instance
from observers.model import Model, ModelError, Variable
from observers.riccati import riccati
from observers.riccati.certificates import NONE
from observers.status import CODE
from reference_models.james_baras_5_2 import JAMES_BARAS_5_2
from reference_models.plant import plant

TEXTBOOK = {"tuning.gate": 1e9}  # measurements of no motion act all the same


@pytest.mark.parametrize("stiff", [False, True], ids=["Runge-Kutta", "exponential"])
@pytest.mark.parametrize("parts", [1, 2])
def test_with_diagonal_tuning_and_either_step_it_is_the_sampled_kalman_filter(stiff, parts):
    n, ny, Ts = 4, 2, 0.1
    rng = np.random.default_rng(n)
    A, C = rng.normal(size=(n, n)) - np.eye(n), rng.normal(size=(ny, n))
    N, R, Q0 = rng.uniform(0.5, 2, n), rng.uniform(0.5, 2, ny), rng.uniform(0.5, 2, n)
    component = riccati(linear(n, ny), sample_time=Ts, N=N, R=R, Q0=Q0, expose=["Q"], stiff=stiff)
    y, u, m0 = rng.normal(size=(60, ny)), rng.normal(size=60), rng.normal(size=n)
    guess = {f"guess.x{i}": value for i, value in enumerate(m0)}
    run = Instance(component, entries(A, C) | guess | TEXTBOOK)
    names = [f"estimate.x{i}" for i in range(n)] + [
        f"diagnostics.Q[{i},{j}]" for i in range(1, n + 1) for j in range(1, n + 1)
    ]
    for k, expected in enumerate(kalman(A, C, np.diag(N), np.diag(R), np.diag(Q0), m0, y, u, Ts)):
        for i in range(ny):
            run.set(f"y{i}", y[k, i])
        run.set("u", u[k])
        for part in range(parts):
            run.step((k + part / parts) * Ts, Ts / parts)
        np.testing.assert_allclose([run.get(name) for name in names], expected, rtol=0, atol=1e-12)


def test_a_rejected_output_leaves_the_estimate_to_the_others_and_all_rejected_to_the_model():
    A, C = np.array([[-1.0, 0.5], [0.0, -0.3]]), np.eye(2)
    component = riccati(linear(2, 2), sample_time=0.1, N=1.0)
    one, none = (Instance(component, {**entries(A, C), "guess.x0": 1.0}) for _ in range(2))
    one.set("y0", math.nan)
    one.set("y1", 3.0)
    none.set("y0", math.inf)
    none.set("y1", math.nan)
    for run in (one, none):
        run.step(0.0, 0.1)
        assert run.get("diagnostics.status") >= CODE.sample_rejected  # or what is graver, such as the start
        assert run.get("diagnostics.rejected_samples") == 1
        assert np.isfinite(run.z).all()
    np.testing.assert_allclose(
        [none.get("estimate.x0"), none.get("estimate.x1")], expm(0.1 * A) @ [1.0, 0.0], rtol=0, atol=1e-14
    )
    assert one.get("filtered.x1") == pytest.approx(3.0 / (1 + 10))  # Q0 = 1, Rd = 1 / 0.1
    assert one.get("filtered.x0") == 1.0


def test_a_model_that_escapes_to_infinity_is_held_counted_and_starts_again():
    """From 30 it is gone after half a millisecond, whatever is measured; from near 0 it stays over a sample, and is estimated."""
    model = Model(
        name="escape",
        states=[Variable("x", start=30.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.x**3],
        output=lambda x, u, p, t: [x.x],
    )
    run = Instance(riccati(model, sample_time=0.1, stiff=False))
    for k in range(60):
        run.set("y", 30.0 if k < 30 else 0.0)
        failures = run.get("diagnostics.solver_failures")
        run.step(0.1 * k, 0.1)
        assert np.isfinite(run.z).all()
        failed = run.get("diagnostics.solver_failures") > failures  # one a substep
        assert failed == (run.get("diagnostics.status") == CODE.solver_failed)
        assert run.get("estimate.x") == 30.0 or not failed
        assert failed or k >= 30
    assert not failed and abs(run.get("estimate.x")) < 0.02


def test_a_stiff_drift_takes_the_exponential_step():
    model = Model(
        name="stiff",
        states=[Variable("x1", start=1.0), Variable("x2", start=1.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-1e4 * (x.x1 - ca.cos(x.x2)), -x.x2 + 0.1 * ca.sin(t)],
        output=lambda x, u, p, t: [x.x2],
    )
    run, true = Instance(riccati(model, sample_time=0.05, guess={"x2": 0.2})), np.array([1.0, 1.0])
    for k in range(100):
        run.set("y", true[1])
        run.step(0.05 * k, 0.05)
        true = solve_ivp(
            lambda t, x: [-1e4 * (x[0] - math.cos(x[1])), -x[1] + 0.1 * math.sin(t)],
            (0.05 * k, 0.05 * (k + 1)), true, method="Radau", rtol=1e-9, atol=1e-11,
        ).y[:, -1]  # fmt: skip
    assert abs(run.get("estimate.x1") - true[0]) < 1e-3 and abs(run.get("estimate.x2") - true[1]) < 1e-3


def test_an_unknown_parameter_is_estimated_as_a_state_that_does_not_move():
    model = Model(
        name="decay",
        states=[Variable("x", start=1.0)],
        unknown_parameters=[Variable("theta", start=0.5)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-p.theta * x.x + 1],
        output=lambda x, u, p, t: [x.x],
    )
    run = Instance(riccati(model, sample_time=0.01, N=[0.1, 0.5], R=0.01, guess={"theta": 0.2}))
    true = Instance(plant(model))
    for k in range(2000):
        run.set("y", true.get("y"))
        for one in (run, true):
            one.step(0.01 * k, 0.01)
    assert run.get("estimate.theta") == pytest.approx(0.5, abs=4e-14)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"N": [1.0, 0.0]}, ("N", "x2", "0")),
        ({"N": [1.0, 2.0, 3.0]}, ("N", "(3,)", "(2,)")),
        ({"R": math.nan}, ("R", "nan")),
        ({"N": [1.0, math.nan]}, ("N", "nan", "not finite")),
        ({"Q0": [[1.0, 0.0], [math.nan, 1.0]]}, ("Q0", "nan", "not finite")),
        ({"N": [[1.0, 1.0], [1.0, 1.0]]}, ("N", "singular", "rank 1 of 2")),
        ({"Q0": [[1.0, 2.0], [2.0, 1.0]]}, ("Q0", "positive definite")),
        ({"expose": ["P"]}, ("expose", "'P'", "Q")),
    ],
)
def test_an_impossible_design_is_refused_by_name(arguments, words):
    with pytest.raises(ValueError) as caught:
        riccati(JAMES_BARAS_5_2, sample_time=0.01, **arguments)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize("rate", [-1.0, 0.0, 0.5])
def test_a_state_that_no_output_sees_is_refused_by_name_unless_it_decays(rate):
    model = Model(
        name="blind",
        states=[Variable("seen"), Variable("unseen")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-x.seen, rate * x.unseen],
        output=lambda x, u, p, t: [x.seen],
    )
    if rate < 0:
        run = Instance(riccati(model, sample_time=0.1), {"guess.unseen": 1.0})
        run.step(0.0, 0.1)
        assert run.get("estimate.unseen") == pytest.approx(math.exp(-0.1), rel=1e-14, abs=0)
    else:
        with pytest.raises(ModelError, match=r"blind.*unseen"):
            riccati(model, sample_time=0.1)


@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_given_standard_deviations_it_is_the_kalman_filter_of_these_with_missing_samples_too(missing):
    n, ny, Ts = 3, 2, 0.1
    rng = np.random.default_rng(4)
    A, C = rng.normal(size=(n, n)) - np.eye(n), rng.normal(size=(ny, n))
    process, sensor, first = rng.uniform(0.5, 2, n), np.array([0.1, 3.0]), rng.uniform(0.5, 2, n)
    component = riccati(
        linear(n, ny),
        sample_time=Ts,
        process_noise={f"x{i}": v for i, v in enumerate(process)},
        measurement_noise={f"y{i}": v for i, v in enumerate(sensor)},
        initial_std={f"x{i}": v for i, v in enumerate(first)},
        expose=["Q"],
    )
    y, u = rng.normal(size=(60, ny)), rng.normal(size=60)
    y[rng.random(y.shape) < missing] = np.nan
    run = Instance(component, entries(A, C) | TEXTBOOK)
    names = [f"estimate.x{i}" for i in range(n)]
    names += [f"diagnostics.Q[{i},{j}]" for i in range(1, n + 1) for j in range(1, n + 1)]
    filtered = kalman(A, C, np.diag(process), np.diag(sensor) * math.sqrt(Ts), np.diag(first**2), np.zeros(n), y, u, Ts)
    for k, expected in enumerate(filtered):
        for i in range(ny):
            run.set(f"y{i}", 1e6 if np.isnan(y[k, i]) else y[k, i])
            run.set(f"measurement_valid.y{i}", float(np.isfinite(y[k, i])))
        run.set("u", u[k])
        run.step(k * Ts, Ts)
        np.testing.assert_allclose([run.get(name) for name in names], expected, rtol=0, atol=2e-11)
    assert run.get("diagnostics.rejected_samples") == 0


def test_the_same_tuning_in_both_ways_is_refused_by_name():
    for paper, deviation in (
        ({"N": 1.0}, {"process_noise": {}}),
        ({"R": 1.0}, {"measurement_noise": {}}),
        ({"Q0": 1.0}, {"initial_std": {}}),
    ):
        with pytest.raises(ValueError, match=f"{next(iter(paper))} and {next(iter(deviation))} say the same thing"):
            riccati(JAMES_BARAS_5_2, sample_time=0.01, **paper, **deviation)
    with pytest.raises(ModelError, match="N of 'z'; known: x1, x2"):
        riccati(JAMES_BARAS_5_2, sample_time=0.01, N={"z": 1.0})


def test_by_name_the_papers_matrices_are_diagonals_and_a_name_that_is_absent_is_1():
    named, listed = (riccati(JAMES_BARAS_5_2, sample_time=0.01, N=N) for N in ({"x2": 0.3}, [1.0, 0.3]))
    assert named.parameters == listed.parameters


def test_without_process_noise_it_runs_and_certifies_nothing():
    component = riccati(JAMES_BARAS_5_2, sample_time=0.01, process_noise={"x1": 0.0, "x2": 0.0})
    run = Instance(component)
    run.step(0.0, 0.01)
    assert run.get("diagnostics.certified") == NONE and np.isfinite(run.outputs()).all()


def test_a_certificate_for_a_samples_deviation_is_void_at_another_sample_time():
    component = riccati(
        JAMES_BARAS_5_2, sample_time=0.01, N=math.sqrt(0.2), Q0=0.01, measurement_noise={"y": 30.0}, guess={"x1": 0.0}
    )
    for Ts, certified in ((0.01, True), (0.02, False)):
        run = Instance(component, {"sample_time": Ts})
        run.step(0.0, Ts)
        assert (run.get("diagnostics.certified") != NONE) == certified


def test_the_tunings_units_are_the_variables_and_what_fmi_cannot_say_stands_in_the_description():
    model = Model(
        name="moved",
        states=[Variable("s", unit="m"), Variable("v", unit="m/s")],
        outputs=[Variable("y", unit="m")],
        ode=lambda x, u, p, t: [x.v, -x.s],
        output=lambda x, u, p, t: [x.s],
    )
    by_name = riccati(model, sample_time=0.1, process_noise={}, measurement_noise={}, initial_std={})
    whole = riccati(model, sample_time=0.1, N=np.eye(2), Q0=np.eye(2))
    units = {port.name: port.unit for port in (*by_name.parameters, *whole.parameters)}
    assert units["tuning.measurement_noise.y"] == "m" and units["tuning.initial_std.v"] == "m/s"
    assert units["tuning.Q0[1,2]"] == "m2/s" and units["tuning.Q0[2,2]"] == "m2/s2"
    texts = {port.name: port.description for port in (*by_name.parameters, *whole.parameters)}
    for name, words in (
        ("tuning.process_noise.v", "in m/s per sqrt(s)"),
        ("tuning.N[2,1]", "in m/s per sqrt(s)"),
        ("tuning.R.y", "in m times sqrt(s)"),
    ):
        assert units[name] == "" and words in texts[name]


def test_what_nobody_gives_is_the_tables_default():
    """The table of the page: parts of the nominal values, over sqrt(Ts) where it is an intensity; 1 beside one of the paper's matrices."""
    model = Model(
        name="sizes",
        states=[Variable("x", start=0.0, nominal=50.0)],
        unknown_parameters=[Variable("k", nominal=0.4)],
        outputs=[Variable("y", nominal=3.0)],
        ode=lambda x, u, p, t: [p.k - x.x],
        output=lambda x, u, p, t: [x.x],
    )

    def starts(**given):
        made = riccati(model, sample_time=0.25, **given).parameters
        return {port.name.removeprefix("tuning."): port.start for port in made if port.name.startswith("tuning.")}

    expected = {"process_noise.x": 5e-4 * 50 / 0.5, "process_noise.k": 2e-3 * 0.4 / 0.5}
    expected |= {"measurement_noise.y": 0.3, "initial_std.x": 50.0, "initial_std.k": 0.4}
    found = starts()
    assert {name: found[name] for name in expected} == pytest.approx(expected, rel=1e-15, abs=0)
    found = starts(measurement_noise={})
    assert {name: found[name] for name in expected} == pytest.approx(expected, rel=1e-15, abs=0)
    found = starts(R=2.0)
    expected = {"N.x": 1.0, "N.k": 1.0, "R.y": 2.0, "Q0.x": 1.0, "Q0.k": 1.0}
    assert {name: found[name] for name in expected} == expected
