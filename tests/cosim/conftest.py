"""What the tests of the co-simulation share: FMUs that refuse what FMI forbids."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import strict_fmu


@pytest.fixture(scope="session")
def strict_library(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return strict_fmu.compiled(tmp_path_factory.mktemp("strict"))


@pytest.fixture
def strict(strict_library: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Writes an FMU called `name` of strict/strict.c; the other arguments as of `strict_fmu.description`.

    It writes into the working directory, which is a folder of the test's own.
    """
    monkeypatch.chdir(tmp_path)
    return lambda name="strict", **choices: strict_fmu.write(tmp_path / f"{name}.fmu", strict_library, **choices)
