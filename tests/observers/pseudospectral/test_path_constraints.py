"""Path constraints r(x, z, u, p, t) <= 0, (3) and (18): imposed at the nodes and the samples, and said where they cannot be."""

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from numpy.polynomial.legendre import Legendre
from scipy.linalg import expm
from scipy.optimize import minimize

from components import COMPONENTS
from moving_window import A, B, linear, rotation, rotation_with_sign
from observers.canonical_dae import canonical_dae
from observers.elementary import elementary
from observers.instance import Instance
from observers.least_squares import least_squares
from observers.model import Model, ModelError, Variable
from observers.pseudospectral import pseudospectral
from observers.riccati import riccati
from observers.status import CODE
from observers.ukf import ukf
from slave import Slave

TS = 0.2
L = 8


def test_a_known_sign_as_a_constraint_finds_what_the_same_sign_as_a_bound_finds():
    """x3 >= 0 of the paper's example (4), written as -x3 <= 0, from 20 guesses."""
    runs = [pseudospectral(model, sample_time=TS, N=12, L=10) for model in (rotation(), rotation_with_sign())]
    rng = np.random.default_rng(0)
    for _ in range(20):
        guess = np.abs(rng.uniform(-2, 2, 3))
        ends = []
        for component in runs:
            run = Instance(component, {f"guess.x{i + 1}": guess[i] for i in range(3)})
            for k in range(30):
                run.set("y", np.sin(TS * k))
                run.step(TS * k, TS)
            ends.append([run.get(f"filtered.x{i}") for i in (1, 2, 3)])
        np.testing.assert_allclose(ends[1], [np.sin(29 * TS), np.cos(29 * TS), 1], rtol=0, atol=5e-13)
        np.testing.assert_allclose(ends[1], ends[0], rtol=0, atol=1e-12)
        assert run.get("diagnostics.constraint.forward") == pytest.approx(-1, abs=1e-12)


def ellipse(x1, x3, u, d, t):
    return x1**2 + 0.5 * x3**2 + 0.1 * u - 0.05 * t - d


def known_region(**changes):
    """`moving_window.linear` with a known input and an unknown force d that bounds, with the time, where the state can be."""
    return linear(
        disturbed=True,
        constraints=[Variable("region", "how far outside the region", nominal=0.5)],
        constraint=lambda x, u, p, t: [ellipse(x.x1, x.x3, u.u, p.d, t)],
        **changes,
    )


def moved(times, start, u):
    """The true motion: the states (m, 3) at `times` after `start` [s] of s0 = [x; d] as affine functions, values (m, 3, 5) of [s0; 1]."""
    found = []
    for time in times:
        state = np.hstack([np.eye(3, 4), np.zeros((3, 1))])
        left, k = time, 0
        while left > 1e-12:
            h = min(left, TS)
            M = np.zeros((5, 5))
            M[:3, :3], M[1, 3], M[:3, 4] = A, 1, B * u[k]
            whole = expm(M * h)
            full = np.vstack([state, np.eye(5)[3:]])
            state = (whole @ full)[:3]
            left, k = left - h, k + 1
        found.append(state)
    return np.array(found)


