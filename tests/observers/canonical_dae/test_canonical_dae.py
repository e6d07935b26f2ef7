"""The canonical DAE observer against closed forms, scipy and the DAE itself, in Python."""

import dataclasses
import math

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_are

from observers.canonical_dae import canonical_dae, fault_detector
from observers.canonical_dae.dae import relaxed
from observers.canonical_dae.gain import exact, regional
from observers.canonical_dae.region import region
from observers.instance import Instance
from observers.model import Model, ModelError, Variable
from observers.status import CODE
from reference_models.double_integrator import MASS_WITH_UNKNOWN_FORCE
from reference_models.motor import MOTOR

P = {v.name: v.start for v in MOTOR.parameters}
A1, A2, B1, B2, D1, D2 = (P[name] for name in ("A1", "A2", "B1", "B2", "D1", "D2"))
POINTS = np.random.default_rng(0).uniform([0.1, -5, -10], [3, 5, 20], (20, 3))


def drive(t):
    return 2 * (1 + np.sin(2 * t))


def motor_rates(t, x):
    return [
        x[1],
        B1 - A1 * x[1] - A2 * x[2] * np.sin(x[0]) - B2 / 2 * np.sin(2 * x[0]),
        drive(t) - D1 * x[2] + D2 * np.cos(x[0]),
    ]


def motor_jacobian(x):
    return np.array(
        [
            [0, 1, 0],
            [-A2 * x[2] * np.cos(x[0]) - B2 * np.cos(2 * x[0]), -A1, -A2 * np.sin(x[0])],
            [-D2 * np.sin(x[0]), 0, -D1],
        ]
    )


def gamma(gain, model, x, u, tuning):
    no_relaxation = np.zeros(gain.gamma.numel_in(4))
    return gain.gamma(x, u, [v.start for v in model.parameters], 0, no_relaxation, tuning)[0].full()


def follow(component, measured, names, stop, Ts, inputs=None, parameters=None):
    """filtered.<names> at 0, Ts, ... of an observer that sees `measured(t)`; (times, values (k x len(names)), instance)."""
    run, found = Instance(component, parameters), []
    times = np.arange(round(stop / Ts) + 1) * Ts
    signals = [port for port in component.inputs if port.kind == "Real"]
    for t in times:
        for port, value in zip(signals, [*measured(t), *(inputs(t) if inputs else [])], strict=True):
            run.set(port.name, value)
        run.step(t, Ts)
        found.append([run.get(name) for name in names])
    return times, np.array(found), run


def test_the_gain_made_by_differentiation_is_the_corrected_closed_form_5_6():
    gain = exact(relaxed(MOTOR), region(MOTOR), [-10.0] * 3)
    assert "v = (1, 0)" in gain.description
    for x in POINTS:
        expected = [
            [30 - A1 - D1, -1],
            [300 - 30 * A1 + A1**2 - 30 * D1 + A1 * D1 + D1**2, A1],
            [(D1 - 10) ** 3 / (A2 * np.sin(x[0])), 0],
        ]
        found = gamma(gain, MOTOR, x, 2.0, [-10, -10, -10, 1e-9])
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-10)


def test_the_printed_sign_of_5_6_gives_an_eigenvalue_of_plus_2_19_somewhere_and_ours_gives_the_poles():
    C = np.eye(3)[:2]
    x = np.array([0.8, 0.1, 10.0])
    G = gamma(exact(relaxed(MOTOR), region(MOTOR), [-10.0] * 3), MOTOR, x, 2.0, [-10, -10, -10, 1e-9])
    ours = np.linalg.eigvals(motor_jacobian(x) - (motor_jacobian(x) @ C.T + G) @ C)
    np.testing.assert_allclose(np.poly(ours), np.poly([-10, -10, -10]), rtol=1e-13)
    G[2, 0] = -G[2, 0]
    printed = np.linalg.eigvals(motor_jacobian(x) - (motor_jacobian(x) @ C.T + G) @ C)
    assert printed.real.max() == pytest.approx(2.19, abs=0.01)


