"""What a sample costs, counted in instructions: the same on every run, so that a change of it is seen."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from benchmarks import callgrind
from benchmarks.example import experiment
from benchmarks.native import build_driver, unpack
from build_fmus import FMUS, Build, build_all

# Instructions a sample in Example 1, measured by this test. A few per cent depend on the processor, for which glibc picks its cosine.
MEASURED = {"duffing_pseudospectral": 27_800, "duffing_ukf": 10_020}
ALLOWED = 0.05

MISSING = not callgrind.is_installed() and not os.environ.get("CI")


@pytest.mark.long
@pytest.mark.skipif(MISSING, reason="valgrind counts the instructions")
@pytest.mark.parametrize("name", MEASURED)
def test_a_sample_costs_the_instructions_that_were_measured(name: str, tmp_path: Path) -> None:
    build_all(Build(fmus={name: FMUS[name]}), tmp_path, ["host"])
    fmu = unpack(tmp_path / f"{name}.fmu", tmp_path / name)
    counted = callgrind.per_sample(build_driver(tmp_path), fmu, experiment(0.1))
    assert counted == pytest.approx(MEASURED[name], rel=ALLOWED)
