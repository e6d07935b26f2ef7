"""What time it is in a run: counted in sample times, whatever the master calls it.

A step moves the clock by h in units of the sample time Ts. h counts as the simplest fraction m/n of Ts (m n <= 10^4) within 1e-6 of
it, relative, else as it is; and the end of a step within 1e-6 Ts (1 us, if that is less) of a sample instant is that instant. So a
master that steps by h = Ts (1 +- 1e-6) takes one sample a step for as long as the run goes, and masters that add up, multiply or round
their times get the same bits: the times that the component sees come from the count.

Differences of large times are rounded to more than 1e-6 Ts (Ts = 1 ms at 1.7e9 s: 8e-4). Within their rounding h counts as m Ts or Ts/n,
and an end of other steps nearby is the instant as well, but its distance is carried into the next step: such steps follow the
master's times.

Without a sample time the unit is one second, and the simplest fraction must lie within a nanosecond.

The master's t is a label. It must lie within half a step of where the last step ended, and in the long run it may leave the clock only
as fast as 1e-6 of the time and the roundings of sums allow; so a step that is skipped or taken twice is refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

NANOSECONDS = 1e9  # times between sample instants are counted in these
SNAP = 1e-6  # relative: steps closer than this are the same; of a sample time or of a second: instants closer than this are
ROUNDING = 1e-10  # of a unit: what sums of fractions of it may be off by
RESOLUTION = 4 * float(np.finfo(float).eps)  # of a time: what two masters' sums for it may differ by
COARSE = 0.01  # of a sample time: where RESOLUTION exceeds this, sample instants cannot be told apart
SIMPLE = 1e4  # the largest product of numerator and denominator of a simple fraction
LARGEST = 2.0**53  # units: beyond, doubles do not count


@dataclass(frozen=True)
class Clock:
    """A position: `whole` units and `phase` of the next one since t0, `carry` what the last end was moved by [units].

    The unit is `sample_time` [s], or 1 s where that is 0. `steps` were taken so far, the last of length `step` [s], and the
    master's next t should be `label` [s].
    """

    t0: float
    sample_time: float
    label: float
    whole: int = 0
    phase: float = 0.0
    carry: float = 0.0
    steps: int = 0
    step: float = 0.0

    @property
    def unit(self) -> float:
        """[s]"""
        return self.sample_time if self.sample_time > 0 else 1.0

    @property
    def elapsed(self) -> float:
        """Since t0 [s], to whole nanoseconds between sample instants."""
        last = self.whole * self.unit
        if self.phase == 0:
            return last
        rounded = float(np.rint((self.whole + self.phase) * self.unit * NANOSECONDS)) / NANOSECONDS
        return min(max(rounded, last), (self.whole + 1) * self.unit)

    @property
    def time(self) -> float:
        """[s]"""
        return self.t0 + self.elapsed

    @property
    def ticks(self) -> int:
        """Sample instants before this one: the next is t0 + ticks * sample_time."""
        if self.sample_time == 0:
            return 0
        return self.whole + 1 if self.phase > 0 else self.whole

    @property
    def slack(self) -> float:
        """How far the end of a step may lie from a sample instant and still be it, whatever the size of times [units]."""
        return max(min(SNAP, SNAP / self.sample_time), ROUNDING) if self.sample_time > 0 else ROUNDING

    def after(self, t: float, h: float) -> Clock:
        """The clock after a step of h that the master says begins at t.

        Raises:
            OverflowError: it does not count that far.
        """
        share = _share(h, t, self.sample_time)
        sum_ = self.phase + self.carry + share
        if not abs(self.whole + sum_) < LARGEST:
            raise OverflowError
        near = float(np.rint(sum_))
        rest = sum_ - near
        carried = RESOLUTION * abs(t) / self.unit if self.sample_time > 0 else 0.0
        if abs(rest) <= min(max(self.slack, carried), share / 2):
            whole, phase, carry = near, 0.0, rest if abs(rest) > self.slack else 0.0
        else:
            whole = math.floor(sum_)
            phase, carry = sum_ - whole, 0.0
        return Clock(self.t0, self.sample_time, t + h, self.whole + int(whole), phase, carry, self.steps + 1, h)

    def is_sound(self) -> bool:
        """Can this be a clock? A state from outside may hold anything."""
        return (
            0 <= self.steps < LARGEST
            and 0 <= self.whole < LARGEST
            and 0 <= self.phase < 1
            and abs(self.carry) <= COARSE
            and all(map(math.isfinite, (self.t0, self.label, self.step)))
            and self.step >= 0
            and (self.step > 0) == (self.steps > 0)
            and math.isfinite(self.time)
        )

    def error_of(self, t: float, h: float) -> float:
        """By how many steps of h the label t is wrong; 0 if it is not."""
        known = min(h, self.step) if self.steps > 0 else h
        rounding = RESOLUTION * abs(t)
        off = t - self.label
        if not abs(off) <= max(known / 2, 1 / NANOSECONDS, rounding):
            return off / h
        off = t - self.time
        if not abs(off) <= max(h / 2, 1 / NANOSECONDS) + SNAP * self.elapsed + (self.steps + 1) * rounding:
            return off / h
        return 0.0


def _share(h: float, t: float, sample_time: float) -> float:
    """h in units, rounded to what it most likely means."""
    unit = sample_time if sample_time > 0 else 1.0
    x, noise = h / unit, RESOLUTION / 2 * abs(t + h) / unit  # h may be a difference of times, each a rounded sum
    tolerance = SNAP * x if sample_time > 0 else min(SNAP * x, 1 / NANOSECONDS + noise)
    simple = _simplest(x, tolerance)
    if simple > 0:
        return simple
    if sample_time > 0:
        near = float(np.rint(x)) if x >= 1 else 1 / float(np.rint(1 / x))
    else:
        near, noise = float(np.rint(x * NANOSECONDS)) / NANOSECONDS, min(SNAP * x, noise)
    return near if abs(x - near) <= noise else x


def _simplest(x: float, tolerance: float) -> float:
    """The first convergent of x's continued fraction within the tolerance, if it is a simple fraction; else 0.

    `fractions.Fraction.limit_denominator` bounds the denominator, not the error, and the shell has no such thing.
    """
    p, q, before_p, before_q, rest = 1.0, 0.0, 0.0, 1.0, x
    while True:
        whole = float(np.floor(rest))
        p, before_p = whole * p + before_p, p
        q, before_q = whole * q + before_q, q
        if p * q > SIMPLE:
            return 0.0
        if abs(x - p / q) <= tolerance:
            return p / q
        if rest == whole:
            return 0.0
        rest = 1 / (rest - whole)
