"""Missing, late and irregular samples: what has not arrived weighs nothing, and what is left says how much it can be trusted."""

from __future__ import annotations

from collections.abc import Callable

import fmpy
import numpy as np
import pytest

import moving_window
from components import COMPONENTS
from moving_window import linear
from observers.canonical_dae import canonical_dae
from observers.component import Component
from observers.elementary import elementary
from observers.instance import Instance
from observers.least_squares import least_squares
from observers.model import Model
from observers.pseudospectral import pseudospectral
from observers.riccati import riccati
from observers.status import CODE
from observers.ukf import ukf
from reference_models.duffing import DUFFING
from reference_models.motor import MOTOR
from reference_models.plant import plant
from reference_models.van_der_pol import VAN_DER_POL_KNOWN
from slave import Slave

Make = Callable[..., Slave]

GUESS = {"guess.x1": 0.0, "guess.x2": 0.0, "guess.theta": 0.1}
NOISE = {
    "process_noise": {"x1": 1e-4, "x2": 1e-4, "theta": 0.03},
    "measurement_noise": {"y": 1e-3},
}
KINDS = {
    "pseudospectral": lambda: pseudospectral(DUFFING, sample_time=0.1, N=15),
    "segments": lambda: pseudospectral(DUFFING, sample_time=0.1, N=7, segments=4),
    "arrival cost": lambda: pseudospectral(DUFFING, sample_time=0.1, arrival_cost=True, **NOISE),
    "tube": lambda: pseudospectral(DUFFING, sample_time=0.1, noise_bound=0.05),
    "spline": lambda: pseudospectral(DUFFING, sample_time=0.1, cost="spline"),
    "ukf": lambda: ukf(DUFFING, sample_time=0.1, **NOISE),
}


def over_gaps(run, arrives, mark):
    """Outputs after every step of `run` beside Example 1's plant; `mark(run, y)` where a sample has not arrived. And the errors."""
    p, rows, errors = Instance(plant(DUFFING)), [], []
    for k, there in enumerate(arrives):
        true = np.array([p.get(f"x.{name}") for name in ("x1", "x2", "theta")])
        run.set("y", p.get("y"))
        run.set("measurement_valid.y", 1.0)
        if not there:
            mark(run, p.get("y"))
        p.step(0.1 * k, 0.1)
        run.step(0.1 * k, 0.1)
        rows.append(run.outputs() if isinstance(run, Instance) else list(run.outputs().values()))
        errors.append(np.abs([run.get(f"filtered.{name}") for name in ("x1", "x2", "theta")] - true))
    return np.array(rows), np.array(errors)


def flagged(run, y):
    """The value that is still on the line is not looked at."""
    run.set("y", 1e6)
    run.set("measurement_valid.y", 0.0)


def not_a_number(run, y):
    run.set("y", np.nan)


@pytest.mark.parametrize("kind", KINDS)
def test_a_sample_that_has_not_arrived_is_as_one_that_is_no_number_but_is_not_counted_as_rejected(kind: str) -> None:
    arrives = np.random.default_rng(2).random(60) > 0.3
    arrives[30:35] = False
    made, runs = KINDS[kind](), []
    for mark in (flagged, not_a_number):
        run = Instance(made, GUESS)
        runs.append((over_gaps(run, arrives, mark)[0], run.get("diagnostics.rejected_samples")))
    counter = [port.name for port in made.outputs].index("diagnostics.rejected_samples")
    (by_flag, counted_flag), (by_nan, counted_nan) = runs
    np.testing.assert_array_equal(np.delete(by_flag, counter, 1), np.delete(by_nan, counter, 1))
    assert counted_flag == 0 and counted_nan == np.sum(~arrives) > 15


@pytest.mark.parametrize("kind", ["pseudospectral", "segments", "arrival cost"])
@pytest.mark.parametrize("seed", range(4))
def test_half_of_the_samples_at_random_are_enough_where_there_is_no_noise(kind: str, seed: int) -> None:
    arrives = np.random.default_rng(seed).random(200) > 0.5
    run = Instance(KINDS[kind](), GUESS)
    _, errors = over_gaps(run, arrives, flagged)
    assert errors[100:].max() < (1e-3 if kind == "arrival cost" else 1e-5)
    assert run.get("diagnostics.solver_failures") == 0