@pytest.mark.parametrize("X", [[2.0, 0.5], [[2.0, -0.5], [-0.5, 1.0]]], ids=["diagonal", "full"])
def test_the_regional_gain_is_scipys_riccati_solution_and_shifts_the_eigenvalues_beyond_alpha(X):
    gain, C = regional(relaxed(MOTOR), 10.0, X), np.eye(3)[:2]
    tuning = [port.start for port in gain.tuning[:-1]]
    X = np.diag(X) if np.ndim(X) == 1 else np.array(X)
    for x in POINTS:
        A = motor_jacobian(x)
        expected = solve_continuous_are((A + 10 * np.eye(3)).T, C.T, np.eye(3), np.linalg.inv(X)) @ C.T @ X / 2
        found = gamma(gain, MOTOR, x, 2.0, [*tuning, 1e-9])
        np.testing.assert_allclose(found, (expected @ C - A) @ C.T, rtol=1e-6, atol=1e-6)
        assert np.linalg.eigvals(A - (A @ C.T + found) @ C).real.max() < -10


def test_a_non_cyclic_pair_gets_a_preliminary_injection():
    twins = Model(
        name="twins",
        states=[Variable("a", start=1.0), Variable("b", start=-1.0)],
        outputs=[Variable("y1"), Variable("y2")],
        ode=lambda x, u, p, t: [-x.a, -x.b],  # A = -I is not cyclic
        output=lambda x, u, p, t: [x.a, x.b],
    )
    gain = exact(relaxed(twins), region(twins), [-3.0, -4.0])
    assert "J_p" in gain.description
    J = gamma(gain, twins, [0.3, 0.4], [], [-3, -4, 1e-9]) - np.eye(2)  # (3.2) with A = -I, C = I
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(-np.eye(2) - J).real), [-4, -3], rtol=1e-13)


AUTONOMOUS = dataclasses.replace(  # u inside the ODE, exactly: held or interpolated, it would limit the order
    MOTOR,
    inputs=(),
    ode=lambda x, u, p, t: [
        x.x2,
        p.B1 - p.A1 * x.x2 - p.A2 * x.x3 * ca.sin(x.x1) - 0.5 * p.B2 * ca.sin(2 * x.x1),
        2 * (1 + ca.sin(2 * t)) - p.D1 * x.x3 + p.D2 * ca.cos(x.x1),
    ],
)


@pytest.fixture(scope="module")
def truth():
    return solve_ivp(motor_rates, (0, 6.1), [0.8, 0.1, 10], method="DOP853", rtol=1e-12, atol=1e-13, dense_output=True)


def largest_after_4(truth, Ts, **options):
    component = canonical_dae(AUTONOMOUS, sample_time=Ts, **options)
    times, x3, run = follow(component, lambda t: truth.sol(t)[:2], ["filtered.x3"], 6.0, Ts, parameters={"guess.x3": 0})
    assert run.get("diagnostics.solver_failures") == 0
    settled = times > 4
    return np.abs(x3[settled, 0] - truth.sol(times[settled])[2]).max()


def test_the_w_form_is_as_exact_as_runge_kutta_and_the_cubic_are(truth):
    # errata: 4e-9, 1.5e-5, 0.012
    for Ts, expected in ((1e-3, 4.3e-9), (0.01, 1.5e-5), (0.05, 0.0122)):
        assert largest_after_4(truth, Ts) == pytest.approx(expected, rel=0.1)


def test_regional_placement_meets_the_reference_by_backward_differentiation_of_order_3_at_10_ms(truth):
    component = canonical_dae(AUTONOMOUS, sample_time=0.01, gain="regional", alpha=10.0, form="bdf", order=3)
    times, x3, _ = follow(component, lambda t: truth.sol(t)[:2], ["filtered.x3"], 1.0, 0.01, parameters={"guess.x3": 0})
    errors = np.abs(x3[:, 0] - truth.sol(times)[2])[[20, 50, 100]]
    np.testing.assert_allclose(errors, [0.355, 0.194, 3.1e-3], rtol=0.03)  # errata: |e3| at t = 0.2, 0.5, 1


# At 5 ms order 6 is as exact as the observer has converged by then, to 4e-9.
@pytest.mark.parametrize(("order", "Ts"), [(1, 0.01), (2, 0.01), (3, 0.01), (4, 0.01), (5, 0.01), (6, 0.02)])
def test_backward_differentiation_has_its_order(truth, order, Ts):
    coarse, fine = (largest_after_4(truth, step, form="bdf", order=order) for step in (Ts, Ts / 2))
    assert order - 0.35 < math.log2(coarse / fine) < order + 1.0


CURVED = Model(
    name="curved",
    states=[Variable("a", start=1.0), Variable("b", start=0.3)],
    outputs=[Variable("y")],
    ode=lambda x, u, p, t: [-0.5 * x.a + x.b + 1, ca.cos(x.a) - x.b],
    output=lambda x, u, p, t: [x.a + 0.2 * x.a**2 + 0.1 * ca.sin(x.b)],
)


