"""What a filter makes of its innovations: outliers gated, contradictions told, and a way back where the estimate is wrong.

An innovation nu (ny) of covariance S is tested in three ways, each in units of what it is believed to be:

- One output of a sample farther than `tuning.gate` standard deviations from its prediction is an outlier: it does not act.
- The tests of `consistency` decide whether estimate and samples contradict each other: status `inconsistent`.
- Outliers in a row say that the estimate is wrong, not the sensor. So does `doubt`, a cumulative sum (Page, Biometrika 41, 1954) of the
  clipped nu' S^-1 nu / dof above a drift. The covariance starts again around the estimate; where that does not help, the estimate starts
  again at the guess. Where it comes back before the samples fit, starting again did not help: the next time takes twice as much of it.
- Innovations that keep to one side, each of them small, are the same to a cumulative sum of their own, `lean`: the covariance starts again.
- What was learned from samples that contradicted the estimate is worth nothing once they have ended, and a covariance that they made small
  keeps it for very long: where a spell of them ends, the covariance starts again too, and so it does where one lasts, but not for ever.

Where nobody says what the measurement noise is, the matrices of a design fix the gain only: scaled all by one factor, they give the same
estimate. The factor is estimated from the innovations, `level`, and the deviations shown are in its scale. While the samples contradict the
estimate it hardly grows. Where the noise was given, the level only widens the gate and lessens the doubt: outliers are far from what other
samples show, also on a model that is worse than its noise says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers import ports
from observers.component import Port
from observers.model import Model, Variable
from observers.numerics.consistency import HUSHED, hushed, memory_size, tested
from observers.numerics.finite import HUGE, finite
from observers.numerics.layout import Layout
from observers.status import CODE, worst

GATE = Port(
    "tuning.gate",
    "standard deviations of an innovation beyond which a measurement is an outlier, and does not act; from 1e6 on no estimate starts again",
    start=10.0,
    min=3.0,
    variability="tunable",
)
TUNING = (ports.FALSE_ALARM, ports.DEVIATION_LIMIT, GATE)
SETTINGS = {port.name.removeprefix("tuning."): 1 for port in TUNING}  # their part of a filter's parameters

ROW = 10  # outliers in a row, two for each that is none
LARGEST, DRIFT, THRESHOLD = 8.0, 2.5, 60.0  # of `doubt`: eleven samples in a row far off; noise alone does not reach it
# Of `lean`, in deviations: what is usual, what counts at most, and where it says something. White innovations reach it once in 10^7
# samples, those that are one deviation off at the thirty-first, and those that are farther off when `doubt` does.
SLANT, MOST_LEANT, LEANT = 0.5, 2.0, 15.0
MOST_TRIES = 2  # each with twice the threshold of the one before
PROVEN = 60  # samples after a restart, or samples in a row that fit, that end it; what was trusted before is `settling` for as many
LOSS, MOST_DISTRUST = 4.0, 500.0  # trust is away for so many samples for each that contradicted, and so many at most
PROBATION = 1000.0  # the same after a restart of a paper's design, which follows what it is given for very long
# Samples in a row that fit until trust can be lost for longer; of a paper's design, which converges slowly.
EARNED, SLOWLY_EARNED = 20, 150
MEMORY = 100  # samples, of `level`
# Times the level, what a sample that contradicts counts at most: cut lower, squares of Gaussian innovations have so small a mean that they
# would contradict the level for ever.
HEARD = 4.0
HEARD_BY_DESIGN = 2.0  # the same of a paper's design, whose innovations die away slowly
MOST_LEVEL = 10.0  # times the largest level of the first samples, or 1
SPELL = 100  # samples of contradictions until the covariance starts again; the second time, twice as many
TAUGHT = 5  # samples, far off each, that acted: what they taught is forgotten once there are no more
MOST_SPELLS = 2  # times, until it is trusted again; the same of `lean`
NEVER = 1e6  # a gate from which on nothing starts again: the filter as in its textbook
FINDING = 30  # samples that it takes to find a level, where nobody says what the measurement noise is
ROUNDING = 1e-9  # of a nominal value: what an innovation is at least
UNSAID = 3e-2  # the same where nobody says what the measurement noise is


@dataclass(frozen=True)
class Watch:
    """The tests of the filter of a model with n estimates.

    `known`: the measurement noise was given. `weighted`: the design is a paper's matrices, which fix the gain only.
    """

    model: Model
    n: int
    known: bool
    weighted: bool = False

    @property
    def settle(self) -> int:
        """Samples after a start until the estimate counts."""
        return 2 * self.n if self.known else max(2 * self.n, FINDING)

    @property
    def state(self) -> Layout:
        single = (
            "level",
            "learnt",
            "unit",
            "peak",
            "quiet",
            "earned",
            "distrust",
            "doubt",
            "tries",
            "row",
            "turn",
            "spell",
            "spells",
            "leans",
            "taught",
            "hush",
            "age",
            "restarted",
            "proving",
        )
        ny = len(self.model.outputs)
        return Layout(tests=memory_size(ny), lean=2 * ny, **dict.fromkeys(single, 1))

    @property
    def start(self) -> Any:
        return self.state.pack(
            {
                name: (ca.DM.ones if name in ("level", "unit", "peak") else ca.DM.zeros)(n)
                for name, n in self.state.sizes.items()
            }
        )

    def deviations(self, memory: Any, variances: Any) -> Any:
        """Standard deviations of the `variances` of a covariance as the filter has it; finite whatever it has."""
        return ca.sqrt(ca.fmin(ca.fmax(self.state.unpack(memory).unit * variances, 0), HUGE))

    def again(self, memory: Any) -> Any:
        """The factor of the first covariance where the estimate starts again.

        The scale of weights has come down to the innovations since the start; the first covariance is as large again as that of the start
        turned out to be.
        """
        s = self.state.unpack(memory)
        return s.peak / s.unit if self.weighted else 1

    def gated(self, memory: Any, innovation: Any, variances: Any, valid: Any, gate: Any) -> Any:
        """Which of the `valid` outputs (ny) are outliers; `variances` (ny), the diagonal of S."""
        s = self.state.unpack(memory)
        far = innovation**2 > gate**2 * self._unit(s.level, variances) * variances
        return ca.logic_and(ca.logic_and(valid, far), s.age >= self.settle)

    def _unit(self, level: Any, variances: Any) -> Any:
        """`level`, so large that no innovation is believed to be smaller than rounding, or what is unsaid, leaves it."""
        least = ca.DM([(ROUNDING if self.known else UNSAID) * v.nominal for v in self.model.outputs])
        return ca.fmax(level, ca.mmax(least**2 / ca.fmax(variances, 1e-300)))

    def _doubtful(self, learnt: Any) -> Any:
        """By how much a level that so many samples told may be too small: two standard deviations of their mean square."""
        return 1 + 2 * ca.sqrt(2 / ca.fmax(learnt * len(self.model.outputs), 1))


@dataclass(frozen=True)
class Verdict:
    """`memory` after the sample; `inflate`, `restart`: what is to be done; `cases`: (condition, code) for `status_of`."""

    memory: Any
    inflate: Any
    restart: Any
    cases: tuple[tuple[Any, int], ...]


def verdict(
    watch: Watch,
    memory: Any,
    squared: Any,
    innovation: Any,
    variances: Any,
    valid: Any,
    outlying: Any,
    tuning: SimpleNamespace,
) -> Verdict:
    """The verdict on a sample.

    Args:
        memory: `watch.state`, of the last sample.
        squared: nu' S^-1 nu over the outputs that acted.
        innovation, variances, valid, outlying: (ny); the diagonal of S; which outputs were measured, and which of these are outliers.
        tuning: with `false_alarm` and `gate`.
    """
    s = watch.state.unpack(memory)
    unit = watch._unit(1 if watch.known else s.level * watch._doubtful(s.learnt), variances)
    each = innovation**2 / ca.fmax(variances, 1e-300)
    whole = squared + ca.sum1(ca.if_else(outlying, each, 0))
    dof = ca.sum1(valid)
    normalised = ca.if_else(valid, innovation / ca.sqrt(ca.fmax(unit * variances, 1e-300)), 0)
    result = tested(s.tests, whole / unit, normalised, valid, tuning.false_alarm)
    gross = ca.sum1(outlying) > 0
    loud = ca.logic_or(result.lately, ca.logic_and(result.alone, ca.logic_not(gross)))
    # One outlier alone lets the tests of the last few samples fail: it contradicts nothing where the sample before it did not either.
    lone = ca.logic_and(gross, ca.logic_and(s.row == 0, s.quiet > 0))
    raised = ca.logic_and(loud, ca.logic_not(lone))
    mean = whole / ca.fmax(dof, 1)
    settled = s.age >= watch.settle

    row = ca.if_else(dof > 0, ca.if_else(gross, s.row + 1, ca.fmax(s.row - 2, 0)), s.row)
    usual = mean / watch._unit(s.level, variances)
    ratio = ca.if_else(finite(usual), ca.fmin(usual, LARGEST), LARGEST)
    doubtful = ca.logic_and(ca.logic_and(settled, dof > 0), ca.logic_not(gross))
    doubt = ca.if_else(doubtful, ca.fmax(s.doubt + ratio - DRIFT, 0), s.doubt)
    mild = doubt > THRESHOLD * 2**s.tries
    lost = ca.logic_or(mild, row >= ROW * 2 ** ca.fmin(s.tries, 3))
    # Each time without trust since makes it twice as long until the next: of a model that is a little wrong there is no end.
    misled = ca.logic_and(s.taught >= TAUGHT, s.spells < MOST_SPELLS)
    long = ca.logic_and(misled, ca.logic_and(s.quiet < EARNED, s.spell >= SPELL * 2**s.spells))
    lean = _leant(s.lean, normalised, ca.logic_and(doubtful, valid))
    # Where the noise is given, what keeps to one side is a model that is a little wrong, which a wide covariance would not mend.
    leaning = (
        0 if watch.weighted or watch.known else ca.logic_and(ca.mmax(lean) > LEANT * 2**s.leans, s.leans < MOST_SPELLS)
    )
    fits = ca.logic_and(s.quiet == EARNED - 1, ca.logic_not(raised))
    ended = ca.logic_and(misled, ca.logic_and(fits, s.spell >= (EARNED + 5) * 2**s.spells))
    allowed = tuning.gate < NEVER
    forgets = ca.logic_and(ca.logic_or(ca.logic_or(lost, long), ended), allowed)
    again = ca.logic_or(forgets, ca.logic_and(leaning, allowed))
    restart = ca.logic_and(again, ca.logic_and(lost, s.turn))
    contradicted = ca.logic_or(raised, ca.logic_and(again, ca.logic_or(ca.logic_or(lost, long), leaning)))
    quiet = ca.if_else(contradicted, 0, ca.fmin(s.quiet + (dof > 0), SLOWLY_EARNED))
    earned = ca.logic_or(s.earned, quiet >= (SLOWLY_EARNED if watch.weighted else EARNED))
    more = ca.fmax(ca.fmin(s.distrust + LOSS, ca.if_else(earned, MOST_DISTRUST, LOSS)), s.distrust)
    distrust = ca.if_else(contradicted, more, ca.fmax(s.distrust - (dof > 0), 0))
    if watch.weighted:
        distrust = ca.if_else(again, PROBATION, distrust)

    tries = ca.if_else(quiet < PROVEN, ca.fmin(s.tries + ca.logic_and(again, lost), MOST_TRIES), 0)
    turn = ca.if_else(ca.logic_and(again, lost), ca.logic_not(s.turn), ca.logic_and(s.turn, s.age < PROVEN))
    level, peak = _learned(watch, s, mean, dof, loud)
    # What starts again before it knows its noise starts to learn it again, too.
    # So does what has learned it from a start that went wrong, and finds all samples since far quieter.
    early = 0 if watch.known or watch.weighted else s.learnt < PROVEN
    hush = hushed(s.hush, mean, s.level, dof > 0)
    fresh = ca.logic_and(early, ca.logic_or(again, hush >= HUSHED))
    after = watch.state.pack(
        {
            "tests": ca.if_else(again, 0, result.memory),
            "level": level,
            "learnt": ca.if_else(fresh, 0, s.learnt + (dof > 0)),
            "unit": 1 if watch.known else watch._unit(level, variances),
            "peak": peak,
            "doubt": ca.if_else(again, 0, doubt),
            "lean": ca.if_else(again, 0, lean),
            "quiet": quiet,
            "earned": earned,
            "distrust": distrust,
            "proving": ca.if_else(again, s.earned, s.proving),  # what was never trusted starts as at first
            "hush": ca.if_else(fresh, 0, hush),
            "age": ca.if_else(ca.logic_or(again, fresh), 0, ca.fmin(s.age + (dof > 0), PROVEN)),
            "tries": tries,
            "row": ca.if_else(again, 0, row),
            "turn": turn,
            "spell": ca.if_else(ca.logic_or(forgets, distrust <= LOSS), 0, s.spell + (dof > 0)),
            "taught": ca.if_else(forgets, 0, s.taught + ca.logic_and(result.alone, ca.logic_not(gross))),
            "leans": ca.if_else(distrust <= LOSS, 0, s.leans + ca.logic_and(again, leaning)),
            "spells": ca.if_else(distrust <= LOSS, 0, s.spells + ca.logic_and(again, ca.logic_or(long, ended))),
            "restarted": ca.logic_or(s.restarted, ca.logic_and(again, ca.logic_not(fresh))),
        }
    )
    cases = (
        (ca.sum1(outlying) > 0, CODE.outlier),
        (s.age < ca.if_else(s.proving, PROVEN, watch.settle), CODE.settling),
        (ca.logic_or(contradicted, distrust > LOSS), CODE.inconsistent),
    )
    return Verdict(after, ca.logic_and(again, ca.logic_not(restart)), restart, cases)


def _leant(lean: Any, normalised: Any, counts: Any) -> Any:
    """`lean` (2 ny), above and below, after a sample of the `normalised` innovations (ny) that `counts` (ny)."""
    cut = ca.if_else(counts, ca.fmax(ca.fmin(normalised, MOST_LEANT), -MOST_LEANT), 0)
    moved = ca.fmax(lean + ca.vertcat(cut, -cut) - SLANT, 0)
    return ca.if_else(ca.vertcat(counts, counts), moved, lean)


def _learned(watch: Watch, s: SimpleNamespace, mean: Any, dof: Any, loud: Any) -> tuple[Any, Any]:
    """`level` and `peak` after a sample of so many outputs `dof` whose nu' S^-1 nu / dof is `mean`; `loud`, whether it contradicts."""
    beginning = 0 if watch.known else ca.logic_and(s.restarted == 0, s.age < FINDING)
    if watch.weighted:  # of a paper's design, which converges slowly, the first samples say most
        contradicting, early, slow = HEARD_BY_DESIGN, s.age + 1, 0
    else:
        # Sample k of the first weighs (k + 1)(k + 2): the very first are compared with a covariance that is the guess's, and say little.
        contradicting, early, slow = HEARD, (s.age + 3) / 3, ca.logic_and(loud, ca.logic_not(beginning))
    most = ca.if_else(beginning, HUGE, ca.if_else(loud, contradicting, LARGEST) * s.level)
    heard = ca.if_else(finite(mean), ca.fmin(mean, most), most)
    growing = ca.if_else(beginning, early, ca.fmin(s.age + 1, MEMORY))
    memory = ca.if_else(ca.logic_or(s.restarted, watch.known), MEMORY, growing)
    rate = 1 / ca.if_else(slow, 2 * MEMORY, memory)
    level = ca.if_else(dof > 0, s.level + rate * (heard - s.level), s.level)
    peak = ca.if_else(beginning, ca.fmax(s.peak, level), s.peak)
    return ca.fmax(level, 1) if watch.known else ca.fmin(level, MOST_LEVEL * peak), peak


def status_of(
    said: Verdict, valid: Any, finite: Any, deviations: Any, tuning: SimpleNamespace, variables: Sequence[Variable]
) -> Any:
    """The status after a sample.

    Args:
        valid: (ny) which outputs were measured.
        finite: whether the correction is.
        deviations: (n) those of the estimate after the sample.
        tuning: with `deviation_limit`.
        variables: (n) what is estimated.
    """
    nominal = ca.DM([variable.nominal for variable in variables])
    return worst(
        (ca.sum1(valid) < valid.numel(), CODE.sample_rejected),
        *said.cases,
        (ca.sum1(deviations > tuning.deviation_limit * nominal) > 0, CODE.uncertain),
        (ca.logic_not(finite), CODE.solver_failed),
    )