@pytest.mark.parametrize(("segments", "N"), [(1, 12), (4, 7)])
def test_the_estimate_under_a_constraint_in_states_parameter_input_and_time_is_the_constrained_least_squares_one(
    segments, N
):
    """Noise that would lead it outside; against scipy's SLSQP at the nodes and samples of every segment."""
    rng = np.random.default_rng(3)
    u = np.round(np.sin(0.7 * np.arange(L + 1)), 2)
    s0 = np.array([0.4, 0.3, -0.3, 0.15])
    samples = TS * np.arange(L + 1)
    at = moved(samples, 0.0, u)
    C, D = np.array([[1, 0, 0], [1, 0, 0.5]]), np.array([0, 0.2])
    y = (at @ [*s0, 1]) @ C.T + np.outer(u, D) + rng.normal(0, 0.4, (L + 1, 2))
    observers = [
        pseudospectral(model, sample_time=TS, N=N, L=L, segments=segments)
        for model in (known_region(), linear(disturbed=True))
    ]
    runs = [Instance(one) for one in observers]
    for k in range(L + 1):
        for run in runs:
            for i in (0, 1):
                run.set(f"y{i + 1}", y[k, i])
            run.set("u", u[k])
            run.step(TS * k, TS)
    found, free = (np.array([run.get(f"filtered.{name}") for name in ("x1", "x2", "x3", "d")]) for run in runs)
    piece = L * TS / segments
    nodes = np.concatenate([[-1], np.sort(Legendre.basis(N).deriv().roots().real), [1]])
    times = np.unique(
        np.round([*samples, *[j * piece + piece / 2 * (1 + n) for j in range(segments) for n in nodes]], 12)
    )
    along = moved(times, 0.0, u)
    last = moved([L * TS], 0.0, u)[0]

    def limits(s):
        x = along @ [*s, 1]
        held = u[np.minimum((times / TS + 1e-9).astype(int), L - 1)]
        return ellipse(x[:, 0], x[:, 2], held, s[3], times)

    best = minimize(
        lambda s: np.sum(((at @ [*s, 1]) @ C.T + np.outer(u, D) - y) ** 2),
        s0,
        method="SLSQP",
        constraints={"type": "ineq", "fun": lambda s: -limits(s)},
        options={"ftol": 1e-15, "maxiter": 300},
    )
    assert best.success and np.sum(np.abs(limits(best.x)) < 1e-6) >= 1  # it matters
    expected = np.append(last @ [*best.x, 1], best.x[3])
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-6)
    assert np.abs(free - expected).max() > 0.05
    assert runs[0].get("diagnostics.constraint_violation") < 1e-6
    x1, _, x3, d = found
    now = ellipse(x1, x3, u[L], d, L * TS)  # with the input that is set at the sample
    assert runs[0].get("diagnostics.constraint.region") == pytest.approx(now, abs=1e-12)


def oscillator(**constraints):
    return Model(
        name="oscillator",
        states=[Variable("x1", start=0.5), Variable("x2", start=0.5)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.x2, -x.x1],
        output=lambda x, u, p, t: [x.x1],
        **constraints,
    )


ENERGY = dict(constraints=[Variable("energy")], constraint=lambda x, u, p, t: [x.x1**2 + x.x2**2 - 1])


@pytest.mark.parametrize("more", [dict(arrival_cost=True), dict(process_noise={"x2": 0.05})])
def test_constraints_go_with_an_arrival_cost_and_with_process_noise(more):
    rng = np.random.default_rng(1)
    y = 0.97 * np.cos(TS * np.arange(60)) + rng.normal(0, 0.3, 60)
    make = dict(sample_time=TS, N=4, L=10, segments=5, measurement_noise={"y": 0.3}, **more)
    inside, free = (Instance(pseudospectral(oscillator(**c), **make)) for c in (ENERGY, {}))
    outside = [0, 0]
    for k in range(60):
        for i, run in enumerate((inside, free)):
            run.set("y", y[k])
            run.step(TS * k, TS)
            outside[i] += np.hypot(run.get("filtered.x1"), run.get("filtered.x2")) > 1 + 1e-3
    assert outside[0] == 0 and outside[1] >= 10
    assert inside.get("diagnostics.solver_failures") == 0


