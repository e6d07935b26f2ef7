"""Bounds of states and unknown parameters, (3) and (18): honoured at every node, and said where they cannot be."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial.legendre import Legendre
from scipy.optimize import minimize

from components import COMPONENTS
from moving_window import rotation
from observers.instance import Instance
from observers.model import Model, ModelError, Variable
from observers.pseudospectral import pseudospectral
from observers.status import CODE
from reference_models.duffing import DUFFING
from reference_models.plant import plant
from slave import Slave

TS = 0.2


def ends_of_20_starts(component, bounded):
    rng, ends, violations = np.random.default_rng(0), [], []
    for _ in range(20):
        guess = rng.uniform(-2, 2, 3)
        guess[2] = abs(guess[2]) if bounded else guess[2]
        run = Instance(component, {f"guess.x{i + 1}": guess[i] for i in range(3)})
        for k in range(30):
            run.set("y", np.sin(TS * k))
            run.step(TS * k, TS)
        ends.append([run.get(f"filtered.x{i}") for i in (1, 2, 3)])
        violations.append(run.get("diagnostics.constraint_violation") if bounded else 0)
    return np.array(ends), violations


def test_a_known_sign_finds_the_right_one_of_two_explanations_from_20_starts():
    ends, violations = ends_of_20_starts(pseudospectral(rotation(), sample_time=TS, N=12, L=10), True)
    np.testing.assert_allclose(ends, np.tile([np.sin(29 * TS), np.cos(29 * TS), 1], (20, 1)), rtol=0, atol=5e-13)
    assert max(violations) < 1e-9


def test_without_the_bound_both_explanations_are_found():
    ends, _ = ends_of_20_starts(pseudospectral(rotation(False), sample_time=TS, N=12, L=10), False)
    signs = np.sign(ends[:, 2])
    assert 3 <= np.sum(signs < 0) <= 17
    np.testing.assert_allclose(np.abs(ends[:, 2]), 1, rtol=0, atol=5e-13)
    np.testing.assert_allclose(ends[:, 1] * signs, np.cos(29 * TS), rtol=0, atol=2e-13)


def oscillator(**bounds):
    return Model(
        name="oscillator",
        states=[Variable("x1", **bounds), Variable("x2")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.x2, -x.x1],
        output=lambda x, u, p, t: [x.x1],
    )


def cosine(tau):
    """Rows from [x1, x2] of the window's end to x1 at tau before it."""
    return np.column_stack([np.cos(tau), -np.sin(tau)])


@pytest.mark.parametrize(("segments", "N", "L"), [(1, 14, 20), (4, 6, 20)])
def test_the_estimate_under_bounds_of_a_state_at_the_nodes_is_the_constrained_least_squares_one(segments, N, L):
    """An amplitude of 0.95 under a noise of 0.5 with |x1| <= 1 known; against scipy's SLSQP at the nodes of every segment."""
    rng = np.random.default_rng(1)
    y = 0.95 * np.cos(TS * np.arange(60)) + rng.uniform(-0.5, 0.5, 60)
    bounded, free = (
        Instance(pseudospectral(oscillator(**bounds), sample_time=TS, N=N, L=L, segments=segments))
        for bounds in ({"min": -1.0, "max": 1.0}, {})
    )
    nodes = np.concatenate([[-1], np.sort(Legendre.basis(N).deriv().roots().real), [1]])
    piece = L * TS / segments
    tau = np.concatenate([j * piece + piece / 2 * (1 + nodes) for j in range(segments)])
    at_nodes, at_samples = cosine(tau), cosine(TS * np.arange(L, -1, -1))
    bound_mattered = 0
    for k in range(60):
        for run in (bounded, free):
            run.set("y", y[k])
            run.step(TS * k, TS)
        if k < L:
            continue
        found, unbounded = (np.array([run.get("filtered.x1"), run.get("filtered.x2")]) for run in (bounded, free))
        assert np.abs(at_nodes @ found).max() < 1 + 1e-6
        assert bounded.get("diagnostics.constraint_violation") < 1e-6
        bound_mattered += np.abs(at_nodes @ unbounded).max() > 1 + 1e-3
        window = y[k - L : k + 1]
        best = minimize(
            lambda x, window=window: np.sum((at_samples @ x - window) ** 2),
            found,
            jac=lambda x, window=window: 2 * at_samples.T @ (at_samples @ x - window),
            method="SLSQP",
            constraints={
                "type": "ineq",
                "fun": lambda x: np.concatenate([1 - at_nodes @ x, 1 + at_nodes @ x]),
                "jac": lambda x: np.vstack([-at_nodes, at_nodes]),
            },
            options={"ftol": 1e-14},
        )
        np.testing.assert_allclose(found, best.x, rtol=0, atol=6e-6)
    assert bound_mattered >= 10


def theta_bounded(low, high):
    (theta,) = DUFFING.unknown_parameters
    return replace(DUFFING, unknown_parameters=[replace(theta, start=max(low, 0.0), min=low, max=high)])


def estimates_of_theta(model, noise, samples=80, start=0.4):
    p = Instance(plant(DUFFING), {"sensor.noise_bound": noise, "sensor.sample_time": 0.1})
    run = Instance(pseudospectral(model, sample_time=0.1, N=15), {"guess.theta": start})
    found = []
    for k in range(samples):
        run.set("y", p.get("y"))
        p.step(0.1 * k, 0.1)
        run.step(0.1 * k, 0.1)
        found.append(run.get("filtered.theta"))
    return np.array(found), run


