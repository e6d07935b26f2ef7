"""What still counts as a number: the one limit by which every observer tells a lost computation from a large value."""

from __future__ import annotations

from typing import Any

import casadi as ca

HUGE = 1e150  # beyond: not finite; its square still is a number


def finite(value: Any) -> Any:
    """Entry by entry of a CasADi column, whether it is a number that counts: false for NaN and beyond HUGE."""
    return ca.fabs(value) <= HUGE


def kept(value: Any, otherwise: Any) -> Any:
    """`value` where it is finite, else `otherwise`: what an observer shows may be lost, but never ends the run."""
    return ca.if_else(finite(value), value, otherwise)
