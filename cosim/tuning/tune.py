"""Tuning: the noises that an observer FMU should believe in, found from recorded files.

The likelihood of the innovations, over replays of the first part of each log, is made as large as it gets; where an FMU does not say how
large it believes its innovations to be, or where it is asked for, the error so many samples ahead is made as small as it gets. What is
held back, the end of each log, judges the result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cosim.errors import ExperimentError
from cosim.fmu import Value, read_description, unit_of
from cosim.master.repeated import Repeated
from cosim.master.watched import LIMIT
from cosim.replay.reading import Reading
from cosim.replay.replay import Connected, connected
from cosim.system.parameter_set import parameters_of, write_parameter_set
from cosim.tuning.innovations import Consistency, consistency
from cosim.tuning.parameters import Parameter, Plan, logarithms, noises_of, plan
from cosim.tuning.search import search, spread
from cosim.tuning.trial import Judged, Trials, fitted_samples, has_covariance, outputs_of

SAMPLES = 10  # that are not held back, at least, for each number that is tuned
EDGE = 0.05  # of a logarithm: nearer to an end of its range than that, a number is at it
OPEN = math.log(2)  # standard deviation of a logarithm from which on the data do not determine it


@dataclass(frozen=True)
class Part:
    """What the noises before and after are worth on a part of the logs, and whether the innovations there are consistent with them."""

    before: Judged
    after: Judged
    consistent_before: Consistency
    consistent_after: Consistency


@dataclass(frozen=True)
class Tuned:
    """What came of it.

    Attributes:
        parameters: what was tuned, with its values before; `values`: after.
        deviations: standard deviation of the logarithm of each value, by the curvature at the optimum.
        ahead: how many samples ahead the error was made small; 0: the likelihood was made large.
        fitted, held_back: the part that it was done on, and the rest.
        evaluations: replays of the fitted part.
        zeros: noises that are 0 and stay so.
        warnings: what to think of before the values are used, a sentence each.
        given: other noises that were given, which belong to the values.
        outputs: the unit of each output whose innovations count, by its name.
    """

    parameters: tuple[Parameter, ...]
    values: Mapping[str, float]
    deviations: Mapping[str, float]
    ahead: int
    fitted: Part
    held_back: Part
    evaluations: int
    zeros: tuple[str, ...]
    warnings: list[str]
    given: Mapping[str, float]
    outputs: Mapping[str, str]


def tune(
    fmu: Path | str,
    logs: Sequence[Path | str],
    *,
    ahead: int = 0,
    sample_time: float | None = None,
    mapping: Mapping[str, str] | None = None,
    reading: Reading | None = None,
    overrides: Mapping[str, Value] | None = None,
    parameters: Path | None = None,
    progress: Callable[[int, int], None] = lambda done, most: None,
    limit: float = LIMIT,
) -> Tuned:
    """The noises of an observer FMU that the logs make most likely.

    Args:
        fmu: the FMU.
        logs: as for `cosim.replay.replay`, with the same columns.
        ahead: not the likelihood counts but the error so many samples ahead; 0: the likelihood, or where the FMU has none, 1.
        sample_time, mapping, reading, limit: as for `cosim.replay.replay`.
        overrides: start values of parameters; the constant values of inputs without a column. A noise that is set is not tuned.
        parameters: a parameter set; the search starts from the noises in it.
        progress: called with the evaluations done and the most that there can be.

    Raises:
        SystemFileError, ExperimentError: as `cosim.replay.replay`; nothing to tune, a log that is too short.
        cosim.master.slave.RunError: the FMU failed with its own noises, ended its process or did not return.
    """
    description = read_description(Path(fmu).resolve())
    outputs_of(description)
    if ahead < 0:
        raise ExperimentError(f"the error {ahead} samples ahead: 1 is the least")
    ahead = ahead or (0 if has_covariance(description) else 1)
    held = dict(overrides or {})
    starts = {} if parameters is None else parameters_of(parameters, description)
    chosen = plan(description, held, starts, likelihood=ahead == 0)
    tuned = {p.name for p in chosen.parameters}
    settings = {**{name: value for name, value in starts.items() if name not in tuned}, **held}
    found = [connected(fmu, log, sample_time, mapping or {}, reading, settings) for log in logs]
    _check_lengths(found, chosen, ahead)
    with Repeated(limit) as repeated:
        trials = Trials(repeated, found, {**settings, **chosen.settings}, ahead)
        names = [p.name for p in chosen.parameters]

        def named(x: np.ndarray) -> dict[str, float]:
            return {
                p.name: min(max(value, p.least), p.most)
                for p, value in zip(chosen.parameters, np.exp(x).tolist(), strict=True)
            }

        def loss(x: np.ndarray) -> float:
            return -trials.value(named(x))

        start, bounds = logarithms(chosen.parameters)
        first = trials.judged(named(np.array(start)), held_back=False)  # an FMU that fails with its own noises says why
        if not (first.samples and math.isfinite(first.value)):
            raise ExperimentError(
                f"{fmu}: its own noises explain nothing of {logs[0]}: no measurement counts, or a noise is not finite"
            )
        best = search(loss, start, bounds, progress)
        deviations = spread(loss, best.x, best.loss)
        before, after = named(np.array(start)), named(best.x)
        fitted, held_back = (_part(trials.judged(before, back), trials.judged(after, back)) for back in (False, True))
    said = dict(zip(names, deviations.tolist(), strict=True))
    return Tuned(
        chosen.parameters,
        after,
        said,
        ahead,
        fitted,
        held_back,
        best.evaluations,
        chosen.zeros,
        _warnings(chosen, after, said, held_back),
        noises_of(description, settings),
        {v.name: unit_of(v) for v in description.modelVariables if v.name in trials.outputs},
    )


def write(tuned: Tuned, fmu: Path, path: Path) -> None:
    """The tuned noises, and those that were given beside them, as a parameter set.

    Raises:
        OSError: the file cannot be written.
    """
    write_parameter_set(path, {**tuned.given, **tuned.values}, read_description(fmu))


def _part(before: Judged, after: Judged) -> Part:
    return Part(before, after, consistency(before.innovations), consistency(after.innovations))


def _check_lengths(logs: Sequence[Connected], chosen: Plan, ahead: int) -> None:
    """Refuse logs that hold less than is asked of them."""
    least = SAMPLES * len(chosen.parameters) * max(ahead, 1)
    samples = sum(len(log.sampling.rows) for log in logs)
    kept = sum(fitted_samples(log) for log in logs)
    if kept < least:
        which = str(logs[0].log.path) if len(logs) == 1 else f"the {len(logs)} logs together"
        raise ExperimentError(
            f"{which}: {samples} samples, of which {samples - kept} are held back, are too few: to tune {len(chosen.parameters)} numbers "
            f"{'' if ahead < 2 else f'by the error {ahead} samples ahead '}takes {least} besides"
        )


def _warnings(chosen: Plan, after: Mapping[str, float], deviations: Mapping[str, float], held_back: Part) -> list[str]:
    found = []
    for p in chosen.parameters:
        value = after[p.name]
        if math.log(value / p.least) < EDGE:
            found.append(f"{p.name} went to the lower end of its range, {p.least:.3g}: 0 may do as well")
        elif math.log(p.most / value) < EDGE:
            found.append(f"{p.name} went to the upper end of its range, {p.most:.3g}: the model may be wrong there")
        elif deviations[p.name] > OPEN:
            found.append(f"{p.name} is not determined by the data: other values explain them as well as {value:.3g}")
    if held_back.after.value < held_back.before.value:
        found.append(
            "the part that was held back is explained worse than before: the log may be too short, or not all of one kind"
        )
    return found
