"""The covariance S of a filter's innovation as outputs: standard deviations and, of several outputs, correlations.

It is what the tuning says, whatever scale the filter has learned: with the innovation it gives the likelihood of a sample.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca

from observers import units
from observers.component import Port
from observers.model import Model
from observers.numerics.finite import HUGE

TINY = 1e-300  # so that nothing is divided by 0


def innovation_covariance(model: Model) -> tuple[Port, ...]:
    """`diagnostics.innovation_std.<output>`, then, of several outputs, `diagnostics.innovation_correlation[i,j]` for j < i."""
    outputs = model.outputs
    return (
        *(
            Port(
                f"diagnostics.innovation_std.{v.name}",
                f"standard deviation that the tuning gives the innovation of {v.description or v.name}",
                units.difference(v.unit),
                nominal=v.nominal,
                variability="discrete",
            )
            for v in outputs
        ),
        *(
            Port(
                f"diagnostics.innovation_correlation[{i + 1},{j + 1}]",
                f"correlation that the tuning gives the innovations of {outputs[i].name} and {outputs[j].name}",
                variability="discrete",
            )
            for i, j in _pairs(len(outputs))
        ),
    )


def size(ny: int) -> int:
    """The number of these outputs."""
    return ny * (ny + 1) // 2


def spread(variances: Any, covariance: Callable[[int, int], Any]) -> Any:
    """Their values for S with the diagonal `variances` (ny) and, beside it, `covariance(i, j)`."""
    std = ca.sqrt(ca.fmin(ca.fmax(variances, 0), HUGE))
    correlations = [covariance(i, j) / ca.fmax(std[i] * std[j], TINY) for i, j in _pairs(variances.numel())]
    return ca.vertcat(std, *[ca.fmin(ca.fmax(r, -1), 1) for r in correlations])


def _pairs(n: int) -> list[tuple[int, int]]:
    return [(i, j) for i in range(n) for j in range(i)]
