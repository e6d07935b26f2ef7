"""Which columns of a result are estimates, and of what: found by the names and the connections."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from cosim.results import Result
from cosim.system.system import element_of

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
    return paired(result.names, result.sources)


def paired(names: Sequence[str], sources: Mapping[str, frozenset[str]]) -> list[Pair]:
    """The same among the columns called `names`; `sources` are the elements that drive an element's inputs."""
    truths: dict[str, list[tuple[str, str]]] = {}
    parts = {name: _parts(name, sources) for name in names}
    for name, (element, kind, variable) in parts.items():
        if kind in TRUTHS:
            truths.setdefault(variable, []).append((element, name))
    found: list[Pair] = []
    observed: dict[str, set[str]] = {}
    for name, (observer, kind, variable) in parts.items():
        if kind == "estimate":
            if observer not in observed:
                observed[observer] = _upstream(observer, sources)
            seen = (truth for element, truth in truths.get(variable, ()) if element in observed[observer])
            found.extend(Pair(variable, name, truth) for truth in seen)
    return found


def _upstream(element: str, sources: Mapping[str, frozenset[str]]) -> set[str]:
    """The elements whose outputs reach the inputs of `element`, directly or through others."""
    found: set[str] = set()
    waiting = [*sources[element]]
    while waiting:
        source = waiting.pop()
        if source not in found:
            found.add(source)
            waiting.extend(sources.get(source, ()))
    return found


def _parts(name: str, elements: Collection[str]) -> tuple[str, str, str]:
    """`plant.x.x1` as (plant, x, x1); empty what is not there."""
    element = element_of(name, elements)
    if element is None:
        return "", "", ""
    kind, _, variable = name[len(element) + 1 :].partition(".")
    return element, kind, variable
