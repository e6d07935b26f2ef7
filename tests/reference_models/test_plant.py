"""A plant against scipy, closed forms and the noise generator in whole numbers: time that the equations see, jumps, sensor, ports."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from observers.instance import Instance
from observers.model import Model, Variable
from reference_models.plant import plant
from reference_models.ramp import ramp
from reference_models.sine import sine

# Everything depends on t by itself, and every group of variables has a member.
FORCED = Model(
    name="forced",
    states=[
        Variable("s", "position", "m", start=0.4, nominal=2.0, min=-5, max=5),
        Variable("v", "speed", "m/s", start=-0.2),
    ],
    inputs=[Variable("force", "force", "N", start=0.5, min=-9, max=9)],
    unknown_disturbances=[Variable("wind", "wind", "N")],
    parameters=[Variable("mass", "mass", "kg", start=2.0, min=0.5, max=4.0)],
    unknown_parameters=[Variable("k", "stiffness", "N/m", start=3.0, min=0.0, max=10.0), Variable("c", start=0.3)],
    outputs=[Variable("y1", "position", "m"), Variable("y2", "push", "N")],
    ode=lambda x, u, p, t: [
        x.v + 0.1 * ca.cos(2 * t),
        (u.force + u.wind - p.k * x.s - p.c * x.v + t * ca.sin(3 * t)) / p.mass,
    ],
    output=lambda x, u, p, t: [x.s + 0.2 * ca.sin(1.3 * t), x.v * t + u.force],
)


def rate(t, x, force, wind, mass, k, c):
    return [x[1] + 0.1 * math.cos(2 * t), (force(t) + wind(t) - k * x[0] - c * x[1] + t * math.sin(3 * t)) / mass]


def solution(t0, t, x0, force=lambda t: 0.5, wind=lambda t: 0.0, mass=2.0, k=3.0, c=0.3):
    arguments = (force, wind, mass, k, c)
    return solve_ivp(rate, (t0, t), x0, args=arguments, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


@pytest.mark.parametrize(("t0", "h"), [(0.0, 0.1), (7.3, 0.1), (-2.0, 0.37)])
def test_equations_that_depend_on_time_see_the_time_that_it_is(t0: float, h: float) -> None:
    run = Instance(plant(FORCED), t0=t0)
    for k in range(12):
        run.step(t0 + k * h, h)
    end = t0 + 12 * h
    s, v = solution(t0, end, [0.4, -0.2])
    np.testing.assert_allclose([run.get("x.s"), run.get("x.v")], [s, v], rtol=0, atol=1e-11)
    np.testing.assert_allclose(
        [run.get("y1"), run.get("y2")], [s + 0.2 * math.sin(1.3 * end), v * end + 0.5], rtol=0, atol=1e-10
    )


def test_every_port_acts_where_it_belongs() -> None:
    values = {"start.s": -1.0, "start.v": 0.7, "parameter.mass": 1.5, "parameter.k": 2.0, "parameter.c": 0.9}
    run = Instance(plant(FORCED), values, inputs={"force": 2.0, "wind": -3.0})
    run.step(0.0, 0.8)
    expected = solution(0, 0.8, [-1, 0.7], lambda t: 2.0, lambda t: -3.0, mass=1.5, k=2.0, c=0.9)
    np.testing.assert_allclose([run.get("x.s"), run.get("x.v")], expected, rtol=0, atol=1e-11)
    assert (run.get("x.k"), run.get("x.c")) == (2.0, 0.9)
    assert run.get("y2") == pytest.approx(expected[1] * 0.8 + 2.0, abs=1e-11)


@pytest.mark.parametrize("substep", [0.05, 0.4])
def test_input_derivatives_move_the_inputs_within_the_step_and_no_further(substep: float) -> None:
    """Exact where the rate is linear in the inputs and in nothing else: their integral is that of the line."""
    coasting = Model(
        name="coasting",
        states=[Variable("s"), Variable("v")],
        inputs=[Variable("a"), Variable("b")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [u.b, u.a],
        output=lambda x, u, p, t: [x.s],
    )
    run = Instance(plant(coasting, max_step=substep), inputs={"a": 1.0, "b": 2.0}, t0=3.0)
    run.step(3.0, 0.4, np.array([0.5, -0.25]))
    assert run.get("x.v") == pytest.approx(1.0 * 0.4 + 0.5 * 0.4**2 / 2, abs=1e-15)
    assert run.get("x.s") == pytest.approx(2.0 * 0.4 - 0.25 * 0.4**2 / 2, abs=1e-15)
    run.step(3.4, 0.4)
    assert run.get("x.v") == pytest.approx(0.44 + 1.0 * 0.4, abs=1e-15)


def test_changing_inputs_move_a_plant_with_order_4_in_its_substeps() -> None:
    u, slope, start = 0.5, 3.0, [0.3, -0.2]
    pendulum = Model(
        name="driven_pendulum",
        states=[Variable("x1", start=start[0]), Variable("x2", start=start[1])],
        inputs=[Variable("u")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.x2, -4 * ca.sin(x.x1) - u.u * x.x1 + u.u],
        output=lambda x, u, p, t: [x.x1],
    )

    def rate(t: float, x: np.ndarray) -> list[float]:
        now = u + slope * t
        return [x[1], -4 * math.sin(x[0]) - now * x[0] + now]

    truth = solve_ivp(rate, (0, 0.8), start, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    errors = []
    for substep in (0.2, 0.1, 0.05):
        run = Instance(plant(pendulum, max_step=substep), inputs={"u": u})
        run.step(0.0, 0.8, np.array([slope]))
        errors.append(np.max(np.abs([run.get("x.x1"), run.get("x.x2")] - truth)))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(orders - 4) < 0.3), (errors, orders)


def test_parameters_have_the_bounds_units_and_start_values_of_the_model() -> None:
    ports = {port.name: port for port in plant(FORCED, jumps={"k": 1}).parameters}
    for name, low, high, start, unit in (
        ("start.s", -5, 5, 0.4, "m"),
        ("start.v", -math.inf, math.inf, -0.2, "m/s"),
        ("parameter.mass", 0.5, 4.0, 2.0, "kg"),
        ("parameter.k", 0.0, 10.0, 3.0, "N/m"),
        ("parameter.k_jump_value[1]", 0.0, 10.0, 3.0, "N/m"),
        ("parameter.k_jump_time[1]", 0.0, math.inf, 1e30, "s"),
        ("sensor.noise_bound.y1", 0.0, math.inf, 0.0, "m"),
        ("sensor.noise_std.y2", 0.0, math.inf, 0.0, "N"),
        ("sensor.sample_time", 0.0, math.inf, 0.0, "s"),
        ("sensor.seed", 0, 2**20, 0, "1"),
    ):
        port = ports[name]
        assert (port.min, port.max, port.start, port.unit) == (low, high, start, unit), name
    for kind in ("noise_bound", "noise_std"):  # of several outputs, which one
        texts = [ports[f"sensor.{kind}.{y}"].description for y in ("y1", "y2")]
        assert texts[0].removesuffix("y1") == texts[1].removesuffix("y2") != texts[0]
    assert ports["start.s"].nominal == 2.0 and ports["sensor.seed"].kind == "Integer"
    fixed = {name for name, port in ports.items() if port.variability == "fixed"}
    assert fixed == {"start.s", "start.v", "parameter.k_jump_time[1]", "sensor.seed", "sensor.sample_time"}
    with pytest.raises(ValueError, match=r"parameter.mass = 4.5 lies outside \[0.5, 4\]"):
        Instance(plant(FORCED), {"parameter.mass": 4.5})
    with pytest.raises(ValueError, match=r"start.s = -5.5 lies outside \[-5, 5\]"):
        Instance(plant(FORCED), {"start.s": -5.5})
    with pytest.raises(ValueError, match=r"sensor.seed = 1048577 lies outside \[0, 1048576\]"):
        Instance(plant(FORCED), {"sensor.seed": 2**20 + 1})


def test_inputs_and_outputs_have_no_bounds_and_stand_in_the_models_order() -> None:
    made = plant(FORCED)
    assert [port.name for port in made.inputs] == ["force", "wind"]
    assert [port.name for port in made.outputs] == ["y1", "y2", "x.s", "x.v", "x.k", "x.c"]
    assert all(port.min == -math.inf and port.max == math.inf for port in (*made.inputs, *made.outputs))
    assert made.inputs[0].start == 0.5


def test_an_unknown_parameter_jumps_after_its_time_and_twice() -> None:
    times = {"parameter.k_jump_time[1]": 0.25, "parameter.k_jump_time[2]": 0.61}
    values = {"parameter.k_jump_value[1]": 7.0, "parameter.k_jump_value[2]": 1.0}
    run = Instance(plant(FORCED, jumps={"k": 2}), times | values)
    seen = []
    for k in range(4):
        run.step(0.25 * k, 0.25)
        seen.append(run.get("x.k"))
    assert seen == [3.0, 7.0, 1.0, 1.0]  # at 0.25 itself still the old one
    x = solution(0, 0.25, [0.4, -0.2], k=3.0)
    x = solution(0.25, 0.61, x, k=7.0)
    x = solution(0.61, 1.0, x, k=1.0)
    np.testing.assert_allclose([run.get("x.s"), run.get("x.v")], x, rtol=0, atol=1e-11)


def test_jumps_of_two_parameters_are_their_own() -> None:
    times = {"parameter.k_jump_time[1]": 0.7, "parameter.c_jump_time[1]": 0.3}
    values = {"parameter.k_jump_value[1]": 7.0, "parameter.c_jump_value[1]": 2.0}
    run = Instance(plant(FORCED, jumps={"k": 1, "c": 1}), times | values)
    run.step(0.0, 1.0)
    x = solution(0, 0.3, [0.4, -0.2])
    x = solution(0.3, 0.7, x, c=2.0)
    x = solution(0.7, 1.0, x, k=7.0, c=2.0)
    np.testing.assert_allclose([run.get("x.s"), run.get("x.v")], x, rtol=0, atol=1e-11)


def lehmer(seed: int, prime: int):
    """The generator's integers, in Python's, from the first draw on."""
    state = 1 + (1 + (seed + 1) ** 2 * prime) % 2147483646
    for _ in range(3):
        state = 16807 * state % 2147483647
    while True:
        state = 16807 * state % 2147483647
        yield state


def of_both(bound: float, std: float) -> dict[str, float]:
    """The same noise on both outputs."""
    return {f"sensor.{kind}.{y}": v for kind, v in (("noise_bound", bound), ("noise_std", std)) for y in ("y1", "y2")}


def draws(seed: int, bound: float, std: float, samples: int, outputs: int = 2) -> np.ndarray:
    """The noise of the first samples (samples x outputs): each output in turn takes one uniform number and a pair for Box and Muller."""
    uniform, gaussian, rows = lehmer(seed, 7919), lehmer(seed, 7907), []
    for _ in range(samples * outputs):
        flat = bound * (2 * next(uniform) / 2147483647 - 1)
        radius, angle = next(gaussian) / 2147483647, next(gaussian) / 2147483647
        rows.append(flat + std * math.sqrt(-2 * math.log(radius)) * math.cos(2 * math.pi * angle))
    return np.reshape(rows, (samples, outputs))


@pytest.mark.parametrize(("bound", "std"), [(0.3, 0.0), (0.0, 0.2), (0.3, 0.2)])
@pytest.mark.parametrize("h", [0.1, 0.05])
def test_the_kth_sample_carries_the_kth_draw_of_both_kinds(bound: float, std: float, h: float) -> None:
    sensor = {"sensor.sample_time": 0.1, "sensor.seed": 5} | of_both(bound, std)
    noisy, clean = Instance(plant(FORCED), sensor), Instance(plant(FORCED))
    found = []
    for k in range(round(0.8 / h)):
        if k % round(0.1 / h) == 0:
            found.append([noisy.get(name) - clean.get(name) for name in ("y1", "y2")])
        for run in (noisy, clean):
            run.step(k * h, h)
    np.testing.assert_allclose(found, draws(5, bound, std, 8), rtol=0, atol=4e-15)
    assert noisy.get("x.s") == pytest.approx(clean.get("x.s"), abs=1e-15)  # the sensor's noise moves nothing


def test_the_two_kinds_of_noise_are_independent() -> None:
    def stream(bound: float, std: float) -> np.ndarray:
        sensor = {"sensor.sample_time": 0.1, "sensor.seed": 3} | of_both(bound, std)
        noisy, clean, rows = Instance(plant(FORCED), sensor), Instance(plant(FORCED), {"sensor.sample_time": 0.1}), []
        for k in range(400):
            for run in (noisy, clean):
                run.step(k * 0.1, 0.1)
            rows += [noisy.get(name) - clean.get(name) for name in ("y1", "y2")]
        return np.array(rows)

    uniform, gaussian = stream(1.0, 0.0), stream(0.0, 1.0)
    np.testing.assert_allclose(stream(1.0, 1.0), uniform + gaussian, rtol=0, atol=1e-12)
    assert abs(np.corrcoef(uniform, gaussian)[0, 1]) < 3 / math.sqrt(len(uniform))


def test_each_output_has_noise_of_its_own_and_the_draws_of_the_others_stay() -> None:
    def stream(sensor: dict[str, float]) -> np.ndarray:
        clock = {"sensor.sample_time": 0.1, "sensor.seed": 4}
        noisy, clean, rows = Instance(plant(FORCED), sensor | clock), Instance(plant(FORCED)), []
        for k in range(20):
            rows.append([noisy.get(name) - clean.get(name) for name in ("y1", "y2")])
            for run in (noisy, clean):
                run.step(k * 0.1, 0.1)
        return np.array(rows)

    own = stream({"sensor.noise_std.y2": 0.2, "sensor.noise_bound.y1": 0.3})
    np.testing.assert_allclose(own[:, 0], draws(4, 0.3, 0.0, 20)[:, 0], rtol=0, atol=1e-14)
    np.testing.assert_allclose(own[:, 1], draws(4, 0.0, 0.2, 20)[:, 1], rtol=0, atol=1e-14)


def input_draws(seed: int, std: float, samples: int) -> list[float]:
    """The noise on a single input: a stream of its own, a pair of numbers for each sample."""
    gaussian = lehmer(seed, 7901)
    pairs = [(next(gaussian) / 2147483647, next(gaussian) / 2147483647) for _ in range(samples)]
    return [std * math.sqrt(-2 * math.log(radius)) * math.cos(2 * math.pi * angle) for radius, angle in pairs]


def test_noise_of_an_input_drives_the_plant_and_is_held_from_sample_to_sample() -> None:
    clock = {"sensor.sample_time": 0.1, "sensor.seed": 4}
    noisy = Instance(plant(FORCED, input_noise=True), clock | {"actuator.noise_std": 0.7})
    told = Instance(plant(FORCED))  # is told the force that the other one makes up
    pushes = input_draws(4, 0.7, 13)
    told.set("force", 0.5 + pushes[0])
    for k in range(12):
        for name in ("x.s", "x.v", "y1", "y2"):
            assert noisy.get(name) == pytest.approx(told.get(name), abs=1e-12)
        told.set("force", 0.5 + pushes[k + 1])  # the jump at t_k draws what acts from then on
        noisy.step(k * 0.1, 0.1)
        told.step(k * 0.1, 0.1)
    assert abs(noisy.get("x.v") - Instance(plant(FORCED)).get("x.v")) > 0.01


def test_noise_of_inputs_leaves_that_of_the_sensor_as_it_is_and_is_off_unless_asked_for() -> None:
    sensor = {"sensor.sample_time": 0.1, "sensor.seed": 4, "sensor.noise_std.y1": 1.0}
    with_input, without = Instance(plant(FORCED, input_noise=True), sensor), Instance(plant(FORCED), sensor)
    for k in range(10):
        with_input.step(k * 0.1, 0.1)
        without.step(k * 0.1, 0.1)
        assert with_input.get("y1") == without.get("y1")
    assert not [port.name for port in plant(FORCED).parameters if port.name.startswith("actuator")]


def test_noise_of_inputs_where_there_are_none_is_refused() -> None:
    with pytest.raises(ValueError, match="plant 'alone': input_noise of a model without known inputs"):
        plant(
            Model(
                name="alone",
                states=[Variable("x", start=1.0)],
                outputs=[Variable("y")],
                ode=lambda x, u, p, t: [-x.x],
                output=lambda x, u, p, t: [x.x],
            ),
            input_noise=True,
        )


def test_without_a_sample_time_the_measurement_is_clean_whatever_the_noise() -> None:
    noisy = Instance(plant(FORCED), of_both(1.0, 1.0) | {"sensor.seed": 1})
    clean = Instance(plant(FORCED))
    for k in range(5):
        assert noisy.get("y1") == clean.get("y1") and noisy.get("y2") == clean.get("y2")
        noisy.step(0.1 * k, 0.1)
        clean.step(0.1 * k, 0.1)


def test_a_stiff_plant_is_given_a_shorter_step_and_a_lax_one_the_longest() -> None:
    def decay(speed: float) -> Model:
        return Model(
            name="decay",
            states=[Variable("x", start=1.0)],
            outputs=[Variable("y")],
            ode=lambda x, u, p, t: [-speed * x.x],
            output=lambda x, u, p, t: [x.x],
        )

    assert plant(decay(1.0), max_step=0.05).max_step == 0.05
    assert plant(decay(100.0), max_step=0.05).max_step == 0.0125  # 100 times a step below 3, its error 1e-6
    assert plant(decay(1.0), max_step=0.05, stop_time=7.0, step_size=0.3).stop_time == 7.0


def test_a_sine_and_a_ramp_follow_their_formulas() -> None:
    values = {"amplitude": 2.0, "frequency": 3.0, "phase": 0.4, "offset": -1.0}
    wave, slope = Instance(sine(), values), Instance(ramp(), {"height": 3.0, "start": 0.5, "duration": 2.0})
    for k in range(40):
        t = 0.1 * k
        assert wave.get("y") == pytest.approx(-1 + 2 * math.sin(3 * t + 0.4), abs=1e-14)
        assert slope.get("y") == pytest.approx(3 * min(max((t - 0.5) / 2, 0), 1), abs=1e-14)
        wave.step(t, 0.1)
        slope.step(t, 0.1)
    assert [port.start for port in sine().parameters] == [1.0, 1.0, 0.0, 0.0]
    assert [port.start for port in ramp().parameters] == [0.5, 1.0, 1.0]