def over_a_gap_of_8(parameters=None):
    """Conditioning and status over 60 samples, of which 30 to 37 are missing, and the conditioning without the gap."""
    found = []
    for gap in (True, False):
        run = Instance(KINDS["pseudospectral"](), GUESS | (parameters or {}))
        arrives = np.ones(60, bool)
        arrives[30:38] = not gap
        rows, _ = over_gaps(run, arrives, flagged)
        names = [port.name for port in run.component.outputs]
        found.append([rows[:, names.index(f"diagnostics.{n}")] for n in ("conditioning", "status")])
    (conditioning, status), (usual, _) = found
    return conditioning, status, usual


def test_the_conditioning_falls_with_the_samples_that_are_missing_and_the_status_says_where_none_are_left() -> None:
    conditioning, status, usual = over_a_gap_of_8()
    assert set(status[30:36]) == {CODE.sample_rejected}
    assert set(status[36:40]) == {CODE.propagated_guess}  # two samples or fewer for three unknowns
    assert conditioning[40] < usual[40] / 10  # three of nine
    assert np.all(conditioning[40:46] < usual[40:46])
    np.testing.assert_allclose(conditioning[46:], usual[46:], rtol=6e-11)  # whole again
    assert set(status[40:]) == {CODE.estimating}


def test_a_window_with_too_little_in_it_is_said_not_to_determine_the_state_and_the_prediction_kept() -> None:
    """By a limit of conditioning between that of three samples and that of the whole window."""
    conditioning, status, _ = over_a_gap_of_8({"tuning.conditioning_limit": 1e-5})
    for k in range(40, 60):
        expected = CODE.undetermined if conditioning[k] <= 1e-5 else CODE.estimating
        assert status[k] == expected
    assert CODE.undetermined in status[40:43] and status[-1] == CODE.estimating


@pytest.mark.parametrize("kind", ["pseudospectral", "segments", "arrival cost", "ukf"])
def test_a_gap_of_three_windows_is_bridged_by_the_model_and_left_behind(kind: str) -> None:
    arrives = np.ones(140, bool)
    arrives[50:74] = False
    run = Instance(KINDS[kind](), GUESS)
    rows, errors = over_gaps(run, arrives, flagged)
    assert np.isfinite(rows).all()
    assert errors[50:74].max() < (0.1 if kind == "ukf" else 1e-2)
    assert errors[120:].max() < (1e-2 if kind == "ukf" else 1e-4)
    names = [port.name for port in run.component.outputs]
    status = rows[:, names.index("diagnostics.status")]
    # A window that has lost all its samples is one that has not begun.
    lost = {CODE.sample_rejected} if kind == "ukf" else {CODE.sample_rejected, CODE.propagated_guess}
    assert set(status[50:74]) == lost and list(status[50:74]) == sorted(status[50:74])
    assert run.get("diagnostics.rejected_samples") == 0 == run.get("diagnostics.solver_failures")


def test_the_filters_standard_deviations_grow_over_a_gap() -> None:
    arrives = np.ones(80, bool)
    arrives[50:65] = False
    run = Instance(KINDS["ukf"](), GUESS)
    rows, _ = over_gaps(run, arrives, flagged)
    names = [port.name for port in run.component.outputs]
    theta = rows[:, names.index("diagnostics.std.theta")]
    assert np.all(np.diff(theta[50:65]) > 0) and theta[64] > 1.5 * theta[49] > theta[79]


