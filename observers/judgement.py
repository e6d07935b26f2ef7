"""What the innovations of a sample say of it and of the estimate, for observers without covariances: is the sample an outlier, do
samples and estimate contradict each other, is the estimate lost?
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers import ports
from observers.component import Port
from observers.model import Model
from observers.numerics.consistency import chi_square_quantile, memory_size, tested
from observers.numerics.finite import HUGE, finite, kept
from observers.status import trusted

SMALLEST_NOISE = 1e-9  # of an output's nominal value
CARRIED = 2.0  # an innovation's deviation in those of a sample: the prediction carries the noise of the samples before
GATED = 3  # samples in a row that may be outliers; more of them are none
PATIENCE = 5  # samples in a row at which the guess predicts better, after which the estimate is lost
TIMES = 10.0  # better
FAR = 10.0  # deviations: a prediction that is nearer to its measurement is not lost
QUIETER = 0.1  # of the given noise: the least that innovations are judged by
LEARNT = 25.0  # samples in which the noise is learnt
LOUD = 9.0  # squared, in those of the noise: what one innovation teaches at most


def tuning(owner: str, model: Model, measurement_noise: Mapping[str, float] | None, part: float) -> tuple[Port, ...]:
    """The ports of `noise` and `false_alarm` of `judged`; by default the noise is `part` of the nominal values.

    Raises:
        ModelError: a name in `measurement_noise` that is none of the outputs.
    """
    noise = ports.deviations(
        owner,
        "measurement_noise",
        ports.MEASUREMENT_NOISE,
        model.outputs,
        measurement_noise,
        part,
        smallest=SMALLEST_NOISE,
    )
    return (*noise, ports.FALSE_ALARM)


def memory(model: Model) -> dict[str, int]:
    """Parts of an observer's state that `judged` keeps from sample to sample; all start at 0, and a restart sets them to 0 again."""
    ny = len(model.outputs)
    return {"tests": memory_size(ny), "level": ny, "calm": 1, "gated": 1, "outpredicted": 1}


@dataclass(frozen=True)
class Judgement:
    """A sample, judged.

    Attributes:
        offered, valid: (ny) which measurements are there, and which of them act.
        y: (ny) those that act, else what the estimate predicts (0 where that is not finite); angles within half a turn of that.
        innovation: (ny) 0 where there is none.
        rejected: one was offered that is not finite.
        outlier: the sample was taken for one.
        readable: the predicted outputs are finite: the estimate is within the domain of h.
        contradiction: the innovations are not what noise makes of them.
        memory: the parts of `memory` after the sample.
    """

    y: Any
    offered: Any
    valid: Any
    innovation: Any
    rejected: Any
    outlier: Any
    readable: Any
    contradiction: Any
    memory: dict[str, Any]


def judged(
    model: Model,
    s: SimpleNamespace,
    measured: Any,
    offered: Any,
    expected: Any,
    of_guess: Any,
    noise: Any,
    false_alarm: Any,
) -> Judgement:
    """Judges a sample.

    It is an outlier where it is too far off its prediction, the estimate was trusted once and no such sample has acted since, as long as
    there are few in a row: more of them say that the plant moved, and act. Samples that are quieter than the noise given are judged by
    their own, which is learnt while the estimate is trusted. Where unknown disturbances may move the plant there is neither.

    Args:
        s: the observer's state, with the parts of `memory` and `status`, that of the last sample.
        measured, offered: (ny) the sample and which measurements `measurement_valid` admits.
        expected, of_guess: (ny) the outputs of the prediction and of the constant guess.
        noise, false_alarm: `tuning.measurement_noise.*` (ny) and `tuning.false_alarm`.
    """
    present, rejected = ports.judged(measured, offered)
    predicted = kept(expected, 0)
    innovation = ca.if_else(present, ports.wrapped(model, measured - predicted), 0)
    deviation = CARRIED * noise * ca.if_else(s.level > 0, ca.sqrt(s.level), 1)
    normalised = innovation / deviation
    squared = ca.sumsqr(normalised)
    alone = ca.logic_not(squared <= chi_square_quantile(ca.fmax(ca.sum1(present), 1), false_alarm))
    calm = ca.logic_or(s.calm, trusted(s.status))
    gate = ca.logic_and(calm, s.gated < GATED) if not model.unknown_disturbances else 0
    outlier = ca.logic_and(alone, gate)
    valid = ca.logic_and(present, ca.logic_not(outlier))
    contradicts = ca.logic_and(alone, ca.logic_not(outlier))
    test = tested(s.tests, ca.sumsqr(ca.if_else(valid, normalised, 0)), normalised, valid, false_alarm)  # what acts
    turned = predicted + innovation if any(v.wrap for v in model.outputs) else measured
    any_present = ca.sum1(present) > 0
    gap, gap_of_guess = (ports.wrapped(model, measured - value) / deviation for value in (expected, of_guess))
    return Judgement(
        y=ca.if_else(valid, turned, predicted),
        offered=present,
        valid=valid,
        innovation=innovation,
        rejected=rejected,
        outlier=outlier,
        readable=ca.sum1(finite(expected)) == len(model.outputs),
        contradiction=ca.logic_or(test.lately, contradicts),
        memory={
            "tests": test.memory,
            "level": s.level if model.unknown_disturbances else _learnt(s, innovation / (CARRIED * noise), valid),
            "calm": ca.logic_and(calm, ca.logic_not(contradicts)),
            "gated": ca.if_else(any_present, ca.if_else(outlier, s.gated + 1, 0), s.gated),
            "outpredicted": _outpredicted(s.outpredicted, gap, gap_of_guess, present),
        },
    )


def _learnt(s: SimpleNamespace, normalised: Any, valid: Any) -> Any:
    """The mean square of the innovations (ny), in those that the noise given makes; 0: nothing is learnt yet."""
    level = ca.if_else(s.level > 0, s.level, 1)
    moved = level + (ca.fmin(normalised**2, LOUD * level) - level) / LEARNT
    learns = ca.logic_and(valid, trusted(s.status))
    return ca.if_else(learns, ca.fmax(ca.fmin(moved, 1), QUIETER**2), s.level)


def _outpredicted(count: Any, gap: Any, gap_of_guess: Any, present: Any) -> Any:
    """Samples in a row at which the guess predicts far better; a gap (ny) that is not finite counts as huge, a missing sample not."""
    size, size_of_guess = (ca.mmax(ca.if_else(present, kept(ca.fabs(g), HUGE), 0)) for g in (gap, gap_of_guess))
    worse = ca.logic_and(size > FAR, size > TIMES * size_of_guess)
    return ca.if_else(ca.sum1(present) > 0, ca.if_else(worse, count + 1, 0), count)
