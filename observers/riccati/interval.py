"""Bounds of CasADi expressions over boxes, by interval arithmetic: rigorous, and finite over an unbounded box where the function is.

Ball arithmetic (Arb, by python-flint) evaluates the expression graph's operations one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from flint import arb


class IntervalError(ValueError):
    """An operation that interval arithmetic does not know."""


@dataclass(frozen=True)
class Range:
    """A matrix that is somewhere in middle +- radius, entrywise; infinite radii where there is no bound."""

    middle: np.ndarray
    radius: np.ndarray


def interval(low: float, high: float) -> arb:
    """A ball that holds [low, high]; all numbers where one of them is infinite."""
    return arb(low).union(arb(high)) if np.isfinite(low) and np.isfinite(high) else arb(0, float("inf"))


def ranges(function: ca.Function, box: Sequence[Sequence[arb]]) -> list[Range]:
    """The ranges of the results of an SX function over a box, one list of intervals for each argument.

    Raises:
        IntervalError: the function has an operation that is not in the tables below.
    """
    work: list[Any] = [None] * function.sz_w()
    results: list[Any] = [np.full(function.nnz_out(i), arb(0), dtype=object) for i in range(function.n_out())]
    for k in range(function.n_instructions()):
        code, inputs, outputs = (
            function.instruction_id(k),
            function.instruction_input(k),
            function.instruction_output(k),
        )
        if code == ca.OP_CONST:
            work[outputs[0]] = arb(function.instruction_constant(k))
        elif code == ca.OP_INPUT:
            work[outputs[0]] = box[inputs[0]][inputs[1]]
        elif code == ca.OP_OUTPUT:
            results[outputs[0]][outputs[1]] = work[inputs[0]]
        elif code in _OPERATIONS:
            work[outputs[0]] = _OPERATIONS[code](*[work[i] for i in inputs])
        else:
            raise IntervalError(f"no interval arithmetic is known for CasADi's operation {_name(code)}")
    return [_range(function.sparsity_out(i), values) for i, values in enumerate(results)]


def _name(code: int) -> str:
    return next(name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == code)


def _range(pattern: ca.Sparsity, values: np.ndarray) -> Range:
    middle, radius = np.zeros(pattern.shape), np.zeros(pattern.shape)
    rows, columns = pattern.get_triplet()
    for i, j, value in zip(rows, columns, values, strict=True):
        known = value.is_finite()
        middle[i, j] = float(value.mid()) if known else 0.0
        radius[i, j] = float(value.rad()) if known else np.inf
    return Range(middle, radius)


def _square(x: arb) -> arb:
    return (x.abs_lower() ** 2).union(x.abs_upper() ** 2) if x.is_finite() else x


def _power(x: arb, y: arb) -> arb:
    if not y.is_integer():
        return (x.log() * y).exp()
    count = int(float(y.mid()))
    if count < 0:
        return 1 / _power(x, -y)
    return _square(x) ** (count // 2) * (x if count % 2 else arb(1))


def _either(*_: arb) -> arb:
    """What a comparison gives: 0 or 1."""
    return arb(0).union(arb(1))


_OPERATIONS: dict[int, Callable[..., arb]] = {
    ca.OP_ADD: lambda x, y: x + y,
    ca.OP_SUB: lambda x, y: x - y,
    ca.OP_MUL: lambda x, y: x * y,
    ca.OP_DIV: lambda x, y: x / y,
    ca.OP_NEG: lambda x: -x,
    ca.OP_INV: lambda x: 1 / x,
    ca.OP_TWICE: lambda x: x + x,
    ca.OP_SQ: _square,
    ca.OP_SQRT: lambda x: x.sqrt(),
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_EXP: lambda x: x.exp(),
    ca.OP_LOG: lambda x: x.log(),
    ca.OP_SIN: lambda x: x.sin(),
    ca.OP_COS: lambda x: x.cos(),
    ca.OP_TAN: lambda x: x.tan(),
    ca.OP_ATAN: lambda x: x.atan(),
    ca.OP_TANH: lambda x: x.tanh(),
    ca.OP_SINH: lambda x: x.sinh(),
    ca.OP_COSH: lambda x: x.cosh(),
    ca.OP_FABS: lambda x: x.abs_lower().union(x.abs_upper()) if x.is_finite() else x,
    ca.OP_FMIN: lambda x, y: x.union(y),
    ca.OP_FMAX: lambda x, y: x.union(y),
    ca.OP_SIGN: lambda x: arb(-1).union(arb(1)),
    ca.OP_IF_ELSE_ZERO: lambda condition, x: x.union(arb(0)),
    ca.OP_LT: _either,
    ca.OP_LE: _either,
    ca.OP_EQ: _either,
    ca.OP_NE: _either,
    ca.OP_NOT: _either,
    ca.OP_AND: _either,
    ca.OP_OR: _either,
}
