"""The clock of a run on its own: whatever the steps are called, they are the fractions of a unit that were meant."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from observers.clock import Clock

OFF = 9e-7  # relative: what a master's step may be off by


def stepped(clock: Clock, h: float, count: int) -> Clock:
    for _ in range(count):
        clock = clock.after(clock.label, h)
    return clock


@pytest.mark.parametrize("sample_time", [0.1, 2.5, 1e-3])
@pytest.mark.parametrize("share", [Fraction(3, 2), Fraction(1, 4), Fraction(7, 3), Fraction(5), Fraction(99, 100)])
@pytest.mark.parametrize("off", [OFF, -OFF])
def test_a_step_that_is_a_millionth_off_a_fraction_of_the_sample_time_is_that_fraction(sample_time, share, off) -> None:
    """After as many steps as it has parts it is a sample instant, and so on for 50 times as long."""
    h, clock = sample_time * float(share) * (1 + off), Clock(2.0, sample_time, label=2.0)
    one = clock.after(2.0, h)
    assert one.time == pytest.approx(2.0 + sample_time * float(share), rel=0, abs=0.6e-9)  # whole nanoseconds
    for rounds in (1, 50):
        end = stepped(clock, h, share.denominator * rounds)
        assert (end.whole, end.phase, end.carry, end.ticks) == (
            share.numerator * rounds,
            0,
            0,
            share.numerator * rounds,
        )


@pytest.mark.parametrize("off", [2e-6, -2e-6])
def test_one_that_is_further_off_is_what_it_is(off: float) -> None:
    h = 0.1 * 1.5 * (1 + off)
    end = stepped(Clock(0.0, 0.1, label=0.0), h, 2)
    assert end.whole + end.phase == pytest.approx(3 * (1 + off), rel=1e-14)
    assert (end.ticks, end.whole) == ((4, 3) if off > 0 else (3, 2))


@pytest.mark.parametrize(("off", "meant"), [(0.5e-9, True), (-0.5e-9, True), (3e-9, False)])
def test_without_a_sample_time_a_step_is_a_fraction_of_a_second_within_a_nanosecond(off: float, meant: bool) -> None:
    """A millionth of a second would be too much: nothing says that such a fraction was meant."""
    one = Clock(0.0, 0.0, label=0.0).after(0.0, 4 / 3 + off)
    assert (one.whole == 1 and one.phase == 4 / 3 - 1) == meant
    assert one.elapsed == pytest.approx(4 / 3 + off, abs=1e-9)
    assert one.ticks == 0


def test_no_number_of_odd_steps_is_lost() -> None:
    """Steps that are no simple fraction add up."""
    h = 0.0314159265
    end = stepped(Clock(0.0, 0.1, label=0.0), h, 1000)
    assert end.elapsed == pytest.approx(1000 * h, abs=1e-9)
    assert end.ticks == math.ceil(1000 * h / 0.1)


@pytest.mark.parametrize(
    "changes",
    [
        {"steps": -1}, {"whole": -1}, {"phase": 1.0}, {"phase": -0.1}, {"carry": 0.02}, {"carry": -0.02}, {"t0": math.inf},
        {"label": math.nan}, {"step": math.inf}, {"step": -0.1}, {"step": 0.0}, {"steps": 0}, {"steps": 2.0**53},
        {"whole": 2.0**53}, {"t0": 1.7e308, "sample_time": 1e300, "whole": 2**40},
    ],
)  # fmt: skip
def test_a_clock_that_cannot_be_is_told_from_one_that_can(changes: dict) -> None:
    sound = Clock(1.0, 0.1, 1.25, whole=2, phase=0.5, carry=0.005, steps=3, step=0.1)
    assert sound.is_sound() and Clock(0.0, 0.0, 0.0).is_sound()
    for last in (0.01, -0.01, 0.0):
        assert replace(sound, carry=last).is_sound()
    with np.errstate(over="ignore"):
        assert not replace(sound, **changes).is_sound()