def curved_reference(stop):
    """(2.7) for CURVED with Gamma = (2, 1), the plant from (1, 0.3), by scipy: states, estimates, lambda."""
    a, b, x1, x2, lam = (ca.SX.sym(name) for name in ("a", "b", "x1", "x2", "lam"))
    f = ca.Function("f", [a, b], [ca.vertcat(-0.5 * a + b + 1, ca.cos(a) - b)])
    h = ca.Function("h", [a, b], [a + 0.2 * a**2 + 0.1 * ca.sin(b)])
    C = ca.jacobian(h(x1, x2), ca.vertcat(x1, x2))
    y_dot = ca.jtimes(h(a, b), ca.vertcat(a, b), f(a, b))
    rate = f(x1, x2) + ca.vertcat(2, 1) * lam
    lam_dot = (y_dot - ca.mtimes(C, rate)) / ca.sumsqr(C)
    rhs = ca.Function("rhs", [ca.vertcat(a, b, x1, x2, lam)], [ca.vertcat(f(a, b), rate + C.T * lam_dot, lam_dot)])
    first = np.array([1.0, 0.3, 1.0, -0.5])
    # The guess (1, -0.5), projected onto h(x) = y.
    unknown = ca.vertcat(x1, x2, lam)
    gap = ca.vertcat(ca.vertcat(x1, x2) - C.T * lam - first[2:], h(x1, x2) - h(1.0, 0.3))
    found = ca.rootfinder("project", "newton", {"x": unknown, "g": gap})(x0=[*first[2:], 0])["x"].full().ravel()
    return solve_ivp(
        lambda t, z: rhs(z).full().ravel(),
        (0, stop),
        [1.0, 0.3, *found[:2], 0],
        rtol=1e-11,
        atol=1e-12,
        dense_output=True,
    ), h


@pytest.mark.parametrize(
    ("options", "order"), [({"form": "w"}, 3.0), ({"form": "bdf", "order": 1}, 0.8), ({"form": "bdf", "order": 2}, 1.7)]
)
def test_both_forms_follow_the_papers_dae_for_a_nonlinear_output_as_the_step_shrinks(options, order):
    reference, h = curved_reference(3.0)
    gaps = []
    for Ts in (0.04, 0.02):
        component = canonical_dae(CURVED, sample_time=Ts, gain=lambda x, u, p, t: [[2], [1]], **options)
        names = ["filtered.a", "filtered.b", "diagnostics.lambda", "diagnostics.solver_failures"]
        times, found, _ = follow(
            component, lambda t: [float(h(*reference.sol(t)[:2]))], names, 2.9, Ts, parameters={"guess.b": -0.5}
        )
        assert found[-1, 3] == 0
        # All trajectories of the observer approach the state: compare from 1 s on, where they are still apart by 1e-2.
        gaps.append(np.abs(found[:, :3] - reference.sol(times)[2:].T)[times > 1].max())
    assert gaps[1] < 1e-2 and math.log2(gaps[0] / gaps[1]) > order
    np.testing.assert_allclose(
        found[-1, 0] + 0.2 * found[-1, 0] ** 2 + 0.1 * np.sin(found[-1, 1]), float(h(*reference.sol(times[-1])[:2]))
    )


