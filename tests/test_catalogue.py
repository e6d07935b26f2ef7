"""What holds of every FMU of the catalogue."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from fmpy.validation import validate_fmu

from build_fmus import FMUS
from tools import ROOT, few


@pytest.mark.parametrize("name", few(FMUS, 3))
def test_fmpy_finds_nothing_wrong(catalogue_fmu: Callable[[str], Path], name: str) -> None:
    assert validate_fmu(str(catalogue_fmu(name))) == []


@pytest.mark.parametrize("names", few([[*FMUS][:3], [*FMUS]]), ids=["three", "all"])
def test_every_fmu_is_sound(catalogue_fmu: Callable[[str], Path], names: list[str]) -> None:
    command = [sys.executable, "-m", "commands", "check", *(str(catalogue_fmu(name)) for name in names)]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr
    assert len(result.stdout.splitlines()) == len(names)
