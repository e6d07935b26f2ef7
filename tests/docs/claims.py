"""What the page of the papers' claims says was measured: a registry of what computes it, and what the computations share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from cosim.results import Result
from said import rows_of
from tools import ROOT

GONG, JAMES, CHEN, NIKOUKHAH, CALVILLO = (
    "Gong, Ross & Kang 2007: the pseudospectral observer",
    "James & Baras 1987: the Riccati observer",
    "Chen & Yen 1999: the least-squares observer",
    "Nikoukhah 1995: the canonical DAE observer",
    "Calvillo-Corona & Alamir: elementary problems",
)


class Row(NamedTuple):
    """The cells behind the claim: `place` in the paper, whether it `holds`, what was `measured` and `by` which file of the tests."""

    place: str
    holds: str
    measured: str
    by: str


ROWS = {
    (heading, claim): Row(*cells)
    for (heading, claim), cells in rows_of(ROOT / "docs" / "papers.md").items()
    if claim != "claim"
}


class Runs(NamedTuple):
    """`example` runs a system of the catalogue, once each; `system` is its file; `folder` is for files."""

    example: Callable[..., Result]
    system: Callable[[str], Path]
    folder: Path


class Claim(NamedTuple):
    """A row, the words of what was measured, {} for each number, what computes these, and how far off they may be besides rounding."""

    row: tuple[str, str]
    words: str
    compute: Callable[[Runs], Any]
    rel: float


CLAIMS: list[Any] = []


def said(heading: str, claim: str, words: str, rel: float = 0.01, long: bool = False) -> Callable:
    def keep(compute: Callable[[Runs], Any]) -> Callable[[Runs], Any]:
        marks = [pytest.mark.long] if long else []
        CLAIMS.append(
            pytest.param(Claim((heading, claim), words, compute, rel), id=f"{heading[:4]} {claim}", marks=marks)
        )
        return compute

    return keep


def gap(result: Result, state: str, kind: str = "estimate") -> np.ndarray:
    return result[f"observer.{kind}.{state}"] - result[f"plant.x.{state}"]


def norm(result: Result, time: float) -> float:
    """|e| of the current estimate at a time."""
    states = [name.removeprefix("observer.estimate.") for name in result.names if "estimate." in name]
    row = int(np.argmin(np.abs(result.time - time)))
    return float(np.linalg.norm([gap(result, s)[row] for s in states]))


def gap_at_samples(result: Result, state: str) -> np.ndarray:
    """Of the estimate at a sample, which is there one row later."""
    return result[f"observer.filtered.{state}"][1:] - result[f"plant.x.{state}"][:-1]
