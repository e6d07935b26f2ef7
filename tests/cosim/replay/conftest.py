"""One process for all replays of these tests, where each would start its own."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

from cosim.master.watched import Child
from cosim.replay.replay import replay


@pytest.fixture(scope="session")
def child() -> Iterator[Child]:
    with Child() as made:
        yield made


@pytest.fixture(autouse=True)
def shared_process(child: Child, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules[replay.__module__], "run", child.run)
