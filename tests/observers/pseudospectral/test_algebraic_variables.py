"""Section 3.5: observers of models with algebraic variables, against the plant, the Kalman filter, and up to the singularity."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException

from build_fmus import FMUS
from cosim.master import run
from moving_window import coupled, linear, sampled
from observers.instance import Instance
from observers.model import Model, ModelError, Variable
from observers.pseudospectral import pseudospectral
from observers.status import CODE
from reference_models.plant import plant
from reference_models.rlc import RLC
from rlc_branches import STARTS

TS = 0.2
TRUSTED = {CODE.settling, CODE.estimating}
NAMES = ("x1", "x2", "x3")
Make = Callable[..., object]


def to_the_end(p, o, most=40):
    """(status, worst error of the three estimates) at every sample until the plant cannot go on."""
    rows = []
    for k in range(most):
        true = [p.get("x.x1"), p.get("x.x2"), p.get("z.x3")]
        o.set("y", p.get("y"))
        o.step(k * TS, TS)
        error = np.abs([o.get(f"filtered.{name}") for name in NAMES] - np.array(true)).max()
        rows.append((int(o.get("diagnostics.status")), error))
        try:
            p.step(k * TS, TS)
        except (FMICallException, ValueError):
            return rows
    raise AssertionError("the circuit's branch should have ended")


@pytest.mark.parametrize("start", STARTS, ids=str)
def test_example_6_is_exact_from_the_first_estimate_on_every_branch_and_says_where_it_ends(
    catalogue_slave: Make, start: tuple[float, float, float]
) -> None:
    """Three states from x2 alone, x3 by its equation; every FMU's step up to the plant's refusal at the singularity."""
    p = catalogue_slave("rlc").initialize({f"start.{name}": value for name, value in zip(NAMES, start, strict=True)})
    near = {"guess.x1": start[0] + 0.1, "guess.x2": 0.0, "guess.x3": start[2] + 0.05}
    o = catalogue_slave("rlc_pseudospectral").initialize(near)
    rows = to_the_end(p, o)
    assert [status for status, _ in rows[1:8]] == [CODE.settling] * 4 + [CODE.estimating] * 3
    trusted = [error for status, error in rows if status in TRUSTED]
    assert len(trusted) > 8 and max(trusted) < 1e-5
    first_warning = next(i for i, (status, _) in enumerate(rows[1:], start=1) if status not in TRUSTED)
    assert rows[first_warning][0] == CODE.singular
    assert not TRUSTED & {status for status, _ in rows[first_warning:]}
    assert np.isfinite(list(o.outputs().values())).all()
    message = p.refuses(lambda: p.step(len(rows) * TS - TS, TS))
    assert re.search(r"the algebraic equations do not determine 'x3' .*smallest pivot of dg/dz", message)


def test_example_6_as_a_system_shows_the_algebraic_variable_of_the_current_time(
    catalogue_system: Callable[[str], Path],
) -> None:
    result = run(catalogue_system("gong_example_6"), stop=3.8)
    assert len(result.time) == 20
    for name, true in (("x1", "x.x1"), ("x2", "x.x2"), ("x3", "z.x3")):
        gap = np.abs(result[f"observer.estimate.{name}"] - result[f"plant.{true}"])
        assert gap[2:].max() <= 1e-5, (name, gap)
    assert set(result["observer.diagnostics.status"][2:]) <= TRUSTED


def test_the_fmu_of_the_circuits_observer_is_the_python_face(catalogue_slave: Make) -> None:
    fmu, face = catalogue_slave("rlc_pseudospectral").initialize(), Instance(FMUS["rlc_pseudospectral"][0]())
    p = Instance(plant(RLC))
    assert fmu.variables["estimate.x3"].unit == "V"
    names = [port.name for port in face.component.outputs]
    for k in range(19):
        for one in (fmu, face):
            one.set("y", p.get("y") + 0.01 * (-1) ** k)
            one.step(k * TS, TS)
        p.step(k * TS, TS)
        np.testing.assert_allclose([fmu.get(name) for name in names], face.outputs(), rtol=0, atol=1e-9)


TWO = Model(
    name="two",
    states=[Variable("x1", start=0.8), Variable("x2", start=-0.4)],
    algebraic=[Variable("z1"), Variable("z2")],
    inputs=[Variable("u")],
    unknown_parameters=[Variable("theta", start=0.7)],
    outputs=[Variable("y")],
    ode=lambda x, z, u, p, t: [x.x2 + 0.1 * z.z2, -z.z1 - 0.1 * x.x2],
    algebraic_equations=lambda x, z, u, p, t: [
        z.z1 + 0.2 * z.z1**3 - p.theta * x.x1 - 0.3 * u.u,
        z.z2 - ca.sin(x.x2) + 0.1 * z.z1 * z.z2,
    ],
    output=lambda x, z, u, p, t: [x.x1 + 0.3 * z.z2],
)


@pytest.mark.parametrize(("segments", "N", "amplitude"), [(1, 14, 0.0), (4, 7, 0.0), (8, 6, 1.0)])
def test_two_algebraic_variables_with_an_unknown_parameter_and_one_of_them_measured_are_estimated_exactly(
    segments, N, amplitude
) -> None:
    """With a held input in their equations too, where every interval is a segment: its kinks act on the rates."""
    guess = {"guess.x1": 0.0, "guess.x2": 0.0, "guess.theta": 1.0}
    component = pseudospectral(TWO, sample_time=0.1, N=N, L=8, segments=segments)
    errors, o = coupled(TWO, component, 120, 0.1, lambda t: amplitude * np.sin(t), guess=guess)
    assert errors[8:].max() < 2e-9
    assert o.get("diagnostics.solver_failures") == 0 and o.get("diagnostics.status") == CODE.estimating


def linear_dae():
    """`moving_window.linear` with its second state and its second output as algebraic variables."""
    return linear(
        name="linear_dae",
        algebraic=[Variable("v"), Variable("w")],
        ode=lambda x, z, u, p, t: [z.v, -2 * x.x1 - 0.3 * z.v + x.x3 + u.u, -0.5 * x.x3 + 0.4 * u.u],
        algebraic_equations=lambda x, z, u, p, t: [z.v - x.x2, z.w + 0.5 * z.v - x.x1 - 0.5 * x.x3 - 0.5 * x.x2],
        output=lambda x, z, u, p, t: [x.x1, z.w + 0.2 * u.u],
    )


@pytest.mark.parametrize(("segments", "N"), [(1, 12), (3, 9)])
def test_a_linear_dae_under_noise_is_estimated_as_its_ordinary_differential_equation_is(segments, N) -> None:
    L, rng = 6, np.random.default_rng(4)
    y = rng.normal(size=(25, 2))
    o = Instance(pseudospectral(linear_dae(), sample_time=0.1, N=N, L=L, segments=segments))
    reference = sampled(0.1)
    for k in range(25):
        o.set("y1", y[k, 0])
        o.set("y2", y[k, 1])
        o.step(0.1 * k, 0.1)
        if k >= L:
            expected = reference.smoothed(y[k - L : k + 1], np.zeros(L + 1))
            found = [o.get(f"filtered.{name}") for name in (*NAMES, "v", "w")]
            full = [*expected, expected[1], expected[0] + 0.5 * expected[2]]
            np.testing.assert_allclose(found, full, rtol=0, atol=2e-14 * (1 + np.abs(expected).max()))


@pytest.mark.parametrize("segments", [1, 2])
def test_a_linear_dae_with_an_arrival_cost_is_the_kalman_filter(segments) -> None:
    rng = np.random.default_rng(4)
    y, valid = rng.normal(size=(40, 2)), rng.random((40, 2)) > 0.2
    component = pseudospectral(
        linear_dae(),
        sample_time=0.1,
        N=10,
        L=4,
        segments=segments,
        arrival_cost=True,
        measurement_noise={"y1": 0.3, "y2": 0.5},
    )
    # Its samples are none of the model: none is an outlier.
    o, model, x, P = Instance(component, {"tuning.gate": 1e30}), sampled(0.1), np.zeros(3), np.eye(3)
    for k in range(40):
        for i in (0, 1):
            o.set(f"y{i + 1}", y[k, i])
            o.set(f"measurement_valid.y{i + 1}", float(valid[k, i]))
        o.step(0.1 * k, 0.1)
        C, R = model.C[valid[k]], np.diag(np.square([0.3, 0.5])[valid[k]])
        G = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
        x, P = x + G @ (y[k][valid[k]] - C @ x), P - G @ C @ P
        np.testing.assert_allclose([o.get(f"filtered.{name}") for name in NAMES], x, rtol=0, atol=2e-10)
        x, P = model.F @ x, model.F @ P @ model.F.T


@pytest.mark.parametrize("segments", [1, 5])
def test_the_circuit_under_bounded_noise_is_estimated_inside_its_tube(segments) -> None:
    bound, start = 0.02, {"start.x1": 4.0, "start.x2": 1.5, "start.x3": 2.7}
    sensor = {"sensor.noise_bound": bound, "sensor.sample_time": 0.1, "sensor.seed": 2}
    rms = {}
    for noise_bound in (None, bound):
        component = pseudospectral(
            RLC, sample_time=0.1, N=15 if segments == 1 else 6, L=10, segments=segments, noise_bound=noise_bound
        )
        p, o, errors = Instance(plant(RLC), start | sensor), Instance(component, {"guess.x1": 4.1, "guess.x3": 2.8}), []
        for k in range(34):
            true = p.get("x.x2")
            o.set("y", p.get("y"))
            p.step(0.1 * k, 0.1)
            o.step(0.1 * k, 0.1)
            if k >= 10:
                errors.append(o.get("filtered.x2") - true)
            if noise_bound and o.get("diagnostics.status") == CODE.estimating:
                low, high = o.get("diagnostics.lower"), o.get("diagnostics.upper")
                assert low <= true <= high and low - 1e-6 <= o.get("filtered.x2") <= high + 1e-6
        rms[noise_bound] = np.sqrt(np.mean(np.square(errors)))
        assert o.get("diagnostics.solver_failures") == 0
    assert rms[bound] < 1.05 * rms[None] < bound


def test_algebraic_variables_without_effect_on_the_states_are_refused() -> None:
    model = Model(
        name="idle",
        states=[Variable("a", start=1.0)],
        algebraic=[Variable("z")],
        outputs=[Variable("y")],
        ode=lambda x, z, u, p, t: [-x.a],
        algebraic_equations=lambda x, z, u, p, t: [z.z - x.a],
        output=lambda x, z, u, p, t: [z.z],
    )
    with pytest.raises(ModelError, match="'idle' has algebraic variables that no state's equation contains"):
        pseudospectral(model, sample_time=0.1, N=15)


@pytest.mark.parametrize("bounds", [{"min": 0.0}, {"max": 9.0}])
def test_bounds_of_an_algebraic_variable_are_refused_by_name_not_ignored(bounds: dict[str, float]) -> None:
    (x3,) = RLC.algebraic
    model = dataclasses.replace(RLC, algebraic=[dataclasses.replace(x3, **bounds)])
    with pytest.raises(ModelError, match=r"bounds the algebraic variable 'x3' by \[.*not imposed"):
        pseudospectral(model, sample_time=0.2, N=8, L=5)
