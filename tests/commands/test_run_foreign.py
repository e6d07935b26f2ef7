"""observer-fmus run with FMUs and systems of other tools: files, options, and one line for whatever goes wrong."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cosim.results import read_csv, write_columns
from ssp_text import binding, component, connection, connector, pack, ssd
from strict_fmu import FAILURES
from verbs import observer_fmus, refused

Strict = Callable[..., Path]


def alone(strict: Strict, folder: Path, failure: str = "none") -> Path:
    """One element, which fails in the step from 0.5 s on; the system's input drives it, its output is the system's."""
    values = {"failure": f'<ssv:Integer value="{FAILURES.index(failure)}"/>', "fail_time": '<ssv:Real value="0.45"/>'}
    content = (
        f"<ssd:Connectors>{connector('in', 'input')}{connector('out', 'output')}</ssd:Connectors><ssd:Elements>"
        + component("a", "a.fmu", connector("u", "input") + connector("y", "output"), binding(values))
        + f"</ssd:Elements><ssd:Connections>{connection('in', 'a.u')}{connection('a.y', 'out')}</ssd:Connections>"
    )
    return pack(folder / "alone.ssp", ssd(content, more=""), {"a.fmu": strict()})


@pytest.mark.skipif(os.name != "posix", reason="Windows has other words for it")
@pytest.mark.parametrize(
    ("failure", "reason"),
    [("exit", "ended the process with exit(0)"), ("pending_for_ever", "has not returned for 1 s")],
)
def test_an_fmu_that_goes_down_or_hangs_is_one_line_and_the_rows_up_to_there(
    strict: Strict, tmp_path: Path, failure: str, reason: str
) -> None:
    path, out = alone(strict, tmp_path, failure), tmp_path / "out"
    line = refused(observer_fmus("run", path, "--out", out, "--set", "in=2", "--call-limit", 1), 1)
    assert f"element 'a' at t = 0.5: fmi2DoStep {reason}" in line
    written = read_csv(out / "results.csv")
    np.testing.assert_array_equal(written["time"], 0.1 * np.arange(6))
    assert (written["out"] == 2).all()
    assert {f.name for f in out.iterdir()} == {"results.csv", "results.legend.csv"}
    assert not (tmp_path / "eventlog.txt").exists()


def test_connectors_of_the_system_by_file_and_a_note_on_the_feedthrough(strict: Strict, tmp_path: Path) -> None:
    write_columns({"time": np.array([0.0, 1.0]), "in": np.array([0.0, 10.0])}, tmp_path / "drive.csv")
    result = observer_fmus("run", alone(strict, tmp_path), "--out", tmp_path / "out", "--input", tmp_path / "drive.csv")
    assert result.exit_code == 0, result.output
    assert "note: outputs that depend directly on inputs show those of the step before" in result.stdout
    np.testing.assert_allclose(read_csv(tmp_path / "out" / "results.csv")["out"], [0, *range(10)], rtol=0, atol=5e-15)
    line = refused(observer_fmus("run", alone(strict, tmp_path), "--input", tmp_path / "gone.csv"), 2)
    assert "gone.csv: No such file" in line
