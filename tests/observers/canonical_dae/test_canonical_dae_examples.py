"""Nikoukhah 1995 through the built FMUs and the master: the motor of section 5, Examples 2.1 to 2.3, faults, an unknown input."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import place_poles

from build_fmus import FMUS
from cosim.results import Result
from observers.canonical_dae import fault_detector
from observers.instance import Instance
from observers.status import CODE
from reference_models import nikoukhah_1995
from reference_models.chua import CHUA
from reference_models.motor import MOTOR

A2 = next(v.start for v in MOTOR.parameters if v.name == "A2")
NOISE = {f"plant.sensor.noise_std.{y}": 1e-3 for y in ("y1", "y2")} | {"plant.sensor.sample_time": 1e-3}
Example = Callable[..., Result]


@pytest.fixture(scope="module")
def example(example: Example) -> Example:
    """Runs a system of this paper, named without its prefix."""
    return lambda name, **options: example(f"nikoukhah_{name}", **options)


def error(result: Result, state: str = "x3") -> np.ndarray:
    """|filtered - true| at the sample instants of a run with h = Ts: row k + 1 filters the sample of row k."""
    return np.abs(result[f"observer.filtered.{state}"][1:] - result[f"plant.x.{state}"][:-1])


def test_the_motors_hidden_state_converges_as_the_reference_does(example: Example) -> None:
    found = error(example("motor"))[[200, 500, 1000, 2000, 3000]]
    # The reference gives 1.0e-3 at t = 2, to two digits; 1.04e-3 is what the continuous equations give.
    np.testing.assert_allclose(found, [6.0, 0.541, 7.25e-3, 1.04e-3, 3.9e-7], rtol=0.03)
    assert error(example("motor"))[4001:].max() < 6e-9


def test_the_measured_states_equal_the_measurements_exactly(example: Example) -> None:
    for name in ("motor", "motor_regional", "motor_bdf"):
        assert error(example(name), "x1").max() == 0 and error(example(name), "x2").max() == 0
    noisy = example("motor", overrides=NOISE)
    acts = noisy["observer.diagnostics.status"][1:] != CODE.outlier
    assert acts.mean() > 0.999
    np.testing.assert_array_equal(noisy["observer.filtered.x1"][1:][acts], noisy["plant.y1"][:-1][acts])
    np.testing.assert_array_equal(noisy["observer.filtered.x2"][1:][acts], noisy["plant.y2"][:-1][acts])


def test_regional_placement_converges_as_the_continuous_equations_do(example: Example) -> None:
    # By scipy, solve_continuous_are at every instant, rtol 1e-8: see docs/canonical_dae.md.
    found = error(example("motor_regional"))[[200, 500, 1000]]
    np.testing.assert_allclose(found, [0.3782, 0.1952, 1.795e-3], rtol=0.01)


def test_backward_differentiation_agrees_with_the_w_form(example: Example) -> None:
    w, bdf = example("motor"), example("motor_bdf")
    gap = np.abs(w["observer.filtered.x3"] - bdf["observer.filtered.x3"])
    assert gap[2000:].max() < 1e-3 and gap.max() < 0.05


def test_outputs_are_the_estimate_of_their_own_time_for_parts_of_a_sample(example: Example) -> None:
    # The source steps four times in a sample then: the observer takes the mean, which costs the square of the input's change.
    result = example("motor", step=2.5e-4)
    for state, limit in (("x1", 1e-9), ("x2", 1e-8), ("x3", 1e-6)):
        gap = np.abs(result[f"observer.estimate.{state}"] - result[f"plant.x.{state}"])
        assert gap[16004:].max() < limit


@pytest.mark.long
def test_an_actuator_fault_is_detected_within_50_ms_and_noise_alone_never_in_60_s(example: Example) -> None:
    for seed in (0, 5):
        quiet = example("motor", stop=64.0, overrides=NOISE | {"plant.sensor.seed": seed})
        assert set(quiet["observer.diagnostics.fault"][4000:]) <= {fault_detector.QUIET, fault_detector.SUSPECTED}
    for onset, seed in ((64.0, 0), *((4.0, seed) for seed in range(8))):
        fault = {
            "plant.parameter.actuator_fault_jump_time[1]": onset,
            "plant.parameter.actuator_fault_jump_value[1]": 2.0,
        }
        result = example("motor", stop=onset + 1.0, overrides=NOISE | fault | {"plant.sensor.seed": seed})
        detected = result["observer.diagnostics.fault"] == fault_detector.DETECTED
        first = result.time[np.flatnonzero(detected)[0]]
        assert onset < first <= onset + 0.05
        assert detected[result.time > first].mean() > 0.5


def test_an_actuator_fault_drives_lambda_2_to_the_references_0_31(example: Example) -> None:
    fault = {"plant.parameter.actuator_fault_jump_time[1]": 4.0, "plant.parameter.actuator_fault_jump_value[1]": 2.0}
    residual = np.abs(example("motor", overrides=fault)["observer.diagnostics.lambda[2]"])
    assert residual[3500:4000].max() < 6e-4 and residual[4001:].max() == pytest.approx(0.31, rel=0.03)


def test_a_sensor_bias_shows_in_lambda_2_at_its_size(example: Example) -> None:
    bias = {"plant.parameter.bias_y2_jump_time[1]": 4.0, "plant.parameter.bias_y2_jump_value[1]": 0.1}
    result = example("motor", overrides=bias)
    assert np.abs(result["observer.diagnostics.lambda[2]"][4050:] - 0.1).max() < 1e-3
    assert np.abs(result["observer.diagnostics.lambda[1]"][4050:]).max() < 1e-3
    assert result["observer.diagnostics.fault"][4010] == fault_detector.DETECTED
    for seed in range(3):
        noisy = example("motor", overrides=NOISE | bias | {"plant.sensor.seed": seed})
        assert noisy["observer.diagnostics.lambda[2]"][4050:].mean() == pytest.approx(0.1, abs=1e-3)
        assert np.abs(noisy["observer.diagnostics.lambda[2]"][4050:] - 0.1).max() < 0.01


@pytest.mark.parametrize("name", ["motor", "motor_regional", "motor_bdf"])
def test_a_motor_that_spins_through_many_turns_leaves_no_nan_and_says_where_the_gain_is_singular(
    example: Example, name: str
) -> None:
    overrides = {"plant.start.x2": 60.0, "observer.tuning.singularity_guard": 0.1 if name != "motor_regional" else 1e-3}
    result = example(name, stop=10.0, overrides=overrides)
    assert result["plant.x.x1"][-1] > 100 * 2 * math.pi
    assert np.isfinite(result.values).all()
    assert result["observer.diagnostics.solver_failures"][-1] == 0
    status = result["observer.diagnostics.status"][1:]
    assert set(status) <= {CODE.estimating, CODE.settling, CODE.inconsistent, CODE.singular}
    assert np.sum(status == CODE.singular) == result["observer.diagnostics.singular_gains"][-1]
    determinant = A2 * np.abs(np.sin(result["plant.x.x1"][:-1]))
    singular = status == CODE.singular
    if name != "motor_regional":
        np.testing.assert_array_equal(singular, determinant < 0.1)
    assert determinant[singular].max() < determinant[~singular].mean()
    assert error(result)[-1] < 1.0  # from 10, without its gain at every half turn


@pytest.mark.parametrize(("amplitude", "offset", "stop"), [(0.0, 1.0, 20.0), (1.0, 0.0, 30.0)], ids=["1", "sin t"])
def test_example_2_1_converges_for_an_exciting_input(
    example: Example, amplitude: float, offset: float, stop: float
) -> None:
    result = example("example_2_1", stop=stop, overrides={"source.amplitude": amplitude, "source.offset": offset})
    gap = error(result, "x1")
    assert gap[0] == 1.0 and gap[-1] < 2e-3
    V = gap**2 + result["observer.diagnostics.lambda"][1:] ** 2  # (2.20) with alpha = 1
    assert np.diff(V).max() < 1e-4


def test_example_2_1_cannot_converge_for_no_input(example: Example) -> None:
    assert error(example("example_2_1", overrides={"source.amplitude": 0.0}), "x1")[-1] > 0.99


@pytest.mark.parametrize("size", [0.01, 1.0, 100.0])
def test_example_2_2s_error_is_the_linear_equations_through_the_fmus(example: Example, size: float) -> None:
    alpha, beta, _, linear = (p.start for p in CHUA.parameters)
    A = np.array([[-alpha * linear, alpha, 0], [1, -1, 1], [0, -beta, 0]])
    J = place_poles(A.T, np.eye(3)[:, :1], nikoukhah_1995.CHUA_POLES).gain_matrix.T
    guess = {"observer.guess.x1": max(size, 1), "observer.guess.x2": -size, "observer.guess.x3": size}
    result = example("example_2_2", overrides=guess)
    times = result.time[:-1]
    w = np.array([expm((A - J @ np.eye(3)[:1]) * t) @ [0, -size, size] for t in times])
    for i, state in ((1, "x2"), (2, "x3")):
        gap = result[f"observer.filtered.{state}"][1:] - result[f"plant.x.{state}"][:-1]
        np.testing.assert_allclose(gap, w[:, i], rtol=0, atol=2e-6 * max(size, 1))


def response(slave: Callable, frequency: float, gamma: tuple[float, float]) -> complex:
    """Amplitude and phase of filtered.x2 for y = sin(frequency t) at Ts = 0.01, once the transient is over."""
    root = -gamma[0] / 2  # a double pole
    observer = slave("double_integrator_canonical_dae").initialize({"tuning.pole[1]": root, "tuning.pole[2]": root})
    count = 2200
    times, found = 0.01 * np.arange(count), np.empty(count)
    for k in range(count):
        observer.set("y", math.sin(frequency * times[k]))
        observer.step(times[k], 0.01)
        found[k] = observer.get("filtered.x2")
        assert observer.get("filtered.x1") == math.sin(frequency * times[k])  # (2.66): x1 = y
    late = times > 17
    basis = np.column_stack([np.sin(frequency * times[late]), np.cos(frequency * times[late])])
    real, imaginary = np.linalg.lstsq(basis, found[late], rcond=None)[0]
    return complex(real, imaginary)


@pytest.mark.parametrize("part", [0.005, 0.02, 0.05, 0.08, 0.1])
@pytest.mark.parametrize("pole", [-1.0, -4.0, -10.0])
def test_example_2_3_has_the_transfer_function_2_66_up_to_a_tenth_of_the_sampling_frequency(
    catalogue_slave: Callable, part: float, pole: float
) -> None:
    frequency, gamma = part * 2 * math.pi / 0.01, (-2 * pole, pole**2)
    s = 1j * frequency
    expected = gamma[1] * s / (s**2 + gamma[0] * s + gamma[1])
    assert abs(response(catalogue_slave, frequency, gamma) - expected) < 1e-4


def test_an_unknown_force_is_known_one_sample_after_it_jumps_and_disturbs_nothing(example: Example) -> None:
    result = example("unknown_force")
    force, time = result["observer.estimate.force"], result.time
    np.testing.assert_allclose(force[(time > 1.05) & (time < 2.99)], 2.0, rtol=0, atol=1e-9)
    np.testing.assert_allclose(force[time > 3.05], -1.0, rtol=0, atol=1e-9)
    assert error(result, "x2").max() == 0


def test_a_measurement_that_is_not_a_number_is_counted_and_logged(catalogue_slave: Callable) -> None:
    slave = catalogue_slave("motor_canonical_dae").initialize()
    for k in range(20):
        slave.set("y1", math.nan if k == 10 else 0.8)
        slave.set("y2", math.nan if k == 10 else 0.1)
        slave.set("u", 2.0)
        prediction = slave.get("estimate.x3")
        slave.step(0.001 * k, 0.001)
        if k == 10:
            assert slave.get("filtered.x3") == prediction
            assert slave.get("diagnostics.status") >= CODE.sample_rejected
    assert slave.get("diagnostics.rejected_samples") == 1
    assert any("rejected_samples" in text for _, category, text in slave.messages if category == "logStatusWarning")


@pytest.mark.parametrize("name", ["motor", "motor_regional", "motor_bdf"])
def test_the_python_face_and_the_fmu_agree_over_a_whole_run(example: Example, name: str) -> None:
    result = example(name, stop=1.0, overrides=NOISE)
    observer = Instance(FMUS[name.replace("motor", "motor_canonical_dae")][0](), nikoukhah_1995.DETECTOR)
    names = [port.name for port in observer.component.outputs]
    for k in range(len(result.time) - 1):
        for measured in ("y1", "y2"):
            observer.set(measured, result[f"plant.{measured}"][k])
        observer.set("u", result["source.y"][k])
        observer.step(result.time[k], result.step)
        expected = np.array([result[f"observer.{output}"][k + 1] for output in names])
        np.testing.assert_allclose(observer.outputs(), expected, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("sample", [2, 40])
def test_a_saved_state_resumes_bit_for_bit(catalogue_slave: Callable, sample: int) -> None:
    slave = catalogue_slave("motor_canonical_dae_bdf").initialize()

    def advance(first: int, count: int) -> None:
        for k in range(first, first + count):
            slave.set("y1", 0.8 + 0.1 * math.sin(k))
            slave.set("y2", 0.1 * math.cos(k))
            slave.step(0.001 * k, 0.001)

    advance(0, sample)
    saved = slave.fmu.getFMUState()
    advance(sample, 30)
    once = slave.outputs()
    slave.fmu.setFMUState(saved)
    slave.fmu.freeFMUState(saved)
    advance(sample, 30)
    assert slave.outputs() == once