def test_one_output_of_two_goes_on_alone() -> None:
    model = linear()
    p, run = Instance(plant(model), {"start.x1": 1.0}), Instance(pseudospectral(model, sample_time=0.1, N=12, L=6))
    for k in range(40):
        true = p.get("x.x3")
        run.set("y1", p.get("y1"))
        run.set("y2", 1e6)
        run.set("measurement_valid.y2", 1.0 if k < 10 else 0.0)
        if k < 10:
            run.set("y2", p.get("y2"))
        p.step(0.1 * k, 0.1)
        run.step(0.1 * k, 0.1)
        if k >= 10:
            assert abs(run.get("filtered.x3") - true) < 1e-13
            assert run.get("diagnostics.status") == CODE.sample_rejected
            assert run.get("diagnostics.innovation[2]") == 0
    assert run.get("diagnostics.rejected_samples") == 0


def test_in_the_fmu_it_is_a_boolean_input_that_is_true_from_the_start(slave: Make) -> None:
    fmu = slave("duffing_segments").initialize(GUESS)
    variable = fmu.variables["measurement_valid.y"]
    assert (variable.type, variable.causality, variable.variability) == ("Boolean", "input", "discrete")
    assert fmu.fmu.getBoolean([variable.valueReference]) == [True]
    fmu.fmu.setBoolean([variable.valueReference], [False])
    assert fmu.fmu.getBoolean([variable.valueReference]) == [False]


def test_in_the_fmu_another_type_or_a_derivative_of_it_is_refused_by_name(slave: Make) -> None:
    fmu = slave("duffing_segments").initialize(GUESS)
    (reference,) = [fmu.variables["measurement_valid.y"].valueReference]
    refused = {
        "fmi2GetReal": lambda: fmu.fmu.getReal([reference]),
        "fmi2SetReal": lambda: fmu.fmu.setReal([reference], [1.0]),
        "fmi2SetInteger": lambda: fmu.fmu.setInteger([reference], [1]),
    }
    for call, one in refused.items():
        message = fmu.refuses(one)
        assert call in message and "measurement_valid.y" in message, message
    message = fmu.refuses(lambda: fmu.fmu.setRealInputDerivatives([reference], [1], [1.0]))
    assert f"fmi2SetRealInputDerivatives: the value reference {reference} is no Real input's" in message
    real = fmu.variables["y"].valueReference
    assert "is not of type Boolean but Real" in fmu.refuses(lambda: fmu.fmu.setBoolean([real], [True]))
    assert fmu.get("measurement_valid.y") == 1


@pytest.mark.parametrize("name", ["duffing_segments", "duffing_missing_ukf"])
def test_the_fmu_does_with_gaps_what_the_python_face_does(slave: Make, name: str) -> None:
    arrives = np.random.default_rng(2).random(60) > 0.3
    fmu, face = slave(name).initialize(GUESS), Instance(COMPONENTS[name](), GUESS)
    _, by_fmu = over_gaps(fmu, arrives, flagged)
    _, by_face = over_gaps(face, arrives, flagged)
    np.testing.assert_allclose(by_fmu, by_face, rtol=1e-6, atol=1e-9)
    assert fmu.get("diagnostics.rejected_samples") == 0


def test_the_fmu_runs_in_a_master_that_knows_nothing_of_gaps(built: Callable) -> None:
    """fmpy leaves the flag at its start value."""
    times = 0.1 * np.arange(31)
    signal = np.array(list(zip(times, np.cos(times), strict=True)), dtype=[("time", float), ("y", float)])
    result = fmpy.simulate_fmu(
        str(built("duffing_segments")),
        input=signal,
        stop_time=3.0,
        output_interval=0.1,
        output=["diagnostics.rejected_samples", "diagnostics.status"],
    )
    assert result["diagnostics.rejected_samples"][-1] == 0
    assert CODE.sample_rejected not in set(result["diagnostics.status"])


def _motor(**options) -> Component:
    return canonical_dae(MOTOR, sample_time=0.01, guess={"x3": 0.0}, **options)


