"""The benchmark's comparison is fair only while all its ways solve the same problem."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.comparison import Comparison, compare
from benchmarks.example import SAMPLE_TIME, L, N
from benchmarks.flops import ideal_flops
from benchmarks.native import build_driver, unpack
from fmu_src import export
from observers.pseudospectral import pseudospectral
from reference_models.duffing import DUFFING


@pytest.fixture(scope="module")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    folder: Path = tmp_path_factory.mktemp("benchmarks")
    fmu = export(pseudospectral(DUFFING, sample_time=SAMPLE_TIME, N=N, L=L), folder)
    return compare(unpack(fmu, folder / "unpacked"), build_driver(folder), rounds=1)


@pytest.mark.long
def test_ipopt_and_the_fmu_find_the_same_estimates(comparison: Comparison) -> None:
    assert comparison.difference.max() < 8e-8


def test_driven_natively_and_from_python_the_fmu_puts_out_the_same_bits(comparison: Comparison) -> None:
    assert comparison.same_bits


@pytest.mark.parametrize(("N", "L", "iterations", "expected"), [(15, 8, 1.3, 9_000), (50, 50, 1.07, 159_000)])
def test_ideal_flops_agree_with_a_count_by_hand(N: int, L: int, iterations: float, expected: float) -> None:
    assert ideal_flops(N, L, iterations) == pytest.approx(expected, rel=0.05)
