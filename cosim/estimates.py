"""Which columns of a result are estimates, and of what: found by the names alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cosim.results import Result


class Pair(NamedTuple):
    """An estimate and the truth it is of: columns `<observer>.estimate.<variable>` and `<plant>.x.<variable>`."""

    variable: str
    estimate: str
    truth: str

    def error(self, result: Result) -> np.ndarray:
        """|estimate - truth|, (n,): both columns are of the same time."""
        return np.abs(result[self.estimate] - result[self.truth])


def pairs(result: Result) -> list[Pair]:
    """Every estimate with every truth of the same variable, in the order of the estimates."""
    truths: dict[str, list[str]] = {}
    for name in result.names:
        _, marker, variable = name.partition(".x.")
        if marker:
            truths.setdefault(variable, []).append(name)
    found: list[Pair] = []
    for name in result.names:
        _, marker, variable = name.partition(".estimate.")
        if marker:
            found.extend(Pair(variable, name, truth) for truth in truths.get(variable, ()))
    return found
