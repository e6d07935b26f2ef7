"""Does another motion of the model explain what an observer was silent on? A fit in hindsight of the samples that it had just seen.

The states and unknown parameters of the plant, with its known parameters as the observer has them, are fitted to the last samples of a
stream by scipy's least squares; a sum of squared residuals that chi-square noise reaches is an explanation: no test of these samples can
find that the estimate is wrong.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2

from advice.streams.streams import Stream, slopes_of
from observers.instance import Instance

SAMPLES = 20  # of a fit
LEVEL = 1e-4  # of the chi-square test: what the observers' own tests start with
EVERY = 10  # silent samples of a stretch between two that are looked at


def explained(stream: Stream, estimates: dict[str, np.ndarray], silent: np.ndarray) -> np.ndarray:
    """Which of the `silent` samples (n,) another motion explains; of a stretch of them every tenth is fitted, and speaks for those until
    the next. `estimates` by name, (n,), as read after each sample: where the fits start from.
    """
    found, last = np.zeros_like(silent), -EVERY
    for k in map(int, np.flatnonzero(silent)):
        if k - last >= EVERY:
            last, answer = (
                k,
                _fits(stream, {name: values[max(k - SAMPLES, 0)] for name, values in estimates.items()}, k),
            )
        found[k] = answer
    return found


def _fits(stream: Stream, near: dict[str, float], k: int) -> bool:
    """Whether a motion of the model through the samples k - 19 to k leaves noise only; `near`, its state at the first of them."""
    plant, names = stream.scenario.plant, list(near)
    first = max(k - SAMPLES + 1, 0)
    ports = {port.name for port in plant.parameters}
    set_by = [next(f"{kind}.{name}" for kind in ("start", "parameter") if f"{kind}.{name}" in ports) for name in names]
    seen = np.column_stack([values[first : k + 1] for values in stream.measured.values()])
    noise = np.array([stream.scenario.noise[name] for name in stream.measured])
    scale = np.array([abs(near[name]) or 1.0 for name in names])

    def residual(values: np.ndarray) -> np.ndarray:
        try:
            gap = (_motion(stream, dict(zip(set_by, values * scale, strict=True)), first, k) - seen) / noise
        except ValueError:  # the model escapes from there: far off
            return np.full(np.isfinite(seen).sum(), 1e6)
        return np.clip(gap[np.isfinite(seen)], -1e6, 1e6)

    fit = least_squares(residual, np.array([near[name] for name in names]) / scale, diff_step=1e-5, max_nfev=30)
    dof = max(np.isfinite(seen).sum() - len(names), 1)
    return bool(2 * fit.cost <= chi2.isf(LEVEL, dof))


def _motion(stream: Stream, parameters: dict[str, float], first: int, last: int) -> np.ndarray:
    """The clean outputs (samples, ny) of the plant that is at `parameters` at sample `first`."""
    scenario, Ts = stream.scenario, stream.scenario.sample_time
    defaults = {port.name: port.start for port in scenario.plant.parameters} | dict(scenario.start)
    run = Instance(scenario.plant, defaults | parameters, t0=first * Ts)
    slopes = slopes_of(scenario, stream.inputs)
    rows = []
    for k in range(first, last + 1):
        for name, values in stream.inputs.items():
            run.set(name, values[k])
        rows.append([run.get(name) for name in stream.measured])
        run.step(run.time, Ts, slopes[k])
    return np.array(rows)
