"""Observers on the same noisy streams: clean ones, for errors and what they say of them, and ones corrupted as the board corrupts them.

An error counts once a stream is `settled`. Wrong is an estimate, of any observer, that is farther from the truth than 5 % of the truth's
rms and twice the largest error of the best observer on clean streams (`streams.verdicts`). So one that is silently off where others are
right is found on clean streams too.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from advice.candidates import Candidate
from advice.streams.corruptions import CLEAN, CORRUPTIONS
from advice.streams.native import Sample, sampled
from advice.streams.streams import Streams
from advice.streams.verdicts import Record, Tried, Verdict, judge, limits, run
from observers.model import Model, Variable

FAULTS = ("outlier", "offset", "drift", "stuck", "jump", "mismatch")
JUMP = next(c for c in CORRUPTIONS if c.name == "jump")
WITHIN = 0.95  # of the samples that are left: from there on a stream is settled
SIGMAS = 2.0


@dataclass(frozen=True)
class Outcome:
    """What became of an observer.

    `errors`: rms by state and unknown parameter, in its unit; `total`: of all, in nominal values; `after_jump`: the same a while after an
    unknown parameter has jumped, None where none does or the observer was not tried with faults; `coverage`: part of the errors within
    two of the standard deviations that it states, None where it states none; `settling` [s]: median time until nearly all estimates
    that follow are right, None where they never are; `settled`: on how many clean streams they are; `per_sample` [s]; `wrong`: estimates,
    `silent`: the part of them that was trusted though no other motion explains it, both 0 where it was not tried with faults; `ended`: the
    error that ended a run, or empty.
    """

    candidate: Candidate
    errors: Mapping[str, float]
    total: float
    after_jump: float | None
    coverage: float | None
    settling: float | None
    settled: int
    per_sample: float
    wrong: int
    silent: float
    ended: str


@dataclass(frozen=True)
class _Runs:
    """An observer over the clean streams; `settled`: samples that do not count."""

    candidate: Candidate
    tried: Tried
    sample_time: float
    settled: int
    names: tuple[str, ...]
    records: Sequence[Record]
    limit: np.ndarray
    per_sample: float


def trial(
    model: Model,
    candidates: Sequence[Candidate],
    streams: Mapping[int, Streams],
    corrupted: Sequence[int],
    progress: Callable[[str], None] = lambda name: None,
) -> list[Outcome]:
    """An outcome for each candidate; `streams` by seed, of which those in `corrupted` are tried with FAULTS too."""
    runs = []
    for candidate in candidates:
        progress(f"{candidate.method}: clean streams")
        runs.append(_clean(candidate, streams))
    best = np.min([r.limit for r in runs], axis=0) if runs else np.zeros(0)
    settling = [[k for record in r.records if (k := _settling(record.errors, best)) is not None] for r in runs]
    most = max(map(len, settling), default=0)
    outcomes = []
    for r, found in zip(runs, settling, strict=True):
        progress(f"{r.candidate.method}: faults")
        # What does not settle where another one does is not tried further.
        seeds = corrupted if most and len(found) == most else ()
        after_jump = _after_jump(model, r, streams, seeds)
        outcomes.append(_outcome(model, r, found, after_jump, _verdicts(r, best, streams, seeds)))
    return outcomes


def _clean(candidate: Candidate, streams: Mapping[int, Streams]) -> _Runs:
    scenario = next(iter(streams.values())).scenario
    clock = _Clock(sampled(candidate.component, scenario.sample_time))
    tried = Tried(candidate.component, {}, clock)
    records = [run(tried, made.stream(CLEAN, seed)) for seed, made in streams.items()]
    limit = np.max([limits(tried, made, [seed])[0] for seed, made in streams.items()], axis=0)
    names = tuple(records[0].estimates)
    return _Runs(candidate, tried, scenario.sample_time, scenario.settled, names, records, limit, clock.median)


class _Clock:
    """A sample function that keeps how long its calls took."""

    def __init__(self, sample: Sample):
        self._sample, self._taken = sample, [0.0]

    def __call__(self, *values: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        begin = time.perf_counter()
        result = self._sample(*values)
        self._taken.append(time.perf_counter() - begin)
        return result

    @property
    def median(self) -> float:
        """[s]"""
        return float(np.median(self._taken))


def _verdicts(r: _Runs, limit: np.ndarray, streams: Mapping[int, Streams], corrupted: Sequence[int]) -> list[Verdict]:
    """On the corrupted streams, and on the clean ones."""
    if not corrupted:
        return []
    chosen = [(CLEAN, seed) for seed in streams] + [
        (c, seed) for c in CORRUPTIONS if c.name in FAULTS for seed in corrupted if streams[seed].scenario.allows(c)
    ]
    return [judge(r.tried, streams[seed].stream(c, seed), limit) for c, seed in chosen]


def _after_jump(model: Model, r: _Runs, streams: Mapping[int, Streams], corrupted: Sequence[int]) -> float | None:
    """The rms of all errors in nominal values, from a fifth of the stream after the jump on; None where no parameter jumps."""
    able = [seed for seed in corrupted if streams[seed].scenario.allows(JUMP)]
    if not able:
        return None
    ends = [
        run(r.tried, streams[seed].stream(JUMP, seed)).errors[streams[seed].scenario.during.stop :] for seed in able
    ]
    return in_nominal(_rms(r, np.concatenate(ends)), _estimated(model))


def _rms(r: _Runs, errors: np.ndarray) -> dict[str, float]:
    rms = np.sqrt(np.mean(np.where(np.isfinite(errors), errors, np.inf) ** 2, axis=0))
    return dict(zip(r.names, map(float, rms), strict=True))


def _estimated(model: Model) -> tuple[Variable, ...]:
    return (*model.states, *model.algebraic, *model.unknown_parameters)


def _outcome(
    model: Model, r: _Runs, settling: Sequence[int], after_jump: float | None, verdicts: Sequence[Verdict]
) -> Outcome:
    start = r.settled
    gaps = np.concatenate([record.errors[start:] for record in r.records])
    errors = _rms(r, gaps)
    stated = np.concatenate([record.deviations[start:] for record in r.records])
    known = np.isfinite(stated)
    covered = np.abs(gaps[known]) <= SIGMAS * stated[known]
    wrong, silent = sum(v.wrong for v in verdicts), sum(v.silent for v in verdicts)
    return Outcome(
        r.candidate,
        errors,
        in_nominal(errors, _estimated(model)),
        after_jump,
        float(np.mean(covered)) if known.any() else None,
        float(np.median(settling)) * r.sample_time if settling else None,
        len(settling),
        r.per_sample,
        wrong,
        silent / wrong if wrong else 0.0,
        next(filter(None, [*(made.ended for made in r.records), *(v.ended for v in verdicts)]), ""),
    )


def in_nominal(errors: Mapping[str, float], variables: Sequence[Variable]) -> float:
    """The rms of errors by name, in nominal values."""
    return float(np.sqrt(np.mean([(errors[v.name] / v.nominal) ** 2 for v in variables if v.name in errors])))


def _settling(errors: np.ndarray, limit: np.ndarray) -> int | None:
    """The first sample from which nearly all estimates are within the limit, None where that is late in the stream."""
    right = (np.abs(errors) <= limit).all(axis=1)
    left = np.cumsum(right[::-1])[::-1] / np.arange(len(right), 0, -1)
    enough = np.flatnonzero(right & (left >= WITHIN))
    return int(enough[0]) if enough.size and enough[0] <= len(right) // 2 else None
