"""Whatever an importer calls, in whatever order, with whatever values, times, states and memory: what harness.c checks holds."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from fuzz_fmus import KINDS, fuzz

from tools import need

pytestmark = pytest.mark.long

SECONDS = 42  # for each kind: five minutes in all
CALLS = 1_000_000  # of all kinds together
made: dict[str, int] = {}


@pytest.mark.parametrize("kind", KINDS)
def test_no_run_of_calls_breaks_a_promise_of_the_shell(kind: str, tmp_path: Path) -> None:
    need(shutil.which("clang") is not None, "clang is not installed here: make ci-tools")
    outcome = fuzz(kind, tmp_path, SECONDS)
    assert not outcome.finding, outcome.finding
    made[kind] = outcome.calls


def test_the_fuzzer_made_as_many_calls_as_it_should() -> None:
    need(set(made) == set(KINDS), "not every kind was fuzzed")
    assert sum(made.values()) >= CALLS, made
