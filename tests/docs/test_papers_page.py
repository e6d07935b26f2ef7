"""Each number on the page of the papers' claims is what the project computes, to the digits that stand there."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import claims_of_gong
import claims_of_others
import pytest
from claims import CLAIMS, GONG, NIKOUKHAH, ROWS, Claim, Runs

from cosim.results import Result
from said import check
from tools import ROOT

KEPT = (claims_of_gong, claims_of_others)  # which fill CLAIMS
# Numbers that other tests hold, and times, which a benchmark measures and no test.
ELSEWHERE = {
    (GONG, "Problem 3 makes an iteration 1.4 times as long"): "benchmarks/windows.py",
    (NIKOUKHAH, "BDF of order k (Theorem 4.1)"): "tests/observers/canonical_dae/test_canonical_dae.py",
    (NIKOUKHAH, "Example 2.3's response (2.66)"): "tests/observers/canonical_dae/test_canonical_dae_examples.py",
}


@pytest.fixture
def runs(example: Callable[..., Result], catalogue_system: Callable[[str], Path], tmp_path: Path) -> Runs:
    return Runs(example, catalogue_system, tmp_path)


def test_every_number_of_the_page_is_held_by_a_test() -> None:
    held = {param.values[0].row for param in CLAIMS} | set(ELSEWHERE)
    assert held == {row for row, cells in ROWS.items() if re.search(r"\d", cells[-1])}
    assert all((ROOT / path).is_file() for path in ELSEWHERE.values())


@pytest.mark.parametrize("claim", CLAIMS)
def test_what_is_said_to_be_measured_is(claim: Claim, runs: Runs) -> None:
    check(ROWS[claim.row][-1], claim.words, claim.compute(runs), claim.rel)
