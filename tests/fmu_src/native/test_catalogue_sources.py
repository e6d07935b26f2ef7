"""What is promised of an FMU's sources, of every FMU of the catalogue: three minutes on two processors."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pytest

from build_fmus import FMUS
from fmu_src.compliance.files.binaries import functions
from once import once
from test_embedded import doubles, example
from test_sources import call, compiler, sources, symbols

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(sys.platform != "linux", reason="reads ELF files"),
]

EVERY = pytest.mark.parametrize("name", FMUS)
Path_of = Callable[[str], Path]
STRICT = ("-std=c99", "-O0", "-Wall", "-Wextra", "-Wpedantic", "-Werror")  # -O2 is zig's
# Of each kind of C one that gcc optimises too, which takes it up to a minute for the others of the kind: they differ in sizes and numbers.
OPTIMISED = {
    "duffing",
    "rlc",
    "sine",
    "duffing_ukf",
    "james_baras_5_1_riccati",
    "chen_yen_least_squares",
    "duffing_pseudospectral",
    "duffing_pseudospectral_spline",
    "duffing_known_pseudospectral_tube",
    "rlc_pseudospectral",
    "silverbox_pseudospectral_short",
    "roessler_elementary",
    "van_der_pol_signed_elementary",
    "motor_canonical_dae",
    "motor_canonical_dae_bdf",
    "duffing_ukf_controller",
}


@pytest.fixture
def folder(name: str, catalogue_fmu: Path_of, shared: Path) -> Path:
    """The contents of the FMU."""
    return once(shared / "fmus_unpacked" / name, lambda to: fmpy.extract(str(catalogue_fmu(name)), str(to)))


@EVERY
def test_the_example_without_fmi_compiles_without_warnings_and_runs(name: str, folder: Path, tmp_path: Path) -> None:
    options = () if name in OPTIMISED else ("-O0",)
    printed = doubles(call([example(folder, tmp_path / "example", *options)], tmp_path))
    assert printed.shape[0] == 20 and np.isfinite(printed).all(), name


@pytest.mark.parametrize("name", sorted(OPTIMISED))
def test_one_translation_unit_exports_the_functions_of_fmi_alone(name: str, folder: Path, tmp_path: Path) -> None:
    (tmp_path / "all.c").write_text("".join(f'#include "{source.name}"\n' for source in sources(folder)))
    library = ("-fPIC", "-shared", "-I", folder / "sources", "all.c", "-lm", "-o", "all.so")
    call([*compiler("gcc"), *STRICT, *library], tmp_path)
    assert symbols(tmp_path / "all.so", "--dynamic") == functions("CoSimulation"), name


@EVERY
def test_a_compiler_that_knows_c99_and_no_more_takes_them(name: str, folder: Path, tmp_path: Path) -> None:
    call([*compiler("tcc"), "-shared", *sources(folder), "-lm", "-o", tmp_path / "built.so"], tmp_path)
    assert symbols(tmp_path / "built.so", "--dynamic") >= functions("CoSimulation"), name