def test_an_unknown_parameter_never_leaves_its_bounds_under_noise():
    bounded, run = estimates_of_theta(theta_bounded(0.3, 0.5), 0.05)
    free, _ = estimates_of_theta(DUFFING, 0.05)
    assert bounded.min() >= 0.3 - 1e-9 and bounded.max() <= 0.5 + 1e-9
    assert np.sum((free[8:] < 0.3) | (free[8:] > 0.5)) > 20
    assert run.get("diagnostics.solver_failures") == 0


def test_a_parameter_whose_true_value_lies_beyond_its_bound_ends_at_the_bound():
    found, run = estimates_of_theta(theta_bounded(0.0, 0.3), 0.0, start=0.1)
    np.testing.assert_allclose(found[60:], 0.3, rtol=0, atol=9e-14)
    assert found.max() <= 0.3 + 1e-9 and abs(found[-1] - 0.3) < 1e-7
    assert run.get("diagnostics.cost") > 1e-8


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_bounds_that_never_matter_change_nothing(noise):
    """From the window's first full solve: the last bits apart, the free step is the solution."""
    wide = replace(
        theta_bounded(-1e3, 1e3), states=[replace(variable, min=-1e3, max=1e3) for variable in DUFFING.states]
    )
    free, _ = estimates_of_theta(DUFFING, noise)
    bounded, _ = estimates_of_theta(wide, noise)
    np.testing.assert_allclose(bounded, free, rtol=0, atol=7e-13)


def contradicting():
    """A speed of at least 5 within a path of 1: impossible for longer than 0.2 s."""
    return Model(
        name="contradicting",
        states=[Variable("x1", min=0.0, max=1.0), Variable("x2", start=5.0, min=5.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.x2, 0],
        output=lambda x, u, p, t: [x.x1],
    )


def test_bounds_that_contradict_each_other_are_said_with_their_violation():
    run = Instance(pseudospectral(contradicting(), sample_time=0.1, N=4, L=10))
    for k in range(20):
        run.set("y", 0.5)
        run.step(0.1 * k, 0.1)
    assert run.get("diagnostics.status") == CODE.inconsistent
    assert run.get("diagnostics.constraint_violation") == pytest.approx(4.0, rel=0.05)  # x2 of 5 takes x1 from 0 to 5
    assert np.isfinite(run.outputs()).all()


def test_samples_beyond_the_bounds_are_fitted_as_well_as_those_allow():
    run = Instance(pseudospectral(oscillator(min=-1.0, max=1.0), sample_time=TS, N=14, L=20))
    for k in range(40):
        run.set("y", 1.5 * np.cos(TS * k))
        run.step(TS * k, TS)
    amplitude = np.hypot(run.get("filtered.x1"), run.get("filtered.x2"))
    assert amplitude == pytest.approx(1.0, abs=0.02)
    # The window holds 4 s of it: what is left of 1.5 cos t is about 0.5 cos t.
    assert run.get("diagnostics.cost") == pytest.approx(
        0.5**2 * np.sum(np.cos(TS * np.arange(19, 40)) ** 2) * TS, rel=0.1
    )
    assert run.get("diagnostics.constraint_violation") < 1e-6


def test_bounds_go_with_an_arrival_cost():
    rng = np.random.default_rng(1)
    component = pseudospectral(
        oscillator(min=-1.0, max=1.0), sample_time=TS, N=6, L=4, arrival_cost=True, measurement_noise={"y": 0.3}
    )
    run, worst = Instance(component), 0.0
    for k in range(100):
        run.set("y", 0.95 * np.cos(TS * k) + rng.uniform(-0.5, 0.5))
        run.step(TS * k, TS)
        assert abs(run.get("filtered.x1")) < 1 + (1e-6 if k >= 4 else 1e-3)  # at first the estimate lies between nodes
        worst = max(worst, abs(run.get("filtered.x1") - 0.95 * np.cos(TS * k))) if k > 50 else 0.0
    assert worst < 0.15 and run.get("diagnostics.solver_failures") == 0


def test_a_guess_outside_the_bounds_is_refused_with_the_limit():
    with pytest.raises(ModelError, match=r"guess of 'x3' = -0\.5 lies outside \[0, inf\]"):
        pseudospectral(rotation(), sample_time=TS, guess={"x3": -0.5})
    with pytest.raises(ValueError, match=r"guess\.x3 = -0\.5 lies outside \[0, inf\]"):
        Instance(pseudospectral(rotation(), sample_time=TS, N=15), {"guess.x3": -0.5})


def test_the_fmu_honours_the_bound_as_the_python_face_does(slave: Callable[..., Slave]) -> None:
    start = {"guess.x1": -1.0, "guess.x2": -1.0, "guess.x3": 0.2}
    fmu, face = slave("rotation_bounded").initialize(start), Instance(COMPONENTS["rotation_bounded"](), start)
    assert float(fmu.variables["guess.x3"].min) == 0
    names = [port.name for port in face.component.outputs]
    for k in range(30):
        for run in (fmu, face):
            run.set("y", np.sin(TS * k))
            run.step(TS * k, TS)
        np.testing.assert_allclose([fmu.get(name) for name in names], face.outputs(), rtol=0, atol=1e-10)
    assert fmu.get("filtered.x3") == pytest.approx(1.0, abs=1e-7)
    fmu.refuses(lambda: fmu.set("guess.x3", 1.0))
