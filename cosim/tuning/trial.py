"""An observer FMU over all logs with one set of noises: what its innovations are, and what they are worth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from fmpy.model_description import ModelDescription

from cosim.errors import ExperimentError
from cosim.fmu import Value
from cosim.master.repeated import Kept, Repeated
from cosim.master.repetition import Detour
from cosim.master.slave import RunError
from cosim.replay.replay import ELEMENT, Connected
from cosim.replay.signals import VALID
from cosim.results import Result
from cosim.tuning.innovations import Innovations, concentrated, joined, log_likelihood

INNOVATION, STD, CORRELATION = (
    "diagnostics.innovation",
    "diagnostics.innovation_std.",
    "diagnostics.innovation_correlation",
)
HELD_BACK = 0.25  # of each log, its end
START = 0.1  # of each log, which does not count where the error ahead is asked: it tells of the guess


@dataclass(frozen=True)
class Judged:
    """What a set of noises is worth on a part of the logs.

    Attributes:
        value: log-likelihood of the innovations, or what stands for it (`concentrated`).
        samples: of how many measurements.
        rms: of the error ahead, by output; empty where the likelihood counts.
        innovations: one sample ahead.
    """

    value: float
    samples: int
    rms: Mapping[str, float]
    innovations: Innovations


class Trials:
    """All logs, loaded with an FMU.

    Args:
        repeated: keeps them.
        logs: what `cosim.replay.replay.connected` made of each.
        settings: start values that all trials share.
        ahead: how many samples ahead the error counts; 0: the likelihood.

    Raises:
        ExperimentError: the FMU shows no innovation, or cannot save its state though `ahead` is more than 1.
    """

    def __init__(self, repeated: Repeated, logs: Sequence[Connected], settings: Mapping[str, Value], ahead: int):
        self._repeated, self._logs, self._ahead = repeated, logs, ahead
        self.outputs = outputs_of(logs[0].description)
        overrides = {f"{ELEMENT}.{name}": value for name, value in settings.items()}
        self._kept: list[Kept] = []
        for log in logs:
            fed = {f"{ELEMENT}.{name}": values for name, values in log.fed.items()}
            self._kept.append(repeated.load(log.system, overrides, fed, self._detour(log) if ahead > 1 else None))

    def _detour(self, log: Connected) -> Detour:
        """Nothing is measured for so many samples but at the last: its innovation is the error that many ahead."""
        rows = len(log.sampling.rows) + 1
        last = np.arange(rows) % self._ahead == self._ahead - 1
        return Detour(
            self._ahead,
            {f"{ELEMENT}.{VALID}{name}": last & _there(log, name, rows) for name in self.outputs},
        )

    def value(self, noises: Mapping[str, float]) -> float:
        """What `noises` are worth on what is not held back; -inf where the FMU fails.

        Raises:
            RunError: it ended the process, or did not return.
        """
        try:
            return self.judged(noises, held_back=False).value
        except RunError:
            if not self._repeated.alive:
                raise
            return -math.inf

    def judged(self, noises: Mapping[str, float], held_back: bool) -> Judged:
        """What `noises` are worth on what is held back, or on the rest.

        Raises:
            RunError: the FMU failed.
        """
        overrides = {f"{ELEMENT}.{name}": value for name, value in noises.items()}
        parts, errors = [], []
        for log, kept in zip(self._logs, self._kept, strict=True):
            count, fitted = len(log.sampling.rows), fitted_samples(log)
            result = kept.run(overrides, count if held_back else fitted)
            rows = slice(fitted, count) if held_back else slice(0, fitted)
            parts.append(self._innovations(log, result).part(rows))
            if self._ahead:
                errors.append(self._errors(log, kept, parts[-1] if self._ahead == 1 else None, rows))
        innovations = joined(parts)
        if not self._ahead:
            samples = int(np.isfinite(innovations.nu).sum())
            return Judged(sum(log_likelihood(part) for part in parts), samples, {}, innovations)
        together = np.concatenate(errors)
        with np.errstate(invalid="ignore"):
            rms = np.sqrt(np.nanmean(together**2, axis=0))
        return Judged(
            concentrated(together),
            int(np.isfinite(together).sum()),
            dict(zip(self.outputs, rms.tolist(), strict=True)),
            innovations,
        )

    def _innovations(self, log: Connected, result: Result) -> Innovations:
        """Row k of the record shows the innovation of the sample before it."""
        m, n = len(self.outputs), len(result.time) - 1
        nu = np.column_stack(
            [
                np.where(_there(log, name, n), result[f"{ELEMENT}.{_innovation(i, m)}"][1:], np.nan)
                for i, name in enumerate(self.outputs)
            ]
        )
        if not has_covariance(log.description):
            return Innovations(nu, None)
        std = np.column_stack([result[f"{ELEMENT}.{STD}{name}"][1:] for name in self.outputs])
        S = std[:, :, None] * std[:, None, :]
        for i in range(m):
            for j in range(i):
                S[:, i, j] *= result[f"{ELEMENT}.{CORRELATION}[{i + 1},{j + 1}]"][1:]
                S[:, j, i] = S[:, i, j]
        return Innovations(nu, S)

    def _errors(self, log: Connected, kept: Kept, one: Innovations | None, rows: slice) -> np.ndarray:
        """The errors ahead, (count, m), of predictions within `rows`; `one`, the innovations there, where one sample ahead counts."""
        begin = max(rows.start, round(START * len(log.sampling.rows)))
        if one is not None:
            return one.nu[begin - rows.start :]
        m = len(self.outputs)
        last = np.arange(self._ahead - 1, rows.stop, self._ahead)
        wanted = last[last - self._ahead + 1 >= begin]
        return np.column_stack(
            [
                np.where(
                    _there(log, name, rows.stop)[wanted],
                    kept.ends(f"{ELEMENT}.{_innovation(i, m)}")[wanted // self._ahead],
                    np.nan,
                )
                for i, name in enumerate(self.outputs)
            ]
        )


def has_covariance(description: ModelDescription) -> bool:
    """Does the FMU say how large it believes its innovations to be?"""
    return any(v.name.startswith(STD) for v in description.modelVariables)


def outputs_of(description: ModelDescription) -> list[str]:
    """The names of what an observer FMU measures, in the order of its innovations.

    Raises:
        ExperimentError: it shows no innovation of them.
    """
    names = [v.name for v in description.modelVariables]
    measured = [name.removeprefix(VALID) for name in names if name.startswith(VALID)]
    missing = [i for i in range(len(measured)) if _innovation(i, len(measured)) not in names]
    if not measured or missing:
        raise ExperimentError(
            f"{description.modelName} is no observer that can be tuned: it shows no {INNOVATION} of inputs with a {VALID}<name>"
        )
    return measured


def _innovation(i: int, m: int) -> str:
    return f"{INNOVATION}[{i + 1}]" if m > 1 else INNOVATION


def fitted_samples(log: Connected) -> int:
    """How many samples of a log are not held back."""
    return len(log.sampling.rows) - round(HELD_BACK * len(log.sampling.rows))


def _there(log: Connected, name: str, rows: int) -> np.ndarray:
    """At which of the first rows (rows,) the measurement `name` counts."""
    found = np.isfinite(log.fed[name][:rows]) if name in log.fed else np.ones(rows, dtype=bool)
    flag = log.fed.get(f"{VALID}{name}")
    return found if flag is None else found & (flag[:rows] > 0.5)