def test_a_constraint_of_an_algebraic_variable_is_that_of_its_solution():
    """z = 2 x1 + x2^2 with z <= 1, and the same written out."""

    def model(constraint, **algebraic):
        return Model(
            name="dae",
            states=[Variable("x1", start=0.2), Variable("x2", start=0.1)],
            outputs=[Variable("y")],
            constraints=[Variable("limit")],
            constraint=constraint,
            **algebraic,
        )

    with_z = model(
        lambda x, z, u, p, t: [z.z - 1],
        algebraic=[Variable("z", start=0.4)],
        algebraic_equations=lambda x, z, u, p, t: [2 * x.x1 + x.x2**2 - z.z],
        ode=lambda x, z, u, p, t: [x.x2, -z.z],
        output=lambda x, z, u, p, t: [x.x1],
    )
    written_out = model(
        lambda x, u, p, t: [2 * x.x1 + x.x2**2 - 1],
        ode=lambda x, u, p, t: [x.x2, -2 * x.x1 - x.x2**2],
        output=lambda x, u, p, t: [x.x1],
    )
    rng, runs = (
        np.random.default_rng(5),
        [Instance(pseudospectral(m, sample_time=TS, N=8, L=8)) for m in (with_z, written_out)],
    )
    for k in range(20):
        y = 0.45 * np.cos(1.4 * TS * k) + rng.normal(0, 0.15)
        for run in runs:
            run.set("y", y)
            run.step(TS * k, TS)
        names = ["filtered.x1", "filtered.x2", "diagnostics.constraint.limit", "diagnostics.constraint_violation"]
        values = [[run.get(name) for name in names] for run in runs]
        np.testing.assert_allclose(values[0], values[1], rtol=0, atol=1e-6)


def test_samples_that_no_motion_within_the_constraint_explains_leave_it_met_and_are_said_to_be_inconsistent():
    make = pseudospectral(oscillator(**ENERGY), sample_time=TS, N=12, L=10, measurement_noise={"y": 0.01})
    run = Instance(make)
    for k in range(30):
        run.set("y", 2 * np.cos(TS * k))
        run.step(TS * k, TS)
    assert np.hypot(run.get("filtered.x1"), run.get("filtered.x2")) == pytest.approx(1, abs=1e-5)
    assert run.get("diagnostics.constraint.energy") == pytest.approx(0, abs=1e-5)
    assert run.get("diagnostics.status") == CODE.inconsistent and not run.get("diagnostics.trusted")


def test_constraints_that_contradict_each_other_are_said_with_their_violation():
    opposed = dict(
        constraints=[Variable("above"), Variable("below")], constraint=lambda x, u, p, t: [0.5 - x.x1, x.x1 + 0.5]
    )
    run = Instance(pseudospectral(oscillator(**opposed), sample_time=TS, N=6, L=4))
    for k in range(8):
        run.set("y", 0.0)
        run.step(TS * k, TS)
    assert run.get("diagnostics.constraint_violation") == pytest.approx(0.5, abs=0.05)
    assert run.get("diagnostics.status") == CODE.inconsistent


