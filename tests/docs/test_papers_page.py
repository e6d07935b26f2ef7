"""The page of the papers' claims: no numbered item of a paper lacks a row, no row a test, and each number is what the project computes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import claims_of_gong
import claims_of_others
import pytest
from claims import CALVILLO, CHEN, CLAIMS, GONG, JAMES, NIKOUKHAH, ROWS, Claim, Runs

from cosim.results import Result
from said import check
from tools import ROOT

KEPT = (claims_of_gong, claims_of_others)  # which fill CLAIMS
HERE = "tests/docs"  # in the last column: what the tests below compute
# What the papers number; an equation has no word before it.
NUMBERED = {
    GONG: "(1) to (41), Examples 1 to 6, Figures 1 to 9, Theorems 2.1 to 2.2, Lemmas 2.3 to 2.4, Assumptions 1 to 3, Remarks 1 to 6, "
    "Problems 1 to 3",
    JAMES: "(1.1) to (1.3), (2.1) to (2.8), (3.1) to (3.14), (4.1), (5.1) to (5.4), Theorem 2.1, Theorem 3.1, Corollary 2.1, "
    "Corollary 3.1, Lemma 3.1, Examples 5.1 to 5.2",
    CHEN: "(1) to (22), Definitions 1 to 2, Remarks 1 to 2, Figures 1 to 2, claims 1 to 4",
    NIKOUKHAH: "(1.1) to (1.3), (2.1) to (2.66), (3.1) to (3.30), (4.1) to (4.5), (5.1) to (5.7), Lemmas 2.1 to 2.2, Lemmas 3.1 to 3.2, "
    "Lemma 4.1, Theorem 2.1, Theorems 3.1 to 3.2, Theorem 4.1, Corollary 2.1, Corollary 3.1, Examples 2.1 to 2.3, Figures 1 to 4, "
    "Definition 3.1, Definition 4.1",
    CALVILLO: "(1) to (11), Figures 1 to 10",
}
WORDS = r"Example|Figure|Theorem|Lemma|Corollary|Definition|Assumption|Remark|Problem|claim"
NUMBER = r"((?:\d+\.)?\d+)"
EQUATIONS = re.compile(rf"\({NUMBER}\)(?: to \({NUMBER}\))?")
OTHERS = re.compile(rf"(?:({WORDS})s? )?{NUMBER}(?: to {NUMBER})?")


def items(text: str) -> Iterator[str]:
    """ "Lemmas 2.3, 2.4, (25) to (27)" as Lemma 2.3, Lemma 2.4, (25), (26), (27); whatever else stands there is passed over."""
    word = ""
    for piece in text.split(", "):
        equation, other = EQUATIONS.fullmatch(piece), OTHERS.fullmatch(piece)
        word = "" if other is None else other[1] or word
        match = equation or (other if word else None)
        if match is None:
            continue
        start, end = match.groups()[-2:]
        *section, first = start.split(".")
        for number in range(int(first), int((end or start).split(".")[-1]) + 1):
            name = ".".join([*section, str(number)])
            yield f"({name})" if equation else f"{word} {name}"


@pytest.fixture
def runs(example: Callable[..., Result], catalogue_system: Callable[[str], Path], tmp_path: Path) -> Runs:
    return Runs(example, catalogue_system, tmp_path)


@pytest.mark.parametrize("paper", NUMBERED)
def test_every_numbered_item_of_a_paper_stands_in_a_row(paper: str) -> None:
    found = {item for (heading, _), row in ROWS.items() if heading == paper for item in items(row.place)}
    assert set(items(NUMBERED[paper])) - found == set()
    assert found - set(items(NUMBERED[paper])) == set()


def test_every_row_is_held_by_a_test_and_every_number_of_the_page_too() -> None:
    assert {param.values[0].row for param in CLAIMS} == {name for name, row in ROWS.items() if row.by == HERE}
    for name, row in ROWS.items():
        assert row.holds and row.measured, name
        assert row.by == HERE or (ROOT / row.by).is_file(), name


@pytest.mark.parametrize("claim", CLAIMS)
def test_what_is_said_to_be_measured_is(claim: Claim, runs: Runs) -> None:
    check(ROWS[claim.row].measured, claim.words, claim.compute(runs), claim.rel)
