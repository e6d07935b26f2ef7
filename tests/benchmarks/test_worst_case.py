"""The worst case is asked of every observer: its streams fit it, and its command prints a line for each."""

from __future__ import annotations

import subprocess
import sys

import pytest

from benchmarks import callgrind
from benchmarks.streams.catalogue import CATALOGUE
from benchmarks.worst_case import limit_of, with_limit
from build_fmus import FMUS

OBSERVERS = [name for name, (_, driven_by) in FMUS.items() if driven_by is not None]


def test_every_observer_of_the_catalogue_has_a_stream() -> None:
    assert set(OBSERVERS) <= set(CATALOGUE)


def test_an_iteration_limit_is_the_components_own_and_at_most_its_largest() -> None:
    component = CATALOGUE["van_der_pol_known_elementary"].make()
    assert [limit_of(with_limit(component, limit)) for limit in (1, 5, 40)] == [1, 5, 5]
    plain = CATALOGUE["duffing_ukf"].make()
    assert limit_of(plain) is None
    assert with_limit(plain, 1) == plain


@pytest.mark.long
@pytest.mark.skipif(not callgrind.is_installed(), reason="valgrind counts the instructions")
def test_the_command_prints_a_line_for_each_observer() -> None:
    command = [sys.executable, "-m", "benchmarks.worst_case", "--observer", "rlc_pseudospectral"]
    printed = subprocess.run([*command, "--iteration-limit", "1"], capture_output=True, text=True, check=True).stdout
    head, _, row = (line.strip("| ").split(" | ") for line in printed.splitlines())
    assert len(row) == len(head)
    assert row[0] == "`rlc_pseudospectral`"
    counts = [float(cell) for cell in row[1:7]]
    assert all(0 < median <= worst < 1000 for median, worst in zip(counts[::2], counts[1::2], strict=True))
    assert row[-1] == "1"


def test_an_unknown_observer_is_one_message() -> None:
    found = subprocess.run(
        [sys.executable, "-m", "benchmarks.worst_case", "--observer", "wrong"], capture_output=True, text=True
    )
    assert found.returncode == 2
    assert "no observer's name contains wrong; known: duffing_pseudospectral" in " ".join(found.stderr.split())
