"""What the tests of the compliance check share: the FMUs without fault, compiled once a session."""

from __future__ import annotations

from pathlib import Path

import pytest

from broken_fmus import Contents, Make, contents, maker


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
