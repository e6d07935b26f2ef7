"""A rate that whole nanoseconds and sums of doubles miss: other tools take one sample a step all the same."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from cosim.masters.comparison import MASTERS, differences, record_all
from cosim.system import Element, System
from systems import written


@pytest.mark.usefixtures("other_masters")
@pytest.mark.parametrize("tool", ["ecos", "libcosim"])
def test_at_60_hz_every_tool_gives_the_same_bits(built: Callable[[str], Path], tmp_path: Path, tool: str) -> None:
    h = 1 / 60
    elements = {
        "plant": Element(built("duffing")),
        "observer": Element(built("duffing_missing_ukf"), {"sample_time": h}),
    }
    system = System("sixty", elements, [("plant.y", "observer.y")], stop=20.0, step=h)
    recordings = record_all(written(system, tmp_path), MASTERS)
    found = differences(recordings["fmpy"], recordings[tool])
    assert {name for name, value in found.items() if value and name != "time"} == set()
    assert found["observer.estimate.x2"] == 0
