"""Model exchange as the probes drive it: Euler steps of a ball that falls from h = 1, its bounce, a switch thrown at t = 0.35."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from broken_fmus import told
from fmu_src.compliance.library import derivatives, lifecycle
from fmu_src.compliance.library.calls import Broken
from fmu_src.compliance.library.exchange import ExchangeInstance
from fmu_src.compliance.library.fmu import Fmu

G = 9.81
Load = Callable[..., Fmu]


def initialized(fmu: Fmu) -> ExchangeInstance:
    instance = fmu.initialized()
    assert isinstance(instance, ExchangeInstance)
    return instance


def test_a_life_is_eight_euler_steps(load_exchange: Load) -> None:
    probe = lifecycle.life(load_exchange())
    with pytest.raises(StopIteration) as end:
        next(probe)
    rows, k = end.value.value, np.arange(9)
    np.testing.assert_allclose([row["v"] for row in rows], -G * 0.01 * k, rtol=0, atol=1e-14)
    np.testing.assert_allclose([row["h"] for row in rows], 1 - G * 1e-4 * k * (k - 1) / 2, rtol=0, atol=1e-14)
    assert [row["der(v)"] for row in rows] == [-G] * 9 and {row["thrown"] for row in rows} == {0}


def test_a_state_changes_by_a_tenth_of_its_size_or_nominal_value_at_most(load_exchange: Load) -> None:
    instance = initialized(load_exchange(step=10.0))
    times, speeds = [0.0], [0.0]
    for _ in range(18):
        instance.step()
        times.append(instance.time)
        speeds.append(float(instance.vector("ContinuousStates")[1]))
        if speeds[-1] > 0:  # it has bounced
            break
    moved, size = np.abs(np.diff(speeds)), np.maximum(np.abs(speeds[:-1]), 1.0)
    falls = slice(0, int(np.argmax(np.array(times) >= 0.35)) - 1)
    np.testing.assert_allclose(moved[falls], 0.1 * size[falls], rtol=0, atol=1e-13)
    assert times[1] == pytest.approx(0.1 / G, rel=0, abs=1e-15)


def test_the_event_at_a_time_is_met_at_that_time_and_once(load_exchange: Load) -> None:
    fmu = load_exchange(step=0.02)
    instance, thrown, entered = initialized(fmu), [], []
    function = fmu.function
    fmu.function = lambda name, *more: (
        (entered.append(instance.time) if name == "fmi2EnterEventMode" else None) or function(name, *more)
    )  # type: ignore[method-assign,func-returns-value]
    for _ in range(40):
        (row,) = instance.run(1)
        thrown.append((instance.time, row["thrown"]))
    first = next(time for time, value in thrown if value == 1)
    assert first == 0.35 and max(time for time, value in thrown if value == 0) < 0.35
    height = [time for time in entered if time != 0.35]
    assert entered.count(0.35) == 1  # the next is the bounce
    assert 0.42 < height[0] < 0.5  # in truth at sqrt(2 / 9.81) = 0.4515, here by Euler


def test_the_ball_goes_up_after_its_bounce(load_exchange: Load) -> None:
    instance = initialized(load_exchange())
    speeds = [0.0]
    for _ in range(60):
        instance.step()
        speeds.append(float(instance.vector("ContinuousStates")[1]))
    up = next(k for k, speed in enumerate(speeds) if speed > 0)
    before, after = speeds[up - 1], speeds[up]
    assert after == pytest.approx(0.7 * (G * 0.01 - before), rel=0, abs=1e-12)


def test_a_run_ends_where_the_fmu_asks_for_it(load_exchange: Load) -> None:
    instance = initialized(load_exchange())
    instance.run(2)
    instance.progress.ended = True
    assert instance.run(5) == [] and instance.progress.steps == 2


def test_an_event_iteration_without_an_end_is_found_after_a_hundred_calls(load_exchange: Load) -> None:
    fmu = load_exchange("event-mode")
    instance, calls = initialized(fmu), []
    function = fmu.function
    fmu.function = lambda name, *more: calls.append(name) or function(name, *more)  # type: ignore[method-assign,func-returns-value]
    instance.run(1)
    with pytest.raises(Broken) as broken:
        instance.handle_event()
    assert str(broken.value) == (
        "event-mode [3.2.2] fmi2NewDiscreteStates: expected an end of the event iteration within 100 calls; "
        "found newDiscreteStatesNeeded = fmi2True"
    )
    assert calls.count("fmi2NewDiscreteStates") == 100


DEFECTS = {
    "continuous-states": (
        derivatives.continuous_states,
        [("continuous-states", "v by fmi2GetContinuousStates"), ("continuous-states", "v by fmi2GetReal")],
    ),
    "continuous-states-nominal": (derivatives.continuous_states, [("continuous-states", "h")]),
    "state-derivatives": (derivatives.along_a_run, [("state-derivatives", "der(v)")]),
    "directional-derivative": (
        derivatives.directional,
        [("directional-derivative", f"{by}") for by in ("h by h", "der(h) by v", "v by v", "der(v) by lift")],
    ),
}


@pytest.mark.parametrize("defect", DEFECTS)
def test_a_defect_is_found_by_name_and_a_sound_fmu_has_none(load_exchange: Load, defect: str) -> None:
    probe, expected = DEFECTS[defect]
    assert [(one.rule, one.subject) for one in probe(load_exchange(defect))] == expected
    assert list(probe(load_exchange())) == []


def test_a_directional_derivative_is_compared_with_the_slope(load_exchange: Load) -> None:
    found = [(one.expected, one.found) for one in derivatives.directional(load_exchange("directional-derivative"))]
    assert found == [("1, as finite differences", "-1")] * 4


class Column:
    """In place of an instance: what it says of its directional derivatives, whatever it is asked."""

    reason = ": no"

    def __init__(self, *values: float, status: int = 0):
        self.values, self.status, self.asked = values, status, 0

    def call(self, name: str, unknowns: Any, n: int, known: Any, m: int, seed: Any, made: Any) -> int:
        assert (name, n, m, list(seed)) == ("fmi2GetDirectionalDerivative", len(self.values), 1, [1.0])
        self.asked += 1
        made[:] = self.values
        return self.status


def column(
    load_exchange: Load, said: float, respond: Callable[[float], float], at: float = 2.0, status: int = 0, **edits: str
):
    """Findings on the slope that is `said` of the input `lift` at the value `at`."""
    limits = "".join(f' {name}="{value}"' for name, value in edits.items())
    plain = 'causality="input" variability="continuous"><Real start="0"/>'
    fmu = load_exchange(edits={plain: plain.replace("/>", f"{limits}/>")})
    instance, lift = Column(said, status=status), fmu.subject.variables[5]
    compare: Any = derivatives._compare
    return told(
        compare(instance, [fmu.subject.variables[0]], lift, at, lambda value: np.array([respond(value)]))
    ), instance.asked


def test_slopes_agree_to_a_thousandth_where_differences_say_anything(load_exchange: Load) -> None:
    def cube(value: float) -> float:
        return value**3

    assert column(load_exchange, 12.0, cube) == ([], 1)
    assert column(load_exchange, 12.011, cube) == ([], 1)
    assert column(load_exchange, 12.013, cube) == ([("directional-derivative", "h by lift", "12.013")], 1)
    assert column(load_exchange, 11.987, cube) == ([("directional-derivative", "h by lift", "11.987")], 1)
    assert column(load_exchange, float("nan"), cube)[0] == [("directional-derivative", "h by lift", "nan")]
    assert column(load_exchange, 0.0, lambda value: abs(value - 2.00001)) == ([], 1)  # at a kink there is no slope
    assert column(load_exchange, 1.0, lambda value: 1e9 + value * 0) == ([], 1)  # lost in rounding


def test_a_slope_is_asked_for_within_the_limits_only(load_exchange: Load) -> None:
    def wrong(value: float) -> float:
        return -value

    found = [("directional-derivative", "h by lift", "1")]
    assert column(load_exchange, 1.0, wrong, max="2.1") == (found, 1) and column(
        load_exchange, 1.0, wrong, min="1.9"
    ) == (found, 1)
    assert column(load_exchange, 1.0, wrong, max="2.0") == ([], 0) and column(load_exchange, 1.0, wrong, min="2.0") == (
        [],
        0,
    )


def test_a_slope_that_is_refused_is_told(load_exchange: Load) -> None:
    found, _ = column(load_exchange, 1.0, lambda value: value, status=3)
    assert found == [("directional-derivative", "fmi2GetDirectionalDerivative by lift", "fmi2Error: no")]
    assert column(load_exchange, 1.0, lambda value: value, status=1) == ([], 1)
