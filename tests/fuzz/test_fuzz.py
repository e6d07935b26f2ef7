"""Whatever an importer calls, in whatever order, with whatever values, times, states and memory: what harness.c checks holds."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import pytest
from fuzz_fmus import KINDS, fuzz

from tools import need

pytestmark = pytest.mark.long

SECONDS = 5  # for each kind; `make fuzz` takes longer
CALLS = 300_000  # of all kinds together: a third of what a machine of its own makes


def test_no_run_of_calls_breaks_a_promise_of_the_shell(tmp_path: Path) -> None:
    """One test for all kinds, which count together."""
    need(shutil.which("clang") is not None, "clang is not installed here: make ci-tools")
    outcomes = {kind: fuzz(kind, Path(tempfile.mkdtemp(dir=tmp_path)), SECONDS) for kind in KINDS}
    assert not [outcome.finding for outcome in outcomes.values() if outcome.finding]
    assert sum(outcome.calls for outcome in outcomes.values()) >= CALLS, outcomes
