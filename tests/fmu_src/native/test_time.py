"""Time counts in steps: however an importer makes its times, the run is the same to the last bit."""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest

from components import COMPONENTS
from host import WAYS, drive
from observers.instance import Instance
from slave import Slave

Make = Callable[..., Slave]

HEADER = struct.Struct("<4Q 4q d 2q 7d")  # of a serialised state: whose it is, the lifecycle, stop time, clock
T0 = (0.0, 0.3, 86400.0, 4e6, 1.7e9)
SAMPLE_TIMES = (1e-3, 1 / 60, 0.1, 1 / 3, 16384 / 1e7)
NOISE = {"sensor.noise_bound": 0.02, "sensor.noise_std": 0.01, "sensor.seed": 7}
# What runs: component, input, the parameter with the sample time if there is one.
KINDS = {
    "observer": ("duffing_missing_ukf", "y", "sample_time"),
    "plant with noise": ("duffing", "u", "sensor.sample_time"),
    "plant with a jump": ("duffing", "u", "sensor.sample_time"),
    "clean plant": ("duffing", "u", None),
}


def started(slave: Make, kind: str, t0: float, h: float, jump: float = 12.345) -> Slave:
    """An instance at t0; a plant with a jump makes it `jump` steps later."""
    name, _, sample_time = KINDS[kind]
    values = {} if kind in ("observer", "clean plant") else dict(NOISE)
    if kind == "plant with a jump":
        values |= {"parameter.theta_jump_time[1]": t0 + jump * h, "parameter.theta_jump_value[1]": 1.5}
    if sample_time:
        values[sample_time] = h
    return slave(name).initialize(values, t0=t0)


def position(fmu: Slave) -> tuple[int, float, bytes]:
    """Units and phase of the clock, and all of the state but what the importer calls the time."""
    state = fmu.state()
    fields = HEADER.unpack_from(state)
    return fields[9], fields[14], state[HEADER.size :]


def comparable(kind: str, way: str, t0: float, h: float) -> bool:
    """A clean plant knows of h only what it is told: a hundredth of a millionth more is a longer step, and at 1.7e9 s a difference of
    times is exact to 2e-7 s."""
    if kind != "clean plant":
        return True
    return not way.startswith("9e-7") and not (t0 == 1.7e9 and "differences" in way)


def ends(
    slave: Make,
    kind: str,
    t0: float,
    h: float,
    steps: int,
    seen: Callable[[Slave], object] = position,
    jump: float = 12.345,
) -> dict[str, object]:
    """What is `seen` after so many steps, by each way of making their times."""
    found: dict[str, object] = {}
    for way in WAYS:
        if comparable(kind, way, t0, h):
            fmu = started(slave, kind, t0, h, jump)
            drive(fmu, KINDS[kind][1], t0, h, 0, steps, way, t0)
            found[way] = seen(fmu)
    assert len(found) >= 4
    return found


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("h", SAMPLE_TIMES)
@pytest.mark.parametrize("t0", T0)
def test_however_times_are_made_the_run_is_the_same(slave: Make, kind: str, h: float, t0: float) -> None:
    found = ends(slave, kind, t0, h, 3000)
    last = found["multiplied"]
    assert {way for way, end in found.items() if end != last} == set()
    if KINDS[kind][2]:
        assert isinstance(last, tuple) and last[:2] == (3000, 0)


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "h", "t0"),
    [("observer", 1 / 60, 0.0), ("plant with a jump", 1e-3, 1.7e9), ("clean plant", 1e-3, 86400.0)],
)
def test_however_times_are_made_a_million_steps_are_the_same(slave: Make, kind: str, h: float, t0: float) -> None:
    """The plant with a jump has noise too, and jumps twelve steps before the end."""
    found = ends(slave, kind, t0, h, 1_000_000, jump=999_987.345)
    assert {way for way, end in found.items() if end != found["multiplied"]} == set()


