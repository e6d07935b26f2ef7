"""What the tests of the compliance check share: the FMUs without fault, compiled once a session."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from broken_fmus import Contents, Make, contents, loaded, maker
from fmu_src.compliance.library.fmu import Fmu


@pytest.fixture(scope="session")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Contents:
    """A co-simulation FMU, small, with every kind of variable and every capability."""
    return contents(tmp_path_factory.mktemp("sound"), "modelDescription.xml", "broken.c")


@pytest.fixture
def make(sound: Contents, tmp_path: Path) -> Make:
    return maker(sound, tmp_path / "broken.fmu")


@pytest.fixture(scope="session")
def sound_exchange(tmp_path_factory: pytest.TempPathFactory) -> Contents:
    """A model-exchange FMU, small, with events."""
    return contents(tmp_path_factory.mktemp("exchange"), "exchange.xml", "exchange.c")


@pytest.fixture
def make_exchange(sound_exchange: Contents, tmp_path: Path) -> Make:
    return maker(sound_exchange, tmp_path / "exchange.fmu")


@pytest.fixture
def load(make: Make, tmp_path: Path) -> Callable[..., Fmu]:
    """load(defect, edits) -> the co-simulation FMU in this process, each in a folder of its own."""
    return lambda defect="none", edits=None, **changes: loaded(
        make(defect=defect, edits=edits), Path(tempfile.mkdtemp(dir=tmp_path)), **changes
    )


@pytest.fixture
def load_exchange(make_exchange: Make, tmp_path: Path) -> Callable[..., Fmu]:
    """The same of the model-exchange FMU."""
    return lambda defect="none", edits=None, **changes: loaded(
        make_exchange(defect=defect, edits=edits), Path(tempfile.mkdtemp(dir=tmp_path)), "ModelExchange", **changes
    )