@pytest.mark.parametrize("more", [{}, dict(process_noise={"x1": 0.1}, measurement_noise={"y": 0.1})])
@pytest.mark.parametrize("limited", ["bound", "constraint"])
def test_a_segment_without_a_sample_yet_violates_nothing(limited, more):
    """The state is known to be above 0.5, and so is every sample, while a window of five segments grows."""
    bound = dict(min=0.5) if limited == "bound" else {}
    path = (
        dict(constraints=[Variable("floor")], constraint=lambda x, u, p, t: [0.5 - x.x1])
        if limited == "constraint"
        else {}
    )
    model = Model(
        name="decay",
        states=[Variable("x1", start=1.0, **bound), Variable("x2", start=2.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.x2 - x.x1, 0.1 * ca.sin(t) * x.x2],
        output=lambda x, u, p, t: [x.x1],
        **path,
    )
    run, t = Instance(pseudospectral(model, sample_time=TS, N=5, L=10, segments=5, **more)), TS * np.arange(12)
    y = 2 - np.exp(-t)  # to 0.03: the status is what is asked
    for k in range(12):
        run.set("y", y[k])
        run.step(t[k], TS)
        assert run.get("diagnostics.constraint_violation") == pytest.approx(0, abs=1e-9)
        assert run.get("diagnostics.status") != CODE.inconsistent


def test_a_constraint_is_an_expression_with_a_name_and_no_bounds():
    for changes, message in (
        (dict(constraints=[Variable("energy")]), r"model 'oscillator': constraints and constraint, their function, go"),
        (
            dict(constraints=[Variable("energy", max=1.0)], constraint=ENERGY["constraint"]),
            r"model 'oscillator': the constraint 'energy' has start = 0, min = -inf, max = 1; a constraint says that its "
            r"expression is at most 0: write its limit into the expression",
        ),
        (
            dict(constraints=[Variable("a"), Variable("b")], constraint=ENERGY["constraint"]),
            r"model 'oscillator', constraint: 1 expressions for 2 variables \(a, b\)",
        ),
        (
            dict(constraints=[Variable("late")], constraint=lambda x, u, p, t: [t - 1]),
            r"model 'oscillator': constraint 'late' depends on nothing that is estimated",
        ),
        (
            dict(constraints=[Variable("root")], constraint=lambda x, u, p, t: [ca.sqrt(x.x1 - 1)]),
            r"model 'oscillator', constraint: the equation for 'root' is nan at the start values",
        ),
        (
            dict(constraints=[Variable("x2")], constraint=ENERGY["constraint"]),
            r"model 'oscillator': the name 'x2' stands for a state and a constraint",
        ),
    ):
        with pytest.raises(ModelError, match=message):
            oscillator(**changes)


def test_an_observer_that_leaves_constraints_aside_says_so_by_their_names_and_estimates_as_without_them():
    for build in (
        lambda model: ukf(model, sample_time=TS),
        lambda model: riccati(model, sample_time=TS),
        lambda model: least_squares(model, sample_time=TS, T=1.0, linearise=True),
        lambda model: canonical_dae(model, sample_time=TS, poles=[-2.0, -3.0]),
        lambda model: elementary(model, sample_time=TS, N=11),
    ):
        with_limit, without = build(oscillator(**ENERGY)), build(oscillator())
        text = "<p>The model's constraints (energy) are not imposed by this method"
        assert text in with_limit.documentation and text not in without.documentation
        assert [port.name for port in with_limit.outputs] == [port.name for port in without.outputs]
    known = Model(
        name="decay",
        states=[Variable("x")],
        unknown_parameters=[Variable("rate", start=0.4)],
        outputs=[Variable("y")],
        constraints=[Variable("slow")],
        ode=lambda x, u, p, t: [1 - p.rate * x.x],
        output=lambda x, u, p, t: [x.x],
        constraint=lambda x, u, p, t: [p.rate - 1],
    )
    assert "constraints (slow) are not imposed" in elementary(known, sample_time=TS, N=11).documentation
    made = pseudospectral(oscillator(**ENERGY), sample_time=TS, N=6, L=4).documentation
    assert "<p>At the nodes and at the samples the fit obeys the constraints energy.</p>" in made


def test_the_fmu_imposes_a_constraint_and_counts_the_newest_samples_as_the_python_face_does(
    slave: Callable[..., Slave],
) -> None:
    start = {"guess.x1": -1.0, "guess.x2": -1.0, "guess.x3": 0.2}
    fmu, face = slave("rotation_with_sign").initialize(start), Instance(COMPONENTS["rotation_with_sign"](), start)
    assert fmu.variables["diagnostics.constraint.forward"].variability == "discrete"
    names = [port.name for port in face.component.outputs]
    for k in range(30):
        for run in (fmu, face):
            if k == 20:
                run.set("tuning.window_length", 5)
            run.set("y", np.sin(TS * k) + 0.05 * np.sin(17.0 * k))
            run.step(TS * k, TS)
        np.testing.assert_allclose([fmu.get(name) for name in names], face.outputs(), rtol=0, atol=1e-9)
    assert fmu.get("filtered.x3") > 0
    fmu.refuses(lambda: fmu.set("tuning.window_length", 11))