# Of each of the other observers: a component, what its measured plant is, its known inputs.
OTHERS: dict[str, tuple[Callable[[], Component], Model, dict[str, float]]] = {
    "riccati": (lambda: riccati(moving_window.linear(), sample_time=0.1), moving_window.linear(), {}),
    "least squares": (
        lambda: least_squares(moving_window.linear(), sample_time=0.1, T=0.5),
        moving_window.linear(),
        {},
    ),
    "canonical DAE": (_motor, MOTOR, {"u": 2.0}),
    "canonical DAE, BDF": (lambda: _motor(form="bdf"), MOTOR, {"u": 2.0}),
    "elementary": (
        lambda: elementary(VAN_DER_POL_KNOWN, sample_time=0.05, N=11, guess={"x2": 0.0}),
        VAN_DER_POL_KNOWN,
        {"u": 0.2},
    ),
}


def beside_the_plant(made, model, known, arrives, mark):
    """The outputs of the observer `made` after every step beside the plant of `model`; `mark(run, y)` where a sample has not arrived."""
    p, run = Instance(plant(model)), Instance(made)
    Ts, rows = run.sample_time, []
    for k, there in enumerate(arrives):
        for name, value in known.items():
            p.set(name, value)
            run.set(name, value)
        for i, v in enumerate(model.outputs):
            run.set(v.name, p.get(v.name))
            run.set(f"measurement_valid.{v.name}", 1.0)
            if not there[i]:
                mark(run, v.name)
        p.step(Ts * k, Ts)
        run.step(Ts * k, Ts)
        rows.append(run.outputs())
    return np.array(rows), run


@pytest.mark.parametrize("kind", OTHERS)
def test_in_every_other_observer_too_a_flagged_sample_is_as_one_that_is_no_number_but_not_rejected(kind: str) -> None:
    make, model, known = OTHERS[kind]
    made, ny = make(), len(model.outputs)
    arrives = np.random.default_rng(3).random((60, ny)) > 0.3
    arrives[30:35] = False

    def by_flag(run, y):
        run.set(y, 1e6)
        run.set(f"measurement_valid.{y}", 0.0)

    flagged_rows, with_flags = beside_the_plant(made, model, known, arrives, by_flag)
    nan_rows, with_nan = beside_the_plant(made, model, known, arrives, lambda run, y: run.set(y, np.nan))
    names = [port.name for port in made.outputs]
    counter = names.index("diagnostics.rejected_samples")
    np.testing.assert_array_equal(np.delete(flagged_rows, counter, 1), np.delete(nan_rows, counter, 1))
    assert np.isfinite(flagged_rows).all()
    incomplete = ~arrives.all(axis=1)
    assert with_flags.get("diagnostics.rejected_samples") == 0
    assert with_nan.get("diagnostics.rejected_samples") == incomplete.sum() > 15
    for i in range(ny):
        innovation = names.index(f"diagnostics.innovation[{i + 1}]" if ny > 1 else "diagnostics.innovation")
        assert np.all(flagged_rows[~arrives[:, i], innovation] == 0)
    status = flagged_rows[:, names.index("diagnostics.status")]
    assert np.all(status[~arrives.any(axis=1)] >= CODE.sample_rejected)  # or what is graver, such as the start
    assert not np.any(status[~incomplete] == CODE.sample_rejected)


@pytest.mark.parametrize("name", ["motor_canonical_dae", "van_der_pol_known_elementary"])
def test_their_fmus_do_with_flags_what_the_python_face_does(slave: Make, name: str) -> None:
    fmu, face = slave(name).initialize(), Instance(COMPONENTS[name]())
    outputs = [
        port.name.removeprefix("measurement_valid.")
        for port in face.component.inputs
        if port.name.startswith("measurement_valid.")
    ]
    rng, Ts = np.random.default_rng(4), face.sample_time
    for k in range(40):
        for i, y in enumerate(outputs):
            there = rng.random() > 0.3
            for run in (fmu, face):
                run.set(y, 0.7 + 0.1 * np.sin(0.1 * k + i) if there else 1e6)
                run.set(f"measurement_valid.{y}", float(there))
        for run in (fmu, face):
            run.step(k * Ts, Ts)
        found = [fmu.get(port.name) for port in face.component.outputs]
        np.testing.assert_allclose(found, face.outputs(), rtol=1e-9, atol=1e-9)
    assert fmu.get("diagnostics.rejected_samples") == 0
