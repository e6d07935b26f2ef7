"""The certificates of James & Baras: against exact fractions, scipy, brute force, and along runs."""

import itertools
import math
from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import solve_continuous_are
from scipy.optimize import minimize_scalar

from observers.instance import Instance
from observers.model import Model, Variable
from observers.numerics.riccati import riccati_step
from observers.riccati import riccati
from observers.riccati.certificates import ANYWHERE, INSIDE, NONE, OUTSIDE
from reference_models.james_baras_5_1 import JAMES_BARAS_5_1
from reference_models.james_baras_5_2 import JAMES_BARAS_5_2
from reference_models.plant import plant


def constants(component):
    return {port.name.removeprefix("certificate."): port.start for port in component.constants}


def riccati_5_2(**changes):
    arguments = dict(sample_time=0.01, N=math.sqrt(0.2), R=3.0, Q0=0.01, guess={"x1": 0.0, "x2": 0.0})
    return riccati(JAMES_BARAS_5_2, **{**arguments, **changes})


def test_the_certificates_of_example_5_2_are_those_worked_out_by_hand():
    found = constants(riccati_5_2())
    assert found["p"] == pytest.approx(100, rel=1e-8)
    assert found["q"] == pytest.approx(0.1, rel=1e-8)
    assert found["q_paper"] == pytest.approx(0.11, rel=2e-8)
    assert found["alpha0"] == pytest.approx(1, rel=1e-8)
    assert found["rho"] == pytest.approx(56.9, rel=1e-3)
    assert found["delta_paper"] == pytest.approx(0.2 / 0.11**2 - 4 / 9, rel=1e-7)  # 16.0845, not the printed 7.82
    assert found["delta"] == pytest.approx(0.2 / 0.1**2 - 4 / 9, rel=1e-7)


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


def bounded_5_2(bound):
    fields = ("name", "inputs", "outputs", "ode", "output")
    states = [Variable(name, min=-bound, max=bound) for name in ("x1", "x2")]
    return Model(**{field: getattr(JAMES_BARAS_5_2, field) for field in fields}, states=states)


def test_the_bounds_of_the_model_bound_the_guess_error():
    """|x0 - m0| is the distance to the farthest corner: inside rho from the middle, outside it from a corner, unless more is known."""
    bound = 0.085
    component = riccati(bounded_5_2(bound), sample_time=0.01, N=0.4, R=0.3, Q0=1.0)
    rho = constants(component)["rho"]
    assert math.sqrt(2) * bound < rho < 2 * math.sqrt(2) * bound

    def certified(**parameters):
        run = Instance(component, parameters)
        return run.get("diagnostics.certified"), run.get("diagnostics.guaranteed_rate")

    corner = {"guess.x1": bound, "guess.x2": -bound}
    assert certified()[0] == INSIDE and certified()[1] > 0
    assert certified(**corner) == (OUTSIDE, 0)
    assert certified(**corner, **{"tuning.initial_error": 0.9 * rho})[0] == INSIDE
    assert certified(**{"tuning.initial_error": 1e6}) == certified()
    # On the way between: x2 = 0, and x1 so that the distance is rho.
    edge = math.sqrt(rho**2 - bound**2) - bound
    for side, name in itertools.product((1, -1), ("guess.x1", "guess.x2")):
        assert certified(**{name: side * (edge - 1e-6)})[0] == INSIDE
        assert certified(**{name: side * (edge + 1e-6)})[0] == OUTSIDE


def test_the_constants_are_rounded_outward():
    """x' = -2/3 x, y = x / 3: each constant against exact fractions; to the nearest digit, half of them would be wrong."""
    third = 1 / 3
    model = Model(
        name="scalar",
        states=[Variable("x", min=-1, max=1)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-2 * x.x / 3],
        output=lambda x, u, p, t: [x.x * third],
    )
    for N, R, Q0 in (
        (0.7, 130.0, 1 / 7),
        (1.1, 60.0, 1 / 3),
        (0.9, 70.0, 3.0),
        (1.3, 170.0, 1 / 11),
    ):  # so that Lambda = 0
        found = {
            name: Fraction(value) for name, value in constants(riccati(model, sample_time=0.1, N=N, R=R, Q0=Q0)).items()
        }
        A, H, r0, Q_0 = Fraction(2) / 3, Fraction(third) / Fraction(R), Fraction(N) ** 2, Fraction(Q0)
        ulps = Fraction(1, 10**14)  # what the model's own doubles, 2 / 3 and 1 / 3, may be off by
        upper = {"A": A, "H": H, "q_paper": Q_0 + r0 / (2 * A)}
        lower = {"alpha0": A}
        for name, exact in upper.items():
            assert exact * (1 - ulps) <= found[name] <= exact * (1 + Fraction(1, 10**7)), (name, N)
        for name, exact in lower.items():
            assert exact * (1 - Fraction(1, 10**7)) <= found[name] <= exact * (1 + ulps), (name, N)
        # q bounds the largest solution of -2 A Q - H^2 Q^2 + r0 = 0 or Q0, p that of 2 A P - r0 P^2 + H^2 = 0 or 1 / Q0.
        assert found["q"] >= Q_0 and -2 * A * found["q"] - (H * found["q"]) ** 2 + r0 <= ulps
        assert found["p"] * Q_0 >= 1 and 2 * A * found["p"] - r0 * found["p"] ** 2 + H**2 <= ulps
        assert 0 < found["delta"] <= r0 / found["q"] ** 2 * (1 + ulps)


