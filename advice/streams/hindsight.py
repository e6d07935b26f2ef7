"""Does another motion of the model explain what an observer was silent on? A fit in hindsight of the samples that it had just seen.

The states and unknown parameters of the plant, with its known parameters as the observer has them, are fitted to the last samples of a
stream by scipy's least squares; a sum of squared residuals that chi-square noise reaches is an explanation: no test of these samples can
find that the estimate is wrong.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2

from advice.streams.motion import Motion
from advice.streams.streams import Stream

SAMPLES = 20  # of a fit
LEVEL = 1e-4  # of the chi-square test: what the observers' own tests start with
EVERY = 10  # silent samples of a stretch between two that are looked at


def explained(stream: Stream, estimates: dict[str, np.ndarray], silent: np.ndarray) -> np.ndarray:
    """Which of the `silent` samples (n,) another motion explains; of a stretch of them every tenth is fitted, and speaks for those until
    the next. `estimates` by name, (n,), as read after each sample: where the fits start from.
    """
    found, last, answer = np.zeros_like(silent), -EVERY, False
    if not silent.any():
        return found
    scenario = stream.scenario
    motion = Motion(scenario.plant, scenario.sample_time, scenario.linear, scenario.start)
    for k in map(int, np.flatnonzero(silent)):
        if k - last >= EVERY:
            last, answer = (
                k,
                _fits(stream, motion, {n: values[max(k - SAMPLES, 0)] for n, values in estimates.items()}, k),
            )
        found[k] = answer
    return found


def _fits(stream: Stream, motion: Motion, near: dict[str, float], k: int) -> bool:
    """Whether a motion of the model through the samples k - 19 to k leaves noise only; `near`, its state at the first of them."""
    first, scenario = max(k - SAMPLES + 1, 0), stream.scenario
    seen = np.column_stack([values[first : k + 1] for values in stream.measured.values()])
    noise = np.array([scenario.noise[name] for name in stream.measured])
    inputs = motion.inputs(stream.inputs, scenario.samples)[first : k + 1]
    fitted = np.array([name in near for name in motion.estimated])
    # What the observer does not estimate is as it is.
    at = np.array([near.get(name, stream.truth[f"x.{name}"][first]) for name in motion.estimated])
    scale = np.where(at == 0, 1.0, np.abs(at))

    def residual(values: np.ndarray) -> np.ndarray:
        begun = np.where(fitted, scale, at)
        begun[fitted] *= values
        gap = (motion.outputs(begun, inputs, first * scenario.sample_time) - seen) / noise
        # Where the model escapes from there: far off.
        return np.clip(np.nan_to_num(gap[np.isfinite(seen)], nan=1e6), -1e6, 1e6)

    fit = least_squares(residual, (at / scale)[fitted], diff_step=1e-5, max_nfev=30)
    dof = max(np.isfinite(seen).sum() - np.count_nonzero(fitted), 1)
    return bool(2 * fit.cost <= chi2.isf(LEVEL, dof))
