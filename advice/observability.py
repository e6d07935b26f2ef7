"""What the outputs tell of states and unknown parameters along trajectories: empirical observability Gramians.

Over a window from t_0 on, in units of nominal values m_i and of the noise sigma (Krener & Ide, "Measures of unobservability", CDC 2009):

    G = sum_k S_k' S_k,   S_k = (y(t_k; m + d m_i e_i) - y(t_k; m - d m_i e_i)) / (2 d sigma)

1 / sqrt of its smallest eigenvalue is the standard deviation, in nominal values, with which the window determines the worst direction: the
eigenvector.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from advice.streams.corruptions import CLEAN
from advice.streams.motion import Motion
from advice.streams.streams import Stream, Streams
from observers.model import Model, Variable
from observers.ports import DEVIATION_LIMIT

STEP = 1e-3  # d, of a nominal value
DETERMINED = DEVIATION_LIMIT.start  # nominal values: what an observer calls certain
LONGEST = 3  # parts of a stream, each of which should determine everything
NAMED = 0.1  # of a direction's largest entry: what is named of it
STILL = 0.05  # of the largest range within a window: what moves less is constant
MOSTLY = 0.9  # of the windows


@dataclass(frozen=True)
class Window:
    """`gramians` (n, d, d): those of the first k + 1 samples; `moved`: by how much each state and input moves in it, by name."""

    gramians: np.ndarray
    moved: dict[str, float]

    def deviation(self, samples: int) -> float:
        """Standard deviation of the worst direction after so many samples, in nominal values."""
        return deviation(self.gramians[samples - 1])

    @property
    def determines_after(self) -> int | None:
        """Samples after which every direction is determined."""
        enough = [k for k, G in enumerate(self.gramians, start=1) if deviation(G) <= DETERMINED]
        return enough[0] if enough else None


@dataclass(frozen=True)
class Observability:
    """`window`: samples after which nearly all windows determine everything, None where they do not; `worst`: the standard deviation of the
    worst direction over a long window, in nominal values (median); `said`: what cannot be told apart, a sentence each.
    """

    window: int | None
    worst: float
    said: tuple[str, ...]


def deviation(gramian: np.ndarray) -> float:
    """1 / sqrt of the smallest eigenvalue."""
    smallest = float(np.linalg.eigvalsh(gramian)[0])
    largest = float(np.linalg.eigvalsh(gramian)[-1])
    return 1 / np.sqrt(smallest) if smallest > np.finfo(float).eps * len(gramian) * largest > 0 else float("inf")


def gramians(
    motion: Motion, scales: np.ndarray, noise: np.ndarray, at: np.ndarray, inputs: np.ndarray, t0: float
) -> np.ndarray:
    """Empirical Gramians (n, d, d) of the first 1, ..., n samples, from the states and unknown parameters `at` (d) at t0 [s] on.

    `scales` (d): nominal values; `noise` (ny): standard deviations; `inputs` (n, inputs).
    """
    ends = []
    for i, scale in enumerate(scales):
        step = np.where(np.arange(len(at)) == i, STEP * scale, 0.0)
        ends.append(motion.outputs(at + step, inputs, t0) - motion.outputs(at - step, inputs, t0))
    S = np.stack(ends, axis=2) / (2 * STEP * noise[None, :, None])
    S = np.nan_to_num(S, posinf=0.0, neginf=0.0)  # a step out of the equations' domain tells nothing
    return np.asarray(np.cumsum(np.einsum("kyi,kyj->kij", S, S), axis=0))


def observability(model: Model, motion: Motion, streams: Mapping[int, Streams]) -> Observability:
    """The judgement over the clean streams, by seed."""
    clean = [made.stream(CLEAN, seed) for seed, made in streams.items()]
    samples = clean[0].scenario.samples
    length = samples // LONGEST
    long = [_window(model, motion, stream, k * length, length) for stream in clean for k in range(LONGEST)]
    after = [window.determines_after for window in long]
    known = [count for count in after if count is not None]
    enough = len(known) >= MOSTLY * len(long)
    worst = float(np.median([window.deviation(length) for window in long]))
    if not enough:
        blind = [w.gramians[-1] for w, count in zip(long, after, strict=True) if count is None]
        share = len(blind) / len(long)
        said = _while(model, long, length) or [_apart(model, blind, share)]
        return Observability(None, worst, tuple(said))
    window = int(np.quantile(known, MOSTLY))
    shorter = max(window, 2)
    short = [
        _window(model, motion, stream, first, shorter)
        for stream in clean
        for first in range(0, samples - shorter, max(shorter, samples // 20))
    ]
    return Observability(window, worst, tuple(_while(model, short, shorter)))


def _window(model: Model, motion: Motion, stream: Stream, first: int, length: int) -> Window:
    variables = (*model.states, *model.unknown_parameters)
    at = np.array([stream.truth[f"x.{name}"][first] for name in motion.estimated])
    inputs = motion.inputs(stream.inputs, stream.scenario.samples)[first : first + length]
    noise = np.array([stream.scenario.noise[v.name] for v in model.outputs])
    scales = np.array([v.nominal for v in variables])
    found = gramians(motion, scales, noise, at, inputs, first * stream.scenario.sample_time)
    moved = {v.name: float(np.ptp(stream.truth[f"x.{v.name}"][first : first + length])) for v in model.states}
    moved |= {name: float(np.ptp(column)) for name, column in zip(motion.driven, inputs.T, strict=True)}
    return Window(found, moved)


def _apart(model: Model, blind: Sequence[np.ndarray], share: float) -> str:
    """What the outputs do not determine, in a sentence; `share` of the windows say so."""
    variables = (*model.states, *model.unknown_parameters)
    names = named(_direction(blind), variables)
    where = "" if share > MOSTLY else f" over {share:.0%} of the time"
    return f"{told(names)}{where}"


def _direction(blind: Sequence[np.ndarray]) -> np.ndarray:
    """The direction that the windows together determine least, each counted alike."""
    return np.asarray(np.linalg.eigh(sum(G / np.trace(G) for G in blind))[1][:, 0])


def named(direction: np.ndarray, variables: Sequence[Variable]) -> list[str]:
    """The variables that make up most of a direction."""
    part = np.abs(direction) / np.abs(direction).max()
    return [v.name for v, size in zip(variables, part, strict=True) if size >= NAMED]


def told(names: Sequence[str]) -> str:
    """What is wrong with a direction, by names."""
    if len(names) == 1:
        return f"{names[0]} is not determined by the outputs"
    return f"{', '.join(names[:-1])} and {names[-1]} cannot be told apart"


def _while(model: Model, windows: Sequence[Window], samples: int) -> list[str]:
    """What cannot be told apart while something is constant: in nearly all windows where it is, and in few others."""
    bad = [w for w in windows if not w.deviation(samples) <= DETERMINED]
    good = [w for w in windows if w.deviation(samples) <= DETERMINED]
    if not bad or not good:
        return []
    for name in windows[0].moved:
        still = STILL * max(w.moved[name] for w in windows)
        explained = np.mean([w.moved[name] <= still for w in bad])
        elsewhere = np.mean([w.moved[name] <= still for w in good])
        if still > 0 and explained >= MOSTLY and elsewhere <= 1 - MOSTLY:
            names = named(
                _direction([w.gramians[samples - 1] for w in bad]), (*model.states, *model.unknown_parameters)
            )
            return [f"{told(names)} while {name} is constant"]
    return []
