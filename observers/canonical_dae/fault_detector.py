"""A threshold with persistence on residuals: what turns lambda into a statement about a fault.

The detector arms itself when the residual has stayed below the threshold for a settling time: an observer's first transient is no fault.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from observers.component import Enumeration, Port

FAULT = Enumeration(
    "FaultDetector",
    (
        ("settling", "not armed yet: the residual has not stayed below the threshold for the settling time"),
        ("quiet", "armed, the residual lies below the threshold"),
        ("suspected", "the residual exceeds the threshold, but not yet for the persistence time"),
        (
            "detected",
            "the residual has exceeded the threshold for the persistence time; back to quiet after the settling time",
        ),
    ),
)
SETTLING, QUIET, SUSPECTED, DETECTED = 1, 2, 3, 4

SETTLED = 5.0  # times the design's slowest time constant
SHORTEST, PERSISTENT = 20, 5  # samples
SETTINGS = 3  # threshold, persistence, settling: what `tuning` makes


def tuning(rate: float, sample_time: float) -> tuple[Port, ...]:
    """`tuning.fault_*`, start values by the rate [1/s] at which the slowest error decays and the sample time [s]."""
    return (
        Port(
            "tuning.fault_threshold",
            "largest |lambda[i]| / nominal of output i without a fault",
            start=0.01,
            min=0.0,
            variability="tunable",
        ),
        Port(
            "tuning.fault_persistence",
            "how long the threshold is exceeded until a fault is detected",
            "s",
            PERSISTENT * sample_time,
            min=0.0,
            variability="tunable",
        ),
        Port(
            "tuning.fault_settling",
            "how long the residual stays below the threshold until the detector is armed, or a fault is over",
            "s",
            max(SETTLED / rate, SHORTEST * sample_time),
            min=0.0,
            variability="tunable",
        ),
    )


PORT = Port(
    "diagnostics.fault", "fault detector", kind="Enumeration", start=SETTLING, enumeration=FAULT, variability="discrete"
)


def detect(
    state: Any, above: Any, below: Any, size: Any, threshold: Any, persistence: Any, settling: Any, Ts: Any
) -> Any:
    """(state, time above, time below) after a sample with the residual `size`; times [s] in a row up to this sample."""
    over = size > threshold
    above = ca.if_else(over, above + Ts, 0)
    below = ca.if_else(over, 0, below + Ts)
    slack = 1e-6 * Ts
    quiet = below >= settling - slack
    held = ca.logic_and(over, above >= persistence - slack)
    armed = state > SETTLING
    following = ca.if_else(over, ca.if_else(held, DETECTED, SUSPECTED), QUIET)
    stays = ca.logic_and(state == DETECTED, ca.logic_not(quiet))
    state = ca.if_else(armed, ca.if_else(stays, DETECTED, following), ca.if_else(quiet, QUIET, SETTLING))
    return state, above, below
