"""A recorded or made signal as a source: columns over time become outputs, held or on straight lines between their rows."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from observers.component import Component, Port
from observers.model import Variable

MOST_NUMBERS = 1_000_000  # rows times two for each signal; they become constants of the C code
BETWEEN = ("held", "linear")
_EARLY = 1e-6  # of the interval before: a step that ends there by rounding has reached the row


@dataclass(frozen=True)
class Signal:
    """What an output follows: `time` (n,) [s], ascending, and `values` (n,) in the unit of the `variable` that names it."""

    variable: Variable
    time: np.ndarray
    values: np.ndarray


def recorded(name: str, signals: tuple[Signal, ...], between: str = "held", *, source: str = "") -> Component:
    """The component whose outputs follow `signals`; no inputs, no state.

    Before the first row an output has the value of its parameter `start.<signal>`, by default that of the first row; after the last
    row it keeps that one's.

    Args:
        name: of the FMU.
        signals: one for each output, each with times of its own.
        between: what holds between two rows: the value of the earlier one ("held"), or the straight line ("linear").
        source: where the rows come from, for the documentation.

    Raises:
        ValueError: no signal, no rows, times that do not ascend, a number that is not finite, more numbers than MOST_NUMBERS.
    """
    if between not in BETWEEN:
        raise ValueError(f"signal '{name}': between = {between!r} must be 'held' or 'linear'")
    if not signals:
        raise ValueError(f"signal '{name}' has no columns")
    for signal in signals:
        _check(name, signal)
    count = sum(2 * len(signal.time) for signal in signals)
    if count > MOST_NUMBERS:
        raise ValueError(
            f"signal '{name}': {count} times and values are more than {MOST_NUMBERS}, which a compiler takes: fewer rows or columns"
        )
    p, t = ca.MX.sym("p", len(signals)), ca.MX.sym("t")
    z, u, h = ca.MX(0, 1), ca.MX.sym("u", 0), ca.MX.sym("h")
    follow = _held if between == "held" else _linear
    followed = [follow(signal, p[i], t) for i, signal in enumerate(signals)]
    z_in = ca.MX.sym("z", 0)
    begin, end = min(s.time[0] for s in signals), max(s.time[-1] for s in signals)
    rows = max(len(signal.time) for signal in signals)
    span = float(end - begin) if end > begin else 1.0
    return Component(
        name=name,
        description=f"Recorded signal: {', '.join(s.variable.name for s in signals)}",
        start=ca.Function("start", [p, t], [z]),
        flow=ca.Function("flow", [z_in, u, p, t, h], [z]),
        output=ca.Function("output", [z_in, u, p, t], [ca.vertcat(*followed)]),
        parameters=tuple(
            _port(f"start.{s.variable.name}", s, f"value before the first row, {s.time[0]:g} s", "fixed")
            for s in signals
        ),
        outputs=tuple(_port(s.variable.name, s, s.variable.description, "continuous") for s in signals),
        stop_time=float(max(end, span)),
        step_size=span / max(rows - 1, 1),
        documentation=(
            f"<p>{rows} rows{f' of {source}' if source else ''} from {begin:g} s to {end:g} s. Between two rows the outputs "
            f"{'keep the value of the earlier one' if between == 'held' else 'lie on the straight line'}; before the first row they "
            "have the value of start.*, after the last one they keep that one's.</p>"
        ),
    )


def _check(name: str, signal: Signal) -> None:
    where = f"signal '{name}', column '{signal.variable.name}'"
    if not len(signal.time):
        raise ValueError(f"{where}: no row has a value")
    for what, numbers in (("time", signal.time), ("value", signal.values)):
        if not np.isfinite(numbers).all():
            raise ValueError(f"{where}: a {what} is not finite, in row {int(np.argmin(np.isfinite(numbers))) + 1}")
    if len(signal.time) > 1 and not (np.diff(signal.time) > 0).all():
        raise ValueError(f"{where}: the times do not ascend")


def _held(signal: Signal, start: ca.MX, t: ca.MX) -> ca.MX:
    intervals = np.diff(signal.time, prepend=signal.time[0] - 1.0)
    grid = signal.time - _EARLY * np.minimum(intervals, 1.0)
    # `low` never gives the last interval of its grid: one more lies behind all times.
    row = ca.low(ca.DM(np.append(grid, 1e300)), t, {"lookup_mode": "binary"})
    return ca.if_else(t < grid[0], start, ca.MX(ca.DM(signal.values))[row])


def _linear(signal: Signal, start: ca.MX, t: ca.MX) -> ca.MX:
    time, values = signal.time, signal.values
    if len(time) == 1:
        return _held(signal, start, t)
    grid, y = ca.MX(ca.DM(time)), ca.MX(ca.DM(values))
    row = ca.low(ca.DM(time), t, {"lookup_mode": "binary"})
    fraction = ca.fmin(ca.fmax((t - grid[row]) / (grid[row + 1] - grid[row]), 0), 1)
    # In this form both ends are exact.
    line = (1 - fraction) * y[row] + fraction * y[row + 1]
    early = _EARLY * min(float(time[1] - time[0]), 1.0)
    return ca.if_else(t < time[0] - early, start, line)


def _port(name: str, signal: Signal, description: str, variability: str) -> Port:
    v = signal.variable
    return Port(name, description, v.unit, float(signal.values[0]), v.nominal, variability=variability)
