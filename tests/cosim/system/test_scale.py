"""Large systems are read and ordered in linear time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from cosim.errors import SystemFileError
from cosim.master import schedule as module
from cosim.master.schedule import schedule
from cosim.report.estimates import paired
from cosim.system import Element, System
from cosim.system.resolve import resolve

Strict = Callable[..., Path]


def chain(fmu: Path, n: int) -> System:
    """n elements, each driven by the one before, the last one first in the file."""
    elements = {f"e{i}": Element(fmu) for i in reversed(range(n))}
    return System("chain", elements, [(f"e{i}.y", f"e{i + 1}.u") for i in range(n - 1)], stop=1.0, step=0.1)


def counted(monkeypatch: pytest.MonkeyPatch, system: System) -> int:
    """How many edges the graphs get on the way to the schedule."""
    edges = 0

    class Counting(module.nx.DiGraph):
        def add_edges_from(self, found, **attributes):  # type: ignore[no-untyped-def]
            nonlocal edges
            found = list(found)
            edges += len(found)
            super().add_edges_from(found, **attributes)

    with monkeypatch.context() as patched:
        patched.setattr(module.nx, "DiGraph", Counting)
        schedule(resolve(system))
    return edges


@pytest.mark.parametrize("choices", [{}, {"dependencies": False}, {"static": True}])
def test_the_order_of_a_chain_is_found_whatever_order_the_file_has(
    strict: Strict, choices: dict[str, bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    fmu = strict(**choices)
    found = schedule(resolve(chain(fmu, 300)))
    assert found.settling == [f"e{i}" for i in range(300)]
    assert (found.stepping[-1] == "e299") is ("static" in choices)
    assert counted(monkeypatch, chain(fmu, 400)) <= 2 * counted(monkeypatch, chain(fmu, 200)) + 8


def test_a_loop_through_a_thousand_elements_is_found(strict: Strict) -> None:
    system = chain(strict(), 1000)
    with pytest.raises(SystemFileError, match="algebraic loop"):
        schedule(resolve(replace(system, connections=[*system.connections, ("e999.y", "e0.u")])))


def test_estimates_are_paired_over_a_long_chain() -> None:
    sources = {f"e{i}": frozenset({f"e{i - 1}"} if i else ()) for i in range(2000)}
    (pair,) = paired(["e0.x.a", "e1999.estimate.a"], sources)
    assert (pair.truth, pair.estimate) == ("e0.x.a", "e1999.estimate.a")
