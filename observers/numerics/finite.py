"""What still counts as a number: the one limit by which every observer tells a lost computation from a large value."""

from __future__ import annotations

from typing import Any

import casadi as ca

HUGE = 1e150  # beyond: not finite; its square still is a number


# Operations that are not defined, or infinite, for some finite arguments.
PARTIAL = {
    *(ca.OP_LOG, ca.OP_LOG1P, ca.OP_SQRT, ca.OP_DIV, ca.OP_INV, ca.OP_POW, ca.OP_CONSTPOW),
    *(ca.OP_ASIN, ca.OP_ACOS, ca.OP_ACOSH, ca.OP_ATANH, ca.OP_FMOD, ca.OP_REMAINDER),
}


def is_partial(expression: Any) -> bool:
    """Whether a CasADi expression holds an operation that some finite arguments are outside the domain of."""
    function = ca.Function("expression", ca.symvar(expression), [expression])
    return any(function.instruction_id(k) in PARTIAL for k in range(function.n_instructions()))


def finite(value: Any) -> Any:
    """Entry by entry of a CasADi column, whether it is a number that counts: false for NaN and beyond HUGE."""
    return ca.fabs(value) <= HUGE


def kept(value: Any, otherwise: Any) -> Any:
    """`value` where it is finite, else `otherwise`: what an observer shows may be lost, but never ends the run."""
    return ca.if_else(finite(value), value, otherwise)