def test_a_measurement_that_no_state_explains_fails_the_solve_and_keeps_the_prediction():
    square = Model(
        name="square",
        states=[Variable("a", start=1.0, min=0.5, max=2.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-0.1 * x.a],
        output=lambda x, u, p, t: [x.a**2],
    )
    for form in ("w", "bdf"):
        run = Instance(canonical_dae(square, sample_time=0.1, poles=[-2.0], form=form))
        for k in range(30):
            run.set("y", -1.0 if k == 12 else math.exp(-0.02 * k))
            prediction = run.get("estimate.a")
            run.step(0.1 * k, 0.1)
            failed = k == 12
            assert run.get("diagnostics.status") in (
                [CODE.solver_failed] if failed else [CODE.settling, CODE.estimating]
            )
            if failed:
                assert run.get("filtered.a") == prediction and run.get("diagnostics.lambda") == 0
        assert run.get("diagnostics.solver_failures") == 1
        assert run.get("estimate.a") == pytest.approx(math.exp(-0.3), abs=1e-13)


@pytest.mark.parametrize("form", ["w", "bdf"])
def test_a_measurement_that_is_not_finite_leaves_the_prediction_and_one_of_two_only_itself(form):
    component = canonical_dae(MOTOR, sample_time=0.001, form=form, guess={"x3": 0.0})
    run, truth_x = Instance(component), np.array([0.8, 0.1, 10.0])
    run.set("u", 2.0)
    for k in range(1200):
        y = [truth_x[0], truth_x[1]]
        prediction = [run.get(f"estimate.{name}") for name in ("x1", "x2", "x3")]
        before = run.get("diagnostics.lambda[1]")
        if k in (1000, 1001, 1002):
            y = [math.nan, math.inf]
        if k == 1010:
            y[1] = math.nan
        run.set("y1", y[0])
        run.set("y2", y[1])
        run.step(k * 0.001, 0.001)
        if k in (1000, 1001, 1002):
            assert [run.get(f"filtered.{name}") for name in ("x1", "x2", "x3")] == prediction
            assert run.get("diagnostics.lambda[1]") == before and run.get("diagnostics.status") >= CODE.sample_rejected
        if k == 1010:
            assert [run.get("filtered.x1"), run.get("filtered.x2")] == [y[0], prediction[1]]
        assert np.isfinite(run.z).all()
    assert run.get("diagnostics.rejected_samples") == 4


def test_an_unknown_parameter_is_a_state_with_zero_rate():
    cooling = Model(
        name="cooling",
        states=[Variable("temperature", start=2.0)],
        unknown_parameters=[Variable("rate", start=0.2, min=0.1, max=1.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [1 - p.rate * x.temperature],
        output=lambda x, u, p, t: [x.temperature],
    )
    component = canonical_dae(cooling, sample_time=0.05, poles=[-1.0, -1.5])
    exact_y = lambda t: [2.5 - 0.5 * math.exp(-0.4 * t)]  # noqa: E731
    _, found, _ = follow(component, exact_y, ["filtered.rate"], 25.0, 0.05)
    assert found[0, 0] == pytest.approx(0.2, abs=0.01) and found[-1, 0] == pytest.approx(0.4, abs=1e-6)


@pytest.mark.parametrize("form", ["w", "bdf"])
def test_an_unknown_force_is_estimated_and_the_velocity_is_not_disturbed_by_it(form):
    component = canonical_dae(MASS_WITH_UNKNOWN_FORCE, sample_time=0.01, form=form, poles=[-5.0])
    position, velocity, force = (lambda t: 1 - np.cos(t)), np.sin, np.cos
    names = ["filtered.force", "filtered.x2", "diagnostics.lambda"]
    times, found, _ = follow(
        component, lambda t: [position(t), velocity(t)], names, 5.0, 0.01, parameters={"guess.x2": 3}
    )
    mean = (velocity(times) - velocity(times - 0.01)) / 0.01
    expected = mean if form == "w" else force(times)
    assert np.abs(found[5:, 0] - expected[5:]).max() < 4e-4
    assert np.abs(found[:, 1] - velocity(times)).max() < 1e-9 and np.abs(found[300:, 2]).max() < 1e-3


def unfit(**changes):
    return dataclasses.replace(MOTOR, **changes)


def two(ode, output, **more):
    return Model(
        **{
            "name": "two",
            "states": [Variable("a"), Variable("b")],
            "outputs": [Variable(f"y{i}") for i in range(len(output(*[_Any()] * 4)))],
            "ode": ode,
            "output": output,
        }
        | more
    )


class _Any:
    """Stands for any group of names, to count a model's outputs."""

    def __getattr__(self, name):
        return ca.SX.sym(name)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (
            lambda: two(lambda x, u, p, t: [x.b, x.a], lambda x, u, p, t: [x.a, 2 * x.a]),
            ("h_x", "rank 1, not 2", "a ="),
        ),
        (
            lambda: two(lambda x, u, p, t: [x.a, x.b], lambda x, u, p, t: [x.a]),
            ("rank 1, not 2", "no gain moves its eigenvalue 1", "b ="),
        ),
        (
            lambda: two(lambda x, u, p, t: [x.a, x.b], lambda x, u, p, t: [x.a, x.b, x.a + x.b]),
            ("3 outputs for 2 states",),
        ),
        (
            lambda: two(lambda x, u, p, t: [x.b, u.w], lambda x, u, p, t: [x.a + x.a * u.w], inputs=[Variable("w")]),
            ("y0", "other than by a sum", "linear"),
        ),
        (
            lambda: two(
                lambda x, u, p, t: [x.b, 0], lambda x, u, p, t: [x.a + u.w, x.b], unknown_disturbances=[Variable("w")]
            ),
            ("y0", "depends on an unknown disturbance"),
        ),
        (
            lambda: unfit(
                unknown_disturbances=[Variable("load")],
                ode=lambda x, u, p, t: [x.x2, -x.x1 - x.x3, -x.x3 + u.load],
            ),
            ("load", "rank 0, not 1", "index"),
        ),
        (
            lambda: two(lambda x, u, p, t: [x.b, u.w], lambda x, u, p, t: [x.a], unknown_disturbances=[Variable("w")]),
            ("w", "rank 0, not 1", "index"),
        ),
        (
            lambda: two(
                lambda x, u, p, t: [u.v, u.w],
                lambda x, u, p, t: [x.a],
                unknown_disturbances=[Variable("v"), Variable("w")],
            ),
            ("2 unknown disturbances (v, w) and 1 outputs", "index"),
        ),
        (
            lambda: unfit(
                unknown_disturbances=[Variable("load")],
                ode=lambda x, u, p, t: [x.x2, -x.x1 - x.x3 + x.x1 * u.load, -x.x3],
            ),
            ("load", "constant coefficients"),
        ),
        (
            lambda: unfit(
                unknown_disturbances=[Variable("load")],
                ode=lambda x, u, p, t: [x.x2, -x.x1 - x.x3 + u.load, -x.x3],
            ),
            ("load", "rank 1, not 2", "no gain moves its eigenvalue -1"),
        ),
    ],
    ids=[
        "dependent",
        "unobservable",
        "too many",
        "input inside",
        "disturbed output",
        "index 2",
        "unmeasured force",
        "too few outputs",
        "state times load",
        "hidden",
    ],
)
def test_a_model_that_breaks_an_assumption_is_refused_by_name(make, words):
    with pytest.raises(ModelError) as caught:
        canonical_dae(make(), sample_time=0.01)
    for word in words:
        assert word in str(caught.value), caught.value


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"sample_time": 0.0}, ("sample_time", "0")),
        ({"form": "euler"}, ("form", "euler")),
        ({"form": "bdf", "order": 7}, ("order", "7")),
        ({"poles": [-1.0]}, ("poles", "3")),
        ({"poles": [-1.0, 0.0, -1.0]}, ("poles", "real parts")),
        ({"poles": [-1.0, -1.0 + 2.0j, -1.0]}, ("-1+2j", "conjugate")),
        ({"gain": "best"}, ("gain", "best")),
        ({"gain": "regional", "alpha": -1.0}, ("alpha", "-1")),
        ({"gain": "regional", "X": [1.0]}, ("X", "2 numbers or a 2 x 2 matrix")),
        ({"gain": "regional", "X": [[1.0, 2.0], [2.0, 1.0]]}, ("X", "positive definite")),
        ({"gain": "regional", "X": [[1.0, 0.2], [0.1, 1.0]]}, ("X", "symmetric")),
        ({"degree": 10}, ("degree", "10")),
        ({"gain": lambda x, u, p, t: [[1, 2]]}, ("3 rows of 2",)),
    ],
    ids=[
        "sample_time",
        "form",
        "order",
        "poles",
        "stable",
        "lonely",
        "gain",
        "alpha",
        "X",
        "indefinite",
        "skew",
        "degree",
        "shape",
    ],
)
def test_an_option_out_of_range_is_refused_by_name(options, words):
    with pytest.raises(ValueError) as caught:
        canonical_dae(MOTOR, **({"sample_time": 0.001} | options))
    for word in words:
        assert word in str(caught.value), caught.value


def test_the_fault_detector_arms_itself_waits_and_recovers():
    state, above, below, seen = 1, 0.0, 0.0, []
    sizes = [2] * 3 + [0] * 5 + [2] + [0] + [2] * 4 + [0] * 6
    for size in sizes:
        values = fault_detector.detect(*(ca.DM(v) for v in (state, above, below, size, 1.0, 0.3, 0.4, 0.1)))
        state, above, below = (float(v) for v in values)
        seen.append(int(state))
    assert seen == [1] * 6 + [2] * 2 + [3] + [2] + [3, 3, 4, 4] + [4, 4, 4, 2, 2, 2]