@pytest.mark.long
@pytest.mark.parametrize(
    ("way", "h", "steps"),
    [("added", 0.01, 20_000_000), ("9e-7 too fast", 1 / 60, 10_000_000), ("9e-7 too slow", 1 / 60, 10_000_000)],
)
def test_ten_million_steps_and_more_take_one_sample_each(slave: Make, way: str, h: float, steps: int) -> None:
    fmu = slave("sampled_toy").initialize({"sample_time": h, "tuning.mode": 2}, t0=86400.0)
    t = 86400.0
    t = drive(fmu, "y", 86400.0, h, 0, steps, way, t)
    for k in range(steps, steps + 100):
        t = drive(fmu, "y", 86400.0, h, k, k + 1, way, t)
        assert fmu.get("filtered.level") == pytest.approx(k * 37 % 101 / 101, abs=1e-15)  # the sample of this step
    assert position(fmu)[:2] == (steps + 100, 0)


@pytest.mark.parametrize("n", [2, 3, 7, 10])
@pytest.mark.parametrize("way", ["added", "multiplied", "nanoseconds", "differences", "9e-7 too slow"])
def test_steps_that_divide_the_sample_time_take_one_sample_in_n(slave: Make, n: int, way: str) -> None:
    for t0 in T0:
        h = 1 / 60 / n
        fmu = slave("sampled_toy").initialize({"sample_time": 1 / 60, "tuning.mode": 2}, t0=t0)
        t = t0
        for k in range(5 * n):
            t = drive(fmu, "y", t0, h, k, k + 1, way, t)
            first = k // n * n  # the step at whose beginning the sample was taken
            assert fmu.get("filtered.level") == pytest.approx(first * 37 % 101 / 101, abs=1e-15)
        assert position(fmu)[:2] == (5, 0)


def test_a_plant_and_an_observer_do_not_drift_against_each_other(slave: Make) -> None:
    """Whole nanoseconds: 1/60 s is 16666667 of them."""
    plant = slave("duffing").initialize()
    observer = slave("duffing_missing_ukf").initialize({"sample_time": 1 / 60})
    for fmu, name in ((plant, "u"), (observer, "y")):
        drive(fmu, name, 0.0, 0.016666667, 0, 6000, "multiplied", 0.0)
    assert position(plant)[0] == 100 and position(observer)[0] == 6000


@pytest.mark.parametrize("t0", T0)
def test_skipped_repeated_and_backward_steps_are_refused_by_how_far_they_are_off(slave: Make, t0: float) -> None:
    h = 1 / 60
    fmu, face = slave("sampled_toy").initialize({"sample_time": h}, t0=t0), None
    face = Instance(COMPONENTS["sampled_toy"](), {"sample_time": h}, t0=t0)
    t = drive(fmu, "y", t0, h, 0, 2000, "added", t0)
    label = t0
    for _ in range(2000):
        face.step(label, h)
        label += h
    for off in (-100, -1, -0.6, 0.6, 1, 3):
        message = fmu.refuses(lambda off=off: fmu.step(t + off * h, h))
        assert f"off by {off} steps" in message or f"off by {off:.1f}" in message, message
        with pytest.raises(ValueError) as refused:
            face.step(t + off * h, h)
        assert str(refused.value) == message.rstrip(".")
    fmu.step(t + 0.3 * h, h)


def test_times_that_run_away_from_the_steps_are_refused(slave: Make) -> None:
    fmu = slave("sampled_toy").initialize()
    fmu.step(0.0, 0.1)
    fmu.step(0.06, 0.1)  # 0.4 steps behind
    assert "off by -0.8 steps" in fmu.refuses(lambda: fmu.step(0.12, 0.1))


def test_a_step_past_the_stop_time_by_rounding_is_none(slave: Make) -> None:
    for way in ("added", "multiplied", "differences", "nanoseconds"):
        fmu = slave("duffing_missing_ukf").initialize({"sample_time": 1 / 60}, t0=0.1, stop=0.1 + 1200 / 60)
        drive(fmu, "y", 0.1, 1 / 60, 0, 1200, way, 0.1)
        assert "stop time" in fmu.refuses(lambda fmu=fmu: fmu.step(0.1 + 1200 / 60, 1 / 60))
