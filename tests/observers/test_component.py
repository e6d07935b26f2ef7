"""The Component type checks its functions against its ports, and its Python face keeps the time contract."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from observers.component import Component, Failure, Port
from observers.instance import Instance
from reference_models.duffing import DUFFING
from reference_models.plant import plant
from reference_models.sine import sine
from toys import growing_toy, sampled_toy


def counter(sample_time=0.1, **changes) -> Component:
    """Counts its sample instants (z0), holds the input seen at the last one (z1) and integrates the input (z2)."""
    z, u, p, t, h = ca.SX.sym("z", 3), ca.SX.sym("u"), ca.SX.sym("p"), ca.SX.sym("t"), ca.SX.sym("h")
    arguments = dict(
        name="counter",
        description="counts",
        start=ca.Function("start", [p, t], [ca.DM.zeros(3)]),
        flow=ca.Function("flow", [z, u, p, t, h], [ca.vertcat(z[0], z[1], z[2] + h * u)]),
        jump=ca.Function("jump", [z, u, p, t], [ca.vertcat(z[0] + 1, u, z[2])]),
        output=ca.Function("output", [z, u, p, t], [z]),
        inputs=(Port("u", "input"),),
        parameters=(Port("gain", "unused", variability="fixed", min=0.0, max=5.0),),
        outputs=tuple(Port(name, name) for name in ("count", "seen", "integral")),
        sample_time=sample_time,
        samples_inputs=True,
    )
    return Component(**{**arguments, **changes})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(outputs=()), r"output maps sizes \[3, 1, 1, 1\] to 3"),
        (dict(inputs=()), "flow maps sizes"),
        (dict(inputs=(Port("gain"),)), "two ports are called 'gain'"),
        (dict(sample_time="period"), "'period' is no fixed parameter"),
        (dict(breaks=("switch",)), "'switch' is no fixed parameter"),
        (dict(counters=("losses",)), "the counter 'losses' is no output"),
        (dict(sample_time=1e-12), "the sample time = 1e-12 must be 0 or finite and at least 1e-06 s"),
        (dict(sample_time=float("nan")), "the sample time = nan must be"),
        (dict(max_step=0.0), "max_step = 0 must be positive"),
        (dict(stop_time=float("inf")), "stop_time = inf must be positive and finite"),
        (dict(step_size=-0.1), "step_size = -0.1 must be positive"),
    ],
)
def test_a_contradictory_component_is_refused_with_the_reason(changes, message):
    with pytest.raises(ValueError, match=message):
        counter(**changes)


def test_failures_need_room_in_the_state():
    with pytest.raises(ValueError, match="failures take the last three of the state's entries, it has 0"):
        replace(sine(), failures=(Failure("it broke", "force"),))


def test_a_function_by_another_name_is_refused():
    made = counter()
    with pytest.raises(ValueError, match="must be called 'flow'"):
        replace(made, flow=made.jump)


def test_a_step_that_ends_on_a_sample_instant_leaves_that_sample_to_the_next_step():
    run = Instance(counter())
    run.step(0.0, 0.1)
    assert run.get("count") == 1  # t = 0 only
    run.set("u", 7.0)
    run.step(0.1, 0.05)
    assert run.get("count") == 2 and run.get("seen") == 7.0
    run.set("u", 9.0)
    run.step(0.15, 0.05)
    assert run.get("count") == 2 and run.get("seen") == 7.0


@pytest.mark.parametrize(("sample_time", "steps"), [(0.1, 4), (1 / 3, 1), (1e-3, 4), (0.7e-4, 1), (1e-4 / 3, 1)])
def test_accumulated_multiplied_and_rounded_times_give_identical_bits(sample_time, steps):
    """Steps of whole nanoseconds, or steps that hit the sample instants."""
    ends = []
    for scheme in ("multiplied", "accumulated", "rounded"):
        run = Instance(counter(sample_time))
        h, t = sample_time / steps, 0.0
        for k in range(1000 * steps):
            begin = {"multiplied": k * h, "accumulated": t, "rounded": round(k * h * 1e9) / 1e9}[scheme]
            run.set("u", np.sin(0.1 * k))
            run.step(begin, h)
            t += h
        ends.append((run.time, *run.outputs()))
    assert ends[0] == ends[1] == ends[2]
    assert ends[0][1] == 1000


def test_several_sample_instants_in_one_step_of_a_plant_are_all_drawn():
    made = plant(DUFFING)
    parameters = {"sensor.sample_time": 0.1, "sensor.noise_bound": 1.0}
    fine, coarse = Instance(made, parameters), Instance(made, parameters)
    for k in range(10):
        fine.step(k * 0.1, 0.1)
    coarse.step(0.0, 1.0)
    assert fine.ticks == coarse.ticks == 10
    assert fine.get("y") == pytest.approx(coarse.get("y"), abs=1e-12)


@pytest.mark.parametrize(
    ("t", "h", "message"),
    [
        (0.0, 0.11, "h = 0.11 exceeds the sample time 0.1"),
        (0.5, 0.1, "step from t = 0.5, but the current time is 0"),
        (0.0, 0.0, "h = 0 must be positive"),
        (0.0, -0.1, "h = -0.1 must be positive"),
        (float("nan"), 0.1, "but the current time is 0"),
        (0.0, float("inf"), "h = inf must be positive"),
    ],
)
def test_a_wrong_step_is_refused_and_changes_nothing(t, h, message):
    run = Instance(counter())
    before = run.outputs()
    with pytest.raises(ValueError, match=message):
        run.step(t, h)
    assert run.time == 0 and np.array_equal(run.outputs(), before)


def test_a_state_that_is_not_finite_is_refused_and_changes_nothing():
    run = Instance(counter())
    run.step(0.0, 0.1)
    before = run.outputs()
    run.set("u", np.inf)
    with pytest.raises(ValueError, match="not finite"):
        run.step(0.1, 0.1)
    assert np.array_equal(run.outputs(), before) and run.time == 0.1


def test_a_parameter_out_of_range_is_refused_with_its_limits():
    with pytest.raises(ValueError, match=r"gain = 6 lies outside \[0, 5\]"):
        Instance(counter(), {"gain": 6.0})
    with pytest.raises(ValueError, match="has no parameter 'gian'"):
        Instance(counter(), {"gian": 1.0})
    with pytest.raises(ValueError, match="gain is fixed"):
        Instance(counter()).set("gain", 1.0)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("tuning.mode", 3, r"tuning.mode = 3 lies outside \[1, 2\]"),
        ("tuning.mode", 1.5, "tuning.mode = 1.5 is not a whole number"),
        ("tuning.scale", float("nan"), r"tuning.scale = nan lies outside \[1, 5\]"),
        ("tuning.gian", 1.0, "has no input or parameter 'tuning.gian'; known: start.level"),
    ],
)
def test_integers_and_enumerations_are_checked_as_the_fmu_checks_them(name, value, message):
    run = Instance(sampled_toy())
    with pytest.raises(ValueError, match=message):
        run.set(name, value)
    run.step(0.0, 0.1)


def test_unknown_names_are_refused_with_the_known_ones():
    with pytest.raises(ValueError, match="counter has no input 'v'; known: u"):
        Instance(counter(), inputs={"v": 1.0})
    with pytest.raises(ValueError, match="counter has no output 'sum'; known: count, seen, integral"):
        Instance(counter()).get("sum")


def test_an_impossible_start_is_refused():
    with pytest.raises(ValueError, match="the start time nan is not finite"):
        Instance(counter(), t0=float("nan"))
    with pytest.raises(ValueError, match="growing_toy: the start values give no finite state at t = 0"):
        Instance(growing_toy(), {"start.z": 1e308})
    with pytest.raises(ValueError, match=r"growing_toy: start\.z = inf must be finite"):
        Instance(growing_toy(), {"start.z": float("inf")})