def test_an_operation_without_interval_arithmetic_is_named_in_the_documentation():
    model = Model(
        name="gauss",
        states=[Variable("x", min=-1, max=1)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-x.x + ca.asinh(x.x)],
        output=lambda x, u, p, t: [ca.erf(x.x) + x.x * ca.asinh(ca.asin(x.x / 2))],
    )
    component = riccati(model, sample_time=0.1)
    assert "OP_ASIN" in component.documentation and "no certificate" in component.documentation
    assert Instance(component).get("diagnostics.certified") == NONE


def test_a_missing_bound_is_named_in_the_documentation():
    model = Model(
        name="cubic",
        states=[Variable("level"), Variable("other")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-(x.level**3) + x.other, -x.other],
        output=lambda x, u, p, t: [x.level],
    )
    documentation = riccati(model, sample_time=0.1).documentation
    assert "no bound over level, which the model does not bound" in documentation


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


def test_example_5_1_is_certified_from_anywhere_though_A_is_not_negative_across_the_unseen_directions():
    identity = {"N": 1.0, "R": 1.0, "Q0": 1.0}
    guess = {"x1": 0, "x2": 0, "x3": 0}
    component = riccati(JAMES_BARAS_5_1, sample_time=0.01, guess=guess, expose=["Q"], **identity)
    found = constants(component)
    assert found["alpha0"] < 0 and found["q_paper"] == 1e30 and found["q"] < 100
    run = Instance(component)
    assert run.get("diagnostics.certified") == ANYWHERE
    assert run.get("diagnostics.guaranteed_rate") == pytest.approx(1 / (2 * found["q"]), rel=2e-8)


@pytest.mark.parametrize("n", [2, 4])
def test_on_an_invariant_unstable_model_the_bound_of_Q_is_the_algebraic_equations_solution(n):
    rng = np.random.default_rng(n)
    A, C = rng.normal(size=(n, n)) + 0.5 * np.eye(n), rng.normal(size=(1, n))
    model = Model(
        name="unstable",
        states=[Variable(f"x{i}") for i in range(n)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [sum(A[i, j] * getattr(x, f"x{j}") for j in range(n)) for i in range(n)],
        output=lambda x, u, p, t: [sum(C[0, j] * getattr(x, f"x{j}") for j in range(n))],
    )
    largest = np.linalg.eigvalsh(solve_continuous_are(A.T, C.T, np.eye(n), np.eye(1))).max()
    component = riccati(model, sample_time=0.1, Q0=1e-3)
    assert largest <= constants(component)["q"] <= largest * (1 + 1e-3)
    assert Instance(component).get("diagnostics.certified") == ANYWHERE


def test_no_control_that_was_tried_drives_Q_of_example_5_1_beyond_its_bound():
    B = np.array([[[0.3, 0, 0], [0.2, -0.3, 0], [0, 0.2, 0.4]], [[-0.2, 0, 0], [0, 0.4, 0], [0.3, 0, -0.3]]])
    A, H = np.array([[0, 1, 0], [0, 0, 1], [-1, -2, -0.5]]), np.array([[1.0, 0, 0]])
    vertices = [A + a * B[0] + b * B[1] for a in (-1, 1) for b in (-1, 1)]
    q, found, rng = constants(riccati(JAMES_BARAS_5_1, sample_time=0.01))["q"], [], np.random.default_rng(0)
    for hold in (0.2, 0.5, 1.0, 3.0):  # [s], how long one of the controls' corners is held
        Q = np.eye(3)
        for _ in range(500):
            Q = riccati_step(3)(Q, vertices[rng.integers(4)], np.eye(3), H.T @ H, hold).full()
            found.append(float(np.linalg.eigvalsh(Q).max()))
    assert max(found) <= q
    assert max(found) > q / 6  # 12.7 of 64.3


def test_where_every_state_is_measured_Q_is_bounded_without_detectability_of_A():
    model = Model(
        name="unstable",
        states=[Variable("x", min=-1, max=1)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.x + 0.1 * x.x**2],
        output=lambda x, u, p, t: [2 * x.x],
    )
    found = constants(riccati(model, sample_time=0.01, Q0=0.1))
    # A = 1 + 0.2 x <= 1.2, H = 2: q solves 2.4 q - 4 q^2 + 1 = 0.
    assert found["q"] <= (1.2 + math.sqrt(1.2**2 + 4)) / 4 * (1 + 1e-6)
    assert found["rho"] > 0


def test_Lambda_is_the_multiple_of_H_with_the_smallest_bound():
    """(3.7) of a scalar model, minimised by scipy over s: 121 multiples are tried."""
    a, h, N, Q0 = 0.1, 0.7, 1.3, 0.2
    model = Model(
        name="slow",
        states=[Variable("x")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-a * x.x],
        output=lambda x, u, p, t: [h * x.x],
    )
    found = constants(riccati(model, sample_time=0.1, N=N, R=1.0, Q0=Q0))
    best = minimize_scalar(lambda s: (N**2 + (s * h) ** 2) / (2 * (a + s * h**2)), bounds=(0, 100)).fun
    assert Q0 + best <= found["q_paper"] <= (Q0 + best) * (1 + 3e-3)
