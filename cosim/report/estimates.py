"""Which columns of a result are estimates, and of what: found by the names and the connections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from cosim.results import Result

TRUTHS = ("x", "z")  # under which a plant puts out its true states and parameters, and its algebraic variables


class Pair(NamedTuple):
    """An estimate and its truth: columns `<observer>.estimate.<variable>` and `<plant>.x.<variable>` (or `.z.`, algebraic)."""

    variable: str
    estimate: str
    truth: str

    def error(self, result: Result) -> np.ndarray:
        """|estimate - truth|, (n,): both columns are of the same time."""
        return np.abs(result[self.estimate] - result[self.truth])


def pairs(result: Result) -> list[Pair]:
    """Every estimate of `result` with every truth of the same variable in an element that it observes, in the estimates' order."""
    return paired(result.names, result.upstream)


def paired(names: Sequence[str], upstream: Mapping[str, frozenset[str]]) -> list[Pair]:
    """The same among the columns called `names`; `upstream` are the elements that an element observes."""
    truths: dict[str, list[tuple[str, str]]] = {}
    for name in names:
        element, kind, variable = _parts(name)
        if kind in TRUTHS:
            truths.setdefault(variable, []).append((element, name))
    found: list[Pair] = []
    for name in names:
        observer, kind, variable = _parts(name)
        if kind == "estimate":
            seen = (truth for element, truth in truths.get(variable, ()) if element in upstream[observer])
            found.extend(Pair(variable, name, truth) for truth in seen)
    return found


def _parts(name: str) -> tuple[str, str, str]:
    """`plant.x.x1` as (plant, x, x1); empty what is not there."""
    element, _, rest = name.partition(".")
    kind, _, variable = rest.partition(".")
    return element, kind, variable
