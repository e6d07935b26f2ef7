"""Which systems are written: flat ones; what only files of other tools have is refused, also where but one element has it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cosim.errors import SystemFileError
from cosim.master import run
from cosim.system import read_ssp, write_ssp
from ssp_text import UNITS, component, connection, connector, pack, ssd

Strict = Callable[..., Path]

A, B = component("a", "m.fmu", connector("y", "output")), component("b", "km.fmu", connector("u", "input"))
INNER = f'<ssd:System name="inner"><ssd:Elements>{component("c", "m.fmu")}</ssd:Elements></ssd:System>'


@pytest.fixture
def fmus(strict: Strict) -> dict[str, Path]:
    return {f"{unit}.fmu": strict(unit, unit_in=unit, unit_out=unit) for unit in ("m", "km")}


def system(elements: str = A + B, connections: str = connection("a.y", "b.u"), connectors: str = "") -> str:
    outside = f"<ssd:Connectors>{connectors}</ssd:Connectors>" if connectors else ""
    made = f"{outside}<ssd:Elements>{elements}</ssd:Elements><ssd:Connections>{connections}</ssd:Connections>"
    return ssd(made, UNITS)


@pytest.mark.parametrize(
    "text",
    [
        system(A + B + INNER),
        system(INNER + A + B),
        system(connectors=connector("in", "input")),
        system(connections=connection("a.y", "b.u", '<ssc:LinearTransformation factor="2"/>')),
        system(connections=connection("a.y", "b.u", "", 'suppressUnitConversion="true"')),
    ],
    ids=["last nested", "first nested", "connector", "transformation", "units not converted"],
)
def test_what_only_other_tools_write_is_refused_and_no_file_made(
    fmus: dict[str, Path], tmp_path: Path, text: str
) -> None:
    read = read_ssp(pack(tmp_path / "x.ssp", text, fmus), tmp_path / "read")
    with pytest.raises(SystemFileError, match="only flat systems without connectors and transformations of their own"):
        write_ssp(read, tmp_path / "again.ssp")
    assert not (tmp_path / "again.ssp").exists()


def test_a_flat_system_of_another_tool_is_written_and_runs_as_before(fmus: dict[str, Path], tmp_path: Path) -> None:
    path = pack(tmp_path / "x.ssp", system(), fmus)
    write_ssp(read_ssp(path, tmp_path / "read"), tmp_path / "again.ssp")
    overrides = {"a.u": 5.0}
    first, again = run(path, overrides=overrides), run(tmp_path / "again.ssp", overrides=overrides)
    np.testing.assert_array_equal(again.values, first.values)
    assert again["b.y"][-1] == 0.005
