"""Which columns of a result are estimates, and of what: found by the names alone."""

from __future__ import annotations

from collections.abc import Sequence
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
    """Every estimate of `result` with every truth of the same variable, in the order of the estimates."""
    return paired(result.names)


def paired(names: Sequence[str]) -> list[Pair]:
    """The same among the columns called `names`."""
    truths: dict[str, list[str]] = {}
    for name in names:
        _, marker, variable = name.partition(".x.")
        if marker:
            truths.setdefault(variable, []).append(name)
    found: list[Pair] = []
    for name in names:
        _, marker, variable = name.partition(".estimate.")
        if marker:
            found.extend(Pair(variable, name, truth) for truth in truths.get(variable, ()))
    return found
