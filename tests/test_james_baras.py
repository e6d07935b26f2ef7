"""The Riccati observer: against Kalman filters, scipy's integration of the paper's equations, and the paper's constants."""

import math

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from observers.certificates import ANYWHERE, INSIDE, NONE, OUTSIDE
from observers.instance import Instance
from observers.james_baras import CODE, james_baras
from observers.model import Model, ModelError, Variable
from reference_models.james_baras_5_1 import JAMES_BARAS_5_1
from reference_models.james_baras_5_2 import JAMES_BARAS_5_2
from reference_models.plant import plant


def linear(n, ny, name="linear"):
    """x' = A x + u, y = C x, with the entries of A and C as parameters."""
    a = [[f"a{i}{j}" for j in range(n)] for i in range(n)]
    c = [[f"c{i}{j}" for j in range(n)] for i in range(ny)]

    def product(rows, x, p):
        return [sum(getattr(p, entry) * getattr(x, f"x{j}") for j, entry in enumerate(row)) for row in rows]

    return Model(
        name=name,
        states=[Variable(f"x{i}") for i in range(n)],
        inputs=[Variable("u")],
        outputs=[Variable(f"y{i}") for i in range(ny)],
        parameters=[Variable(entry) for row in a + c for entry in row],
        ode=lambda x, u, p, t: [rate + u.u for rate in product(a, x, p)],
        output=lambda x, u, p, t: product(c, x, p),
    )


def entries(A, C):
    """The parameters of `linear` for the matrices A and C."""
    return {f"model.{letter}{i}{j}": v for letter, M in (("a", A), ("c", C)) for (i, j), v in np.ndenumerate(M)}


def kalman(A, C, N, R, Q, m, samples, inputs, Ts):
    """The sampled Kalman filter's estimates after each step, by Van Loan's exponential, in information-free textbook form."""
    n = len(A)
    E = expm(Ts * np.block([[-A, N @ N.T], [np.zeros((n, n)), A.T]]))
    Phi = E[n:, n:].T
    Wd = Phi @ E[:n, n:]
    held = expm(Ts * np.block([[A, np.ones((n, 1))], [np.zeros((1, n + 1))]]))[:n, n]
    Rd, found = R @ R.T / Ts, []
    for y, u in zip(samples, inputs, strict=True):
        K = Q @ C.T @ np.linalg.inv(C @ Q @ C.T + Rd)
        m, Q = m + K @ (y - C @ m), Q - K @ C @ Q
        m, Q = Phi @ m + held * u, Phi @ Q @ Phi.T + Wd
        found.append(m)
    return np.array(found), Q


