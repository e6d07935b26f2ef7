"""Runs an observer over streams and judges what it said of its estimates.

An estimate is wrong where a state, an algebraic variable or an unknown parameter is farther from the truth than 5 % of the truth's rms
and twice the largest error on clean data. It is silent where it is wrong and `diagnostics.trusted`, but for those that are `explained`:
another motion of the model fits the samples within their noise (`hindsight`), and nothing could tell. Estimates are those of the current
time, as read after a step, against the truth of that time: what a fallback would have to go by.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from advice.streams import hindsight
from advice.streams.corruptions import CLEAN, Corruption
from advice.streams.native import Sample
from advice.streams.streams import Stream, Streams
from observers.component import Component
from observers.instance import Instance

PART, TIMES = 0.05, 2.0  # of the truth's rms; the largest clean error
BRANCHES = ("x", "z")


@dataclass(frozen=True)
class Record:
    """Estimates (n,) by name, their errors and standard deviations (n, estimated), not finite where the observer states none, whether each
    sample's was trusted (n,), and how the run ended: empty, or its error. After an error the estimates are not finite, and not trusted.
    """

    estimates: dict[str, np.ndarray]
    errors: np.ndarray
    deviations: np.ndarray
    trusted: np.ndarray
    ended: str


@dataclass(frozen=True)
class Verdict:
    """On one corrupted stream, from the corruption's beginning on: `wrong`, `silent` and `explained` estimates, of `samples`.

    `flagged`: whether a wrong estimate was ever said to be none to trust, or all are explained. `recovery`: samples from the corruption's
    end until all estimates are right again, None for a corruption that stays, `never` where they are not at the stream's end.
    """

    corruption: Corruption
    seed: int
    samples: int
    wrong: int
    silent: int
    explained: int
    flagged: bool
    recovery: int | None
    never: bool
    ended: str


@dataclass(frozen=True)
class Clean:
    """On clean streams, after the start: the largest error of each estimate relative to its rms, the part of samples not trusted, wrong
    estimates by the truth's rms alone, and errors that ended runs.
    """

    largest: np.ndarray
    alarms: float
    ended: tuple[str, ...]


@dataclass(frozen=True)
class Tried:
    """An observer with its parameters that differ from the start values, and what a sample of it does."""

    component: Component
    parameters: Mapping[str, float]
    sample: Sample


def run(tried: Tried, stream: Stream) -> Record:
    """The observer over the stream."""
    names = [port.name for port in tried.component.outputs]
    compared = _compared(tried.component, stream)
    columns = [names.index(f"estimate.{name}") for name, _ in compared]
    trusted = names.index("diagnostics.trusted")
    n = stream.scenario.samples
    rows, ended = driven(tried, stream.measured | stream.inputs, n, stream.scenario.sample_time)
    truth = np.column_stack([true[1:] for _, true in compared])
    estimates = {name: rows[:, column] for (name, _), column in zip(compared, columns, strict=True)}
    stated = [f"diagnostics.std.{name}" for name, _ in compared]
    deviations = [rows[:, names.index(s)] if s in names else np.full(n, np.nan) for s in stated]
    return Record(estimates, rows[:, columns] - truth, np.column_stack(deviations), rows[:, trusted] > 0.5, ended)


def driven(tried: Tried, given: Mapping[str, np.ndarray], samples: int, sample_time: float) -> tuple[np.ndarray, str]:
    """The observer's outputs after each sample (samples, outputs), not finite after an error, and that error, or nothing; `given`: its
    inputs by name, those that are missing at their start values.
    """
    component = tried.component
    begun = Instance(component, tried.parameters)
    u = np.tile(begun.u, (samples, 1))
    for i, port in enumerate(component.inputs):
        if port.name in given:
            u[:, i] = given[port.name]
    rows, z = np.full((samples, len(component.outputs)), np.nan), begun.z
    for k in range(samples):
        z, shown = tried.sample(z, u[k], begun.p, k * sample_time)
        if not np.isfinite(z).all():  # what becomes fmi2Error
            return rows, f"the state is not finite after sample {k}"
        rows[k] = shown
    return rows, ""


def _compared(component: Component, stream: Stream) -> list[tuple[str, np.ndarray]]:
    """What is estimated and known, with its truth (n + 1,)."""
    found = []
    for port in component.outputs:
        branch, _, name = port.name.partition(".")
        for true in BRANCHES:
            if branch == "estimate" and f"{true}.{name}" in stream.truth:
                found.append((name, stream.truth[f"{true}.{name}"]))
    return found


def limits(tried: Tried, streams: Streams, seeds: Iterable[int]) -> tuple[np.ndarray, Clean]:
    """What makes an estimate wrong, (estimated,), and how the observer did on the clean streams."""
    start, records, squares = streams.scenario.settled, [], []
    for seed in seeds:
        stream = streams.stream(CLEAN, seed)
        records.append(run(tried, stream))
        squares.append([np.mean(true**2) for _, true in _compared(tried.component, stream)])
    rms = np.sqrt(np.mean(squares, 0))
    errors = np.concatenate([np.abs(record.errors[start:]) for record in records])
    largest = np.max(np.where(np.isfinite(errors), errors, np.inf), 0)
    alarms = float(np.mean([~record.trusted[start:] for record in records]))
    clean = Clean(largest / rms, alarms, tuple(record.ended for record in records if record.ended))
    return np.maximum(PART * rms, TIMES * np.where(np.isfinite(largest), largest, 0)), clean


def judge(tried: Tried, stream: Stream, limit: np.ndarray) -> Verdict:
    """One corrupted stream."""
    scenario, corruption = stream.scenario, stream.corruption
    record = run(tried, stream)
    begin = scenario.settled if corruption.plant == "mismatch" else scenario.during.start
    bad = ~(np.abs(record.errors[begin:]) <= limit).all(1)
    trusted = record.trusted[begin:]
    silent = np.zeros(len(record.trusted), dtype=bool)
    silent[begin:] = bad & trusted
    known = hindsight.explained(stream, record.estimates, silent)
    last = np.flatnonzero(bad)[-1] + begin if bad.any() else -1
    never = bool(corruption.ends and bad[-1])
    return Verdict(
        corruption=corruption,
        seed=stream.seed,
        samples=len(bad),
        wrong=int(bad.sum()),
        silent=int((silent & ~known).sum()),
        explained=int(known.sum()),
        flagged=bool((bad & ~trusted).any() or (bad == known[begin:]).all()),
        recovery=max(last + 1 - scenario.during.stop, 0) if corruption.ends and not never else None,
        never=never,
        ended=record.ended,
    )
