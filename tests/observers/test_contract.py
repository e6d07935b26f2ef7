"""The Python face of a component against closed forms: what its functions see of time, inputs and parameters, and when."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

import casadi as ca
import numpy as np
import pytest

from observers.clock import Clock
from observers.component import Component, Enumeration, Port, bounds
from observers.instance import Instance
from toys import double_toy, feedthrough_toy, sampled_toy


def seen(sample_time: float = 0.1, **changes: object) -> Component:
    """Writes down what each function is called with: the number of calls, and t, u and h of the last one, of jump and of flow."""
    z, u, p, t, h = ca.SX.sym("z", 8), ca.SX.sym("u"), ca.SX(0, 1), ca.SX.sym("t"), ca.SX.sym("h")
    flows, flow_t, flow_u, flow_h, jumps, jump_t, jump_u, area = ca.vertsplit(z)
    arguments: dict[str, object] = dict(
        name="seen",
        description="what it saw",
        start=ca.Function("start", [p, t], [ca.vertcat(0, t, 0, 0, 0, 0, 0, 0)]),
        flow=ca.Function(
            "flow", [z, u, p, t, h], [ca.vertcat(flows + 1, t, u, h, jumps, jump_t, jump_u, area + h * u)]
        ),
        jump=ca.Function("jump", [z, u, p, t], [ca.vertcat(flows, flow_t, flow_u, flow_h, jumps + 1, t, u, area)]),
        output=ca.Function("output", [z, u, p, t], [ca.vertcat(z, t)]),
        inputs=(Port("u"),),
        outputs=tuple(
            Port(n) for n in ("flows", "flow_t", "flow_u", "flow_h", "jumps", "jump_t", "jump_u", "area", "now")
        ),
        sample_time=sample_time,
        max_step=0.04,
    )
    return Component(**(arguments | changes))  # type: ignore[arg-type]


def values(run: Instance) -> dict[str, float]:
    return {port.name: value for port, value in zip(run.component.outputs, run.outputs(), strict=True)}


def test_flow_is_cut_into_equal_parts_no_longer_than_max_step_and_changing_inputs_are_held_over_their_halves() -> None:
    run = Instance(seen(sample_time=0.0, jump=None), t0=5.0, inputs={"u": 1.0})
    run.step(5.0, 0.1, 10.0)
    after = values(run)
    assert after["flows"] == 6 and after["flow_h"] == pytest.approx(0.1 / 6, rel=1e-15)
    assert after["flow_t"] == pytest.approx(5 + 0.1 * 5 / 6, abs=1e-15)
    assert after["flow_u"] == pytest.approx(1 + 10 * (0.2 / 3 + 0.1 / 3 * 5 / 6), abs=1e-14)
    assert after["area"] == pytest.approx(0.1 + 10 * 0.1**2 / 2, abs=1e-15)
    assert after["now"] == run.time == 5.1
    run.step(5.1, 0.08)
    after = values(run)
    assert after["flows"] == 8  # a max_step more by rounding is none
    assert after["flow_h"] == pytest.approx(0.04, rel=1e-14)
    assert after["flow_u"] == 1.0  # the derivative was for one step


def test_sample_instants_within_a_step_see_its_inputs_at_their_own_time() -> None:
    run = Instance(seen(), t0=-2.0, inputs={"u": 3.0})
    run.step(-2.0, 0.35, -4.0)  # instants at 0, 0.1, 0.2, 0.3
    after = values(run)
    assert after["jumps"] == run.ticks == 4 and after["jump_t"] == pytest.approx(-1.7, abs=1e-15)
    assert after["jump_u"] == pytest.approx(3 - 4 * 0.3, abs=1e-14)
    assert after["flows"] == 2 * (3 * 3 + 2)
    assert after["area"] == pytest.approx(3 * 0.35 - 4 * 0.35**2 / 2, abs=1e-14)
    run.step(-1.65, 0.05)  # ends on an instant, which the next step takes
    assert values(run)["jumps"] == 4
    run.step(-1.6, 0.01)
    after = values(run)
    assert after["jumps"] == 5 and after["jump_t"] == pytest.approx(-1.6, abs=1e-15) and after["jump_u"] == 3.0


def test_a_component_with_sample_instants_but_nothing_to_do_at_them_flows_up_to_each() -> None:
    run = Instance(seen(jump=None, max_step=math.inf))
    run.step(0.0, 0.3)
    assert values(run)["flows"] == 3 and values(run)["jumps"] == 0 and run.ticks == 3


def test_breaks_cut_flow_in_their_order_whatever_that_of_the_parameters() -> None:
    run = Instance(double_toy(), inputs={"a": 2.0, "b": 3.0})
    moved = []
    for k in range(5):
        run.step(0.1 * k, 0.1)
        moved.append(run.get("s"))
    early, late = 0.13, 0.27

    def exact(t: float) -> float:
        return 0.25 + 2 * (t + max(t - early, 0) + 2 * max(t - late, 0))

    np.testing.assert_allclose(moved, [exact(0.1 * (k + 1)) for k in range(5)], rtol=0, atol=4e-15)
    assert run.get("w") == pytest.approx(3 * 0.5**2 / 2, abs=1e-15)


def test_breaks_are_times_of_the_run_not_since_its_start() -> None:
    run = Instance(double_toy(), {"early_kick": 7.03, "late_kick": 7.06}, t0=7.0, inputs={"a": 1.0})
    run.step(7.0, 0.1)
    assert run.get("s") == pytest.approx(0.25 + 0.03 + 2 * 0.03 + 4 * 0.04, abs=1e-14)


def test_outputs_follow_inputs_parameters_and_time_at_once() -> None:
    run = Instance(double_toy(), t0=2.0)
    assert run.get("force") == 2.0 * 0.5 + 0.5 + 2.0 and run.get("inverse") == -1.0
    run.set("a", 3.0)
    run.set("gain", -1.0)
    run.set("bias", 0.25)
    assert run.get("force") == -3.0 + 0.25 + 2.0
    run.step(2.0, 0.1)
    assert run.get("force") == pytest.approx(-3.0 + 0.25 + 2.1, abs=1e-15)


def test_a_tunable_parameter_acts_from_the_next_sample_on() -> None:
    run = Instance(double_toy(), {"weight": 3})
    run.step(0.0, 0.1)
    assert run.get("total") == 3 and run.get("sampled_flag") == 1
    run.set("weight", -2)
    run.set("flag", 0)
    run.step(0.1, 0.05)
    assert run.get("total") == 1 and run.get("sampled_flag") == 0
    run.set("enabled", 0)
    run.step(0.15, 0.05)
    run.step(0.2, 0.1)
    assert run.get("total") == 1


def test_a_motion_that_cannot_go_on_is_named_with_its_time_and_measure_and_nothing_has_changed() -> None:
    for inputs, words in (
        ({"a": 200.0}, "double_toy: s ran away at t = 0.04, where s is 8.25"),
        ({"b": 2000.0}, "double_toy: w ran away at t = 0.1, where w is 10"),
    ):
        run = Instance(double_toy(), inputs=inputs)
        before = run.outputs().tolist()
        with pytest.raises(ValueError) as refused:
            run.step(0.0, 0.1)
        assert str(refused.value) == words
        assert run.outputs().tolist() == before and run.time == 0 and run.ticks == 0
        run.set("a", 0.1)
        run.set("b", 0.1)
        run.step(0.0, 0.1)
    with pytest.raises(ValueError, match=r"double_toy: s ran away at t = 3, where s is 9\.5, for the start values"):
        Instance(double_toy(), {"start.s": 9.5}, t0=3.0)


@pytest.mark.parametrize("name", ["a", "b"])
def test_an_input_that_is_not_finite_is_named(name: str) -> None:
    run = Instance(double_toy())
    run.set(name, math.nan)
    with pytest.raises(ValueError) as refused:
        run.step(0.0, 0.1)
    assert str(refused.value).endswith(f"after the step from t = 0 to 0.1, where the input {name} is nan")
    run.set(name, 1.0)
    run.step(0.0, 0.1)


def test_an_output_that_is_not_finite_is_named_with_its_time() -> None:
    run = Instance(double_toy(), t0=1.0)
    run.set("b", 0.0)
    with pytest.raises(ValueError, match="double_toy: the output inverse is inf at t = 1"):
        run.outputs()
    with pytest.raises(ValueError, match=r"double_toy: the output inverse is inf at t = 1\.1"):
        run.step(1.0, 0.1)
    run.set("a", math.inf)  # whose fault it is
    assert math.isinf(run.get("inverse")) and math.isinf(run.get("force"))


def test_a_state_that_is_not_finite_names_max_step_where_there_is_one() -> None:
    z, u, p, t, h = ca.SX.sym("z"), ca.SX(0, 1), ca.SX(0, 1), ca.SX.sym("t"), ca.SX.sym("h")
    made = Component(
        name="blown",
        description="",
        start=ca.Function("start", [p, t], [ca.SX(1)]),
        flow=ca.Function("flow", [z, u, p, t, h], [z * 1e200]),
        output=ca.Function("output", [z, u, p, t], [z]),
        outputs=(Port("z"),),
    )
    for changes, words in (
        ({"max_step": 0.05}, "to 0.1; a model that is stiff there wants a smaller max_step than 0.05"),
        ({}, "to 0.2"),
    ):
        run = Instance(replace(made, **changes))
        with pytest.raises(ValueError) as refused:
            for k in range(2):
                run.step(0.1 * k, 0.1)
        assert str(refused.value).endswith(words)


def test_values_given_at_the_start_are_checked_and_taken() -> None:
    run = Instance(double_toy(), {"gain": 4.0, "weight": 9, "start.s": -10}, inputs={"b": 0.5})
    assert run.get("force") == 4.0 * 0.5 + 0.5 and run.get("s") == -10 and run.get("inverse") == 2.0
    for name, value, words in (
        ("gain", 4.01, r"gain = 4.01 lies outside \[-3, 4\]"),
        ("bias", -1.5, r"bias = -1.5 lies outside \[-1, 1\]"),
        ("weight", 2.5, "weight = 2.5 is not a whole number"),
        ("enabled", 0.5, "enabled = 0.5 is not a whole number"),
        ("gain", -math.inf, "gain = -inf must be finite"),
        ("gain", math.nan, r"gain = nan lies outside \[-3, 4\]"),
    ):
        with pytest.raises(ValueError, match=words):
            Instance(double_toy(), {name: value})
        with pytest.raises(ValueError, match=words):
            run.set(name, value)
    assert run.get("force") == 2.5


def test_bounds_of_an_enumeration_are_those_of_its_items() -> None:
    items = Enumeration("E", (("one", ""), ("two", ""), ("three", "")))
    assert bounds(Port("e", start=1, kind="Enumeration", enumeration=items)) == (1, 3)
    assert bounds(Port("e", start=2, min=2, max=2, kind="Enumeration", enumeration=items)) == (2, 2)
    assert bounds(Port("r", min=-2, max=7)) == (-2, 7)


def test_a_sample_time_that_is_a_parameter_is_the_one_that_was_given() -> None:
    run = Instance(double_toy(), {"sample_time": 0.25})
    assert run.sample_time == 0.25
    run.step(0.0, 0.25)
    with pytest.raises(ValueError, match=r"step size h = 0\.3 exceeds the sample time 0\.25"):
        run.step(0.25, 0.3)


@pytest.mark.parametrize(("excess", "taken"), [(0.9e-6, True), (-0.9e-6, True), (1.2e-6, False)])
def test_a_step_longer_than_the_sample_time_by_a_millionth_is_one_sample(excess: float, taken: bool) -> None:
    run = Instance(sampled_toy())
    h = 0.1 * (1 + excess)
    if not taken:
        with pytest.raises(ValueError, match="exceeds the sample time"):
            run.step(0.0, h)
        return
    for k in range(50):
        run.step(k * h, h)
        assert run.ticks == k + 1 and run.time == 0.1 * (k + 1)


def test_the_stop_time_is_reached_but_not_passed() -> None:
    for stop, h, good in ((0.3, 0.1, True), (0.3, 0.3, True), (0.3 - 0.9e-7, 0.1, True), (0.3 - 2e-7, 0.1, False)):
        run = Instance(feedthrough_toy() if h > 0.1 else sampled_toy(), stop=stop)
        steps = round(0.3 / h)
        for k in range(steps - 1):
            run.step(k * h, h)
        if good:
            run.step((steps - 1) * h, h)
            continue
        with pytest.raises(ValueError, match=r"the step from t = 0\.2 to 0\.3 goes beyond the stop time 0\.2999998"):
            run.step((steps - 1) * h, h)


def test_a_step_takes_at_most_a_million_substeps_and_sample_instants_together() -> None:
    made = seen(sample_time=1.0, max_step=1.0)
    for h, refused in ((400.0, False), (500_001.0, True)):
        run = Instance(made)
        if not refused:
            run.step(0.0, h)
            assert run.ticks == 400
            continue
        with pytest.raises(
            ValueError, match=r"takes 1e\+06 substeps \(max_step = 1, sample time 1\), and no more than 1000000"
        ):
            run.step(0.0, h)


@pytest.mark.parametrize(
    ("t", "h", "off"),
    [(0.34, 0.1, 0.0), (0.26, 0.1, 0.0), (0.36, 0.1, 0.6), (0.24, 0.1, -0.6), (0.32, 0.01, 2.0), (0.303, 0.01, 0.0)],
)
def test_the_label_of_a_step_may_be_half_a_step_off(t: float, h: float, off: float) -> None:
    run = Instance(seen(sample_time=0.0, jump=None))
    for k in range(3):
        run.step(0.1 * k, 0.1)
    if off == 0:
        run.step(t, h)
        assert run.time == pytest.approx(0.3 + h, abs=1e-9)
        return
    with pytest.raises(ValueError) as refused:
        run.step(t, h)
    words = f"seen: step from t = {t:g}, but the current time is 0.3 (0.3 by the count of steps): off by {off:.3g} steps of {h:g}"
    assert str(refused.value) == words and run.time == pytest.approx(0.3, abs=1e-15)


@pytest.mark.parametrize(("numerator", "denominator"), [(1, 3), (2, 7), (5, 4), (1, 99), (99, 100), (7, 1), (1, 500)])
@pytest.mark.parametrize("sample_time", [0.1, 1 / 3, 2.5, 0.0])
def test_simple_fractions_of_a_unit_add_up_exactly(numerator: int, denominator: int, sample_time: float) -> None:
    unit = sample_time or 1.0
    h, clock = unit * numerator / denominator, Clock(3.0, sample_time, label=3.0)
    exact = Fraction(0)
    for k in range(3 * denominator):
        clock = clock.after(3.0 + k * h, h)
        exact += Fraction(numerator, denominator)
        assert clock.whole == math.floor(exact)
        assert clock.phase == pytest.approx(float(exact - math.floor(exact)), abs=1e-13)
        assert clock.ticks == (math.ceil(exact) if sample_time else 0)
        assert clock.elapsed == pytest.approx(float(exact) * unit, abs=1e-9)
    assert clock.phase == 0 and clock.whole == 3 * numerator and clock.steps == 3 * denominator
    assert clock.time == 3.0 + 3 * numerator * unit


def test_the_end_of_a_step_near_a_sample_instant_is_that_instant_and_no_other_is() -> None:
    for gap, on in ((0.9e-6, True), (1.1e-6, False)):  # of a sample time below 1 s
        part = 0.1 / math.e  # near no simple fraction
        clock = Clock(0.0, 0.1, label=0.0).after(0.0, part).after(part, 0.1 - part - gap * 0.1)
        assert (clock.phase == 0) is on
        assert clock.elapsed == pytest.approx(0.1 - (0 if on else gap * 0.1), abs=1e-13)
    for gap, on in ((0.9e-6, True), (1.1e-6, False)):  # [s], of one above
        part = 10 / math.e
        clock = Clock(0.0, 10.0, label=0.0).after(0.0, part).after(part, 10 - part - gap)
        assert (clock.phase == 0) is on


def test_a_step_that_is_a_difference_of_large_times_counts_as_what_it_was_rounded_from() -> None:
    odd = 0.367879441  # [s], near no simple fraction
    assert (
        Clock(1e6, 0.0, label=1e6).after(1e6, odd + 3e-10).phase == odd
    )  # whole nanoseconds, within the rounding of 1e6 s
    assert Clock(0.0, 0.0, label=0.0).after(0.0, odd + 3e-10).phase == odd + 3e-10
    late = 1.7e9  # [s], exact to 2.4e-7
    for part, h in (
        (1, 1e-3 + 1.5e-7),
        (1, 1e-3 - 1.5e-7),
        (2, 2e-3 + 1.5e-7),
        (0.5, 5e-4 + 1.5e-7),
        (0.25, 2.5e-4 - 1.5e-7),
    ):
        clock = Clock(late, 1e-3, label=late).after(late, h)
        assert clock.whole + clock.phase == part, h
    assert Clock(0.0, 1e-3, label=0.0).after(0.0, 2e-3 + 1.5e-7).phase > 0


def test_two_faults_of_a_component_are_told_by_the_port_that_has_them() -> None:
    made = double_toy()
    for changes, words in (
        (dict(breaks=("late_kick", "gain")), "'gain' is no fixed parameter"),
        (dict(counters=("high_a", "gain")), "the counter 'gain' is no output"),
        (dict(sample_time="bias"), "'bias' is no fixed parameter"),
        (dict(sample_time=-0.1), "the sample time = -0.1 must be 0 or finite"),
        (dict(sample_time=math.inf), "the sample time = inf must be 0 or finite"),
        (dict(max_step=math.nan), "max_step = nan must be positive"),
        (dict(max_step=-1.0), "max_step = -1 must be positive"),
        (dict(stop_time=0.0), "stop_time = 0 must be positive and finite"),
        (dict(step_size=math.inf), "step_size = inf must be positive and finite"),
        (dict(constants=(Port("a"),)), "two ports are called 'a'"),
        (dict(constants=(Port("s.t"),)), "the port 's' has the name of the branch that 's.t' stands on"),
        (dict(constants=(Port("s.t.r"),)), "the port 's' has the name of the branch that 's.t.r' stands on"),
    ):
        with pytest.raises(ValueError, match=words):
            replace(made, **changes)
    assert replace(made, max_step=1e-9, sample_time=1e-6).max_step == 1e-9
    assert replace(made, sample_time=0.0).sample_time == 0.0


def test_a_sparse_result_is_refused_by_the_function_that_has_it() -> None:
    made = feedthrough_toy()
    z, u, p, t = ca.SX(0, 1), ca.SX.sym("u", 1), ca.SX.sym("p", 2), ca.SX.sym("t")
    hole = ca.SX(2, 1)
    hole[1] = u * t
    with pytest.raises(ValueError, match="the result of output is sparse"):
        replace(made, output=ca.Function("output", [z, u, p, t], [hole]))


def test_a_component_prints_what_it_has() -> None:
    text = str(double_toy())
    assert text.splitlines()[0] == "Component double_toy: Two of everything (9 states, sample time sample_time)"
    assert "    3 inputs      a, flag, b" in text and "8 parameters" in text
    assert str(feedthrough_toy()).splitlines()[0] == "Component feedthrough_toy: Static gain (0 states)"