@pytest.mark.parametrize("full", [False, True], ids=["diagonal", "full"])
@pytest.mark.parametrize(("n", "ny"), [(2, 1), (3, 2), (6, 2)])
@pytest.mark.parametrize("stiff", [False, True], ids=["Runge-Kutta", "exponential"])
def test_on_a_linear_time_invariant_model_it_is_the_sampled_kalman_filter(n, ny, full, stiff):
    rng, Ts = np.random.default_rng(n), 0.1
    A, C = rng.normal(size=(n, n)) - np.eye(n), rng.normal(size=(ny, n))
    N, R, Q0 = rng.uniform(0.5, 2, n), rng.uniform(0.5, 2, ny), rng.uniform(0.5, 2, n)
    if full:
        N, R = np.diag(N) + 0.2 * rng.normal(size=(n, n)), np.diag(R) + 0.2 * rng.normal(size=(ny, ny))
        Q0 = np.diag(Q0) + 0.1
    component = james_baras(linear(n, ny), sample_time=Ts, N=N, R=R, Q0=Q0, expose=["Q"], stiff=stiff)
    y, u = rng.normal(size=(60, ny)), rng.normal(size=60)
    N, R, Q0 = (np.diag(M) if M.ndim == 1 else M for M in (N, R, Q0))
    m0 = rng.normal(size=n)
    expected, Q = kalman(A, C, N, R, Q0, m0, y, u, Ts)
    run = Instance(component, {**entries(A, C), **{f"guess.x{i}": value for i, value in enumerate(m0)}})
    for k in range(60):
        for i in range(ny):
            run.set(f"y{i}", y[k, i])
        run.set("u", u[k])
        for part in range(2):  # a communication step of half a sample time is the same
            run.step((k + part / 2) * Ts, Ts / 2)
        np.testing.assert_allclose([run.get(f"estimate.x{i}") for i in range(n)], expected[k], rtol=1e-9, atol=1e-9)
    found = [[run.get(f"diagnostics.Q[{i + 1},{j + 1}]") for j in range(n)] for i in range(n)]
    np.testing.assert_allclose(found, Q, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("count", [48, pytest.param(1000, marks=pytest.mark.long)])
def test_random_detectable_linear_systems_keep_Q_symmetric_positive_definite_and_finite(count):
    rng, Ts, built = np.random.default_rng(count), 0.1, {}
    for index in range(count):
        n, ny = 1 + index % 8, 1 + index % 3
        if (n, ny) not in built:
            built[n, ny] = james_baras(linear(n, ny), sample_time=Ts, expose=["Q"])
        # Unstable modes that the outputs see, and stable ones that they do not, in random coordinates.
        hidden = rng.integers(0, n)
        A = np.triu(rng.normal(size=(n, n)), 1)
        A[np.diag_indices(n)] = [*rng.uniform(-3, 2, n - hidden), *rng.uniform(-3, -0.1, hidden)]
        A[: n - hidden, n - hidden :] = 0
        C = rng.normal(size=(ny, n))
        C[:, n - hidden :] = 0
        T, _ = np.linalg.qr(rng.normal(size=(n, n)))
        run = Instance(built[n, ny], entries(T @ A @ T.T, C @ T.T))
        size = [port.name for port in run.component.outputs].index("diagnostics.Q[1,1]")
        for k in range(20):
            for i in range(ny):
                run.set(f"y{i}", rng.normal())
            run.step(k * Ts, Ts)
            outputs = run.outputs()
            assert np.isfinite(outputs).all()
            Q = outputs[size:].reshape(n, n)
            assert np.array_equal(Q, Q.T)
            np.linalg.cholesky(Q)
        assert run.get("diagnostics.solver_failures") == 0


def continuous(f, A, h, H, n, N, R, Q0, m0, x0, stop):
    """|e(stop)| of (2.1), (2.2), by scipy at 1e-12."""

    def rhs(t, z):
        x, m, Q = z[:n], z[n : 2 * n], z[2 * n :].reshape(n, n)
        gain = Q @ H(m).T / R**2
        rate = A @ Q + Q @ A.T - gain @ H(m) @ Q + N**2 * np.eye(n)
        return np.concatenate([f(t, x), f(t, m) + gain @ (h(x) - h(m)), rate.ravel()])

    z0 = np.concatenate([x0, m0, Q0 * np.eye(n).ravel()])
    z = solve_ivp(rhs, (0, stop), z0, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return z[n : 2 * n]


def sampled(Ts, stop):
    run = Instance(
        james_baras(JAMES_BARAS_5_2, sample_time=Ts, N=math.sqrt(0.2), R=3.0, Q0=0.01, guess={"x1": 0, "x2": 0})
    )
    true = Instance(plant(JAMES_BARAS_5_2))
    for k in range(round(stop / Ts)):
        run.set("y", true.get("y"))
        for one in (run, true):
            one.step(k * Ts, Ts)
    return np.array([run.get("estimate.x1"), run.get("estimate.x2")])


def test_for_small_sample_times_it_is_the_papers_continuous_observer_of_first_order():
    A = np.array([[-5, math.sqrt(2)], [math.sqrt(2), -4]]) / 3
    expected = continuous(
        lambda t, x: A @ x,
        A,
        lambda x: np.sin(x[:1]),
        lambda x: np.array([[math.cos(x[0]), 0.0]]),
        2, math.sqrt(0.2), 3.0, 0.01, np.zeros(2), np.array([1.0, -1.0]), 1.0,
    )  # fmt: skip
    gaps = [np.linalg.norm(sampled(Ts, 1.0) - expected) for Ts in (0.1, 0.05, 0.025, 0.0125)]
    orders = np.log2(np.array(gaps[:-1]) / gaps[1:])
    assert np.all((orders > 0.85) & (orders < 1.3)), (gaps, orders)
    assert gaps[-1] < 2e-4


def constants(component):
    return {port.name.removeprefix("certificate."): port.start for port in component.constants}


def riccati_5_2(**changes):
    arguments = dict(sample_time=0.01, N=math.sqrt(0.2), R=3.0, Q0=0.01, guess={"x1": 0.0, "x2": 0.0})
    return james_baras(JAMES_BARAS_5_2, **{**arguments, **changes})


def test_the_certificates_of_example_5_2_are_those_worked_out_by_hand():
    found = constants(riccati_5_2())
    assert found["p"] == pytest.approx(100, rel=1e-8)
    assert found["q"] == pytest.approx(0.1, rel=1e-8)
    assert found["q_paper"] == pytest.approx(0.11, rel=1e-8)
    assert found["alpha0"] == pytest.approx(1, rel=1e-8)
    assert found["rho"] == pytest.approx(56.9, rel=1e-3)
    assert found["delta_paper"] == pytest.approx(0.2 / 0.11**2 - 4 / 9, rel=1e-8)  # 16.0845, not the printed 7.82
    assert found["delta"] == pytest.approx(0.2 / 0.1**2 - 4 / 9, rel=1e-8)


def test_the_bounds_of_P_and_Q_hold_along_the_run():
    component = riccati_5_2(expose=["Q"])
    found, run, true = constants(component), Instance(component), Instance(plant(JAMES_BARAS_5_2))
    for k in range(500):
        run.set("y", true.get("y"))
        for one in (run, true):
            one.step(0.01 * k, 0.01)
        eigenvalues = np.linalg.eigvalsh(run.outputs()[-4:].reshape(2, 2))
        assert eigenvalues.max() <= found["q"] and 1 / eigenvalues.min() <= found["p"]


def test_certified_tells_whether_the_guess_lies_inside_rho():
    # Too large an R^-1 for Corollary 2.1, so that rho decides.
    local = riccati_5_2(R=0.3, N=0.4, Q0=1.0)
    rho = constants(local)["rho"]
    assert constants(local)["delta"] < 0 < rho < 1e3
    for error, code in ((0.99 * rho, INSIDE), (1.01 * rho, OUTSIDE)):
        run = Instance(local, {"tuning.initial_error": error})
        assert run.get("diagnostics.certified") == code
        assert (run.get("diagnostics.guaranteed_rate") > 0) == (code == INSIDE)


def test_the_bounds_of_the_model_bound_the_guess_error():
    bounded = Model(
        **{
            **{field: getattr(JAMES_BARAS_5_2, field) for field in ("name", "inputs", "outputs", "ode", "output")},
            "states": [Variable("x1", min=-0.1, max=0.1), Variable("x2", min=-0.1, max=0.1)],
        }
    )
    component = james_baras(bounded, sample_time=0.01, N=0.4, R=0.3, Q0=1.0)
    rho = constants(component)["rho"]
    found = Instance(component, {"guess.x1": 0.1}).get("diagnostics.certified")
    assert found == (INSIDE if math.hypot(0.2, 0.1) < rho else OUTSIDE)


def test_the_guaranteed_rate_is_kept():
    component = riccati_5_2()
    run, true = Instance(component), Instance(plant(JAMES_BARAS_5_2))
    assert run.get("diagnostics.certified") == ANYWHERE
    rate, found = run.get("diagnostics.guaranteed_rate"), constants(component)
    for k in range(1000):
        run.set("y", true.get("y"))
        for one in (run, true):
            one.step(0.01 * k, 0.01)
        error = math.hypot(*[run.get(f"estimate.{v}") - true.get(f"x.{v}") for v in ("x1", "x2")])
        assert error <= math.sqrt(found["q"] * 100) * math.sqrt(2) * math.exp(-rate * 0.01 * (k + 1)) * 1.01


@pytest.mark.parametrize("change", ["tuning.R.y", "tuning.N.x1"])
def test_a_changed_tuning_makes_the_certificate_void(change):
    run = Instance(riccati_5_2())
    run.step(0.0, 0.01)
    assert run.get("diagnostics.certified") == ANYWHERE
    run.set(change, 1.0)
    run.step(0.01, 0.01)
    assert run.get("diagnostics.certified") == NONE
    assert run.get("diagnostics.guaranteed_rate") == 0


def test_where_A_is_not_negative_across_the_unseen_directions_there_is_no_certificate():
    component = james_baras(JAMES_BARAS_5_1, sample_time=0.01)
    assert constants(component)["alpha0"] < 0 and constants(component)["q"] == 1e30
    assert Instance(component).get("diagnostics.certified") == NONE


def test_where_every_state_is_measured_Q_is_bounded_without_detectability_of_A():
    model = Model(
        name="unstable",
        states=[Variable("x", min=-1, max=1)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.x + 0.1 * x.x**2],
        output=lambda x, u, p, t: [2 * x.x],
    )
    found = constants(james_baras(model, sample_time=0.01, Q0=0.1))
    # A = 1 + 0.2 x <= 1.2, H = 2: q solves 2.4 q - 4 q^2 + 1 = 0.
    assert found["q"] <= (1.2 + math.sqrt(1.2**2 + 4)) / 4 * (1 + 1e-6)
    assert found["rho"] > 0


def test_a_rejected_output_leaves_the_estimate_to_the_others_and_all_rejected_to_the_model():
    A, C = np.array([[-1.0, 0.5], [0.0, -0.3]]), np.eye(2)
    component = james_baras(linear(2, 2), sample_time=0.1)
    one, none = (Instance(component, {**entries(A, C), "guess.x0": 1.0}) for _ in range(2))
    one.set("y0", math.nan)
    one.set("y1", 3.0)
    none.set("y0", math.inf)
    none.set("y1", math.nan)
    for run in (one, none):
        run.step(0.0, 0.1)
        assert run.get("diagnostics.status") == CODE.sample_rejected
        assert run.get("diagnostics.rejected_samples") == 1
        assert np.isfinite(run.z).all()
    np.testing.assert_allclose(
        [none.get("estimate.x0"), none.get("estimate.x1")], expm(0.1 * A) @ [1.0, 0.0], atol=1e-12
    )
    assert one.get("filtered.x1") == pytest.approx(3.0 / (1 + 10))  # Q0 = 1, Rd = 1 / 0.1
    assert one.get("filtered.x0") == 1.0


def test_a_model_that_escapes_to_infinity_is_held_counted_and_starts_again():
    model = Model(
        name="escape",
        states=[Variable("x", start=1e3)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.x**3],
        output=lambda x, u, p, t: [x.x],
    )
    run = Instance(james_baras(model, sample_time=0.1, stiff=False))
    run.set("y", 1e3)
    run.step(0.0, 0.1)
    assert run.get("diagnostics.status") == CODE.solver_failed
    assert run.get("diagnostics.solver_failures") == 1
    assert np.isfinite(run.z).all()
    run.set("y", 0.0)
    for k in range(1, 60):
        run.step(0.1 * k, 0.1)
        assert np.isfinite(run.z).all()


def test_a_stiff_drift_takes_the_exponential_step():
    model = Model(
        name="stiff",
        states=[Variable("x1", start=1.0), Variable("x2", start=1.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-1e4 * (x.x1 - ca.cos(x.x2)), -x.x2 + 0.1 * ca.sin(t)],
        output=lambda x, u, p, t: [x.x2],
    )
    run, true = Instance(james_baras(model, sample_time=0.05, guess={"x2": 0.2})), np.array([1.0, 1.0])
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
    run = Instance(james_baras(model, sample_time=0.01, N=[0.1, 0.5], R=0.01, guess={"theta": 0.2}))
    true = Instance(plant(model))
    for k in range(2000):
        run.set("y", true.get("y"))
        for one in (run, true):
            one.step(0.01 * k, 0.01)
    assert run.get("estimate.theta") == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"N": [1.0, 0.0]}, ("N", "x2", "0")),
        ({"N": [1.0, 2.0, 3.0]}, ("N", "(3,)", "(2,)")),
        ({"R": math.nan}, ("R", "nan")),
        ({"N": [[1.0, 1.0], [1.0, 1.0]]}, ("N", "singular", "rank 1 of 2")),
        ({"Q0": [[1.0, 2.0], [2.0, 1.0]]}, ("Q0", "positive definite")),
        ({"expose": ["P"]}, ("expose", "'P'", "Q")),
    ],
)
def test_an_impossible_design_is_refused_by_name(arguments, words):
    with pytest.raises(ValueError) as caught:
        james_baras(JAMES_BARAS_5_2, sample_time=0.01, **arguments)
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
        run = Instance(james_baras(model, sample_time=0.1), {"guess.unseen": 1.0})
        run.step(0.0, 0.1)
        assert run.get("estimate.unseen") == pytest.approx(math.exp(-0.1))
    else:
        with pytest.raises(ModelError, match=r"blind.*unseen"):
            james_baras(model, sample_time=0.1)
