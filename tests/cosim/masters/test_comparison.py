"""observer-fmus compare: what counts as a difference, what it prints, writes and refuses."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from commands.app import app
from cosim.errors import ExperimentError
from cosim.masters.comparison import MASTERS, differences, differing, largest, record_all
from systems import coupled, edited, written

Build = Callable[[str], Path]


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        ([1.0, -4.0], [1.0, -4.0], 0.0),
        ([1.0, -4.0], [1.5, -4.0], 0.125),
        ([0.0, 0.0], [0.0, 1e-9], 1.0),
        ([0.0, np.nan, np.inf], [0.0, np.nan, np.inf], 0.0),
        ([2.0, np.nan], [2.5, np.nan], 0.2),
        ([2.0, np.nan], [2.0, 1.0], np.inf),
        ([2.0, np.inf], [2.0, -np.inf], np.inf),
        ([1.0, 2.0], [1.0], np.inf),
    ],
)
def test_a_difference_is_relative_to_the_columns_largest_value(a: list[float], b: list[float], expected: float) -> None:
    assert differences({"v": np.array(a)}, {"v": np.array(b)}) == {"v": expected}


def test_a_column_that_a_tool_lacks_is_no_difference_but_named() -> None:
    found = differences({"v": np.ones(2), "w": np.ones(2)}, {"w": np.ones(2)})
    assert found == {"v": None, "w": 0.0} and largest(found) == 0.0


def test_the_difference_at_each_time_is_infinite_where_one_value_is_not_finite() -> None:
    a, b = np.array([2.0, np.nan, np.inf, -4.0, np.nan]), np.array([1.0, np.nan, 1.0, -4.0, 0.0])
    np.testing.assert_array_equal(differing(a, b), [0.25, 0.0, np.inf, 0.0, np.inf])


def compare(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["compare", *(str(a) for a in arguments)])


def refused(result: Result, code: int) -> str:
    assert result.exit_code == code, result.output
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith("error: ")
    return line


@pytest.mark.usefixtures("other_masters")
def test_compare_prints_each_variable_and_writes_what_each_tool_recorded(built: Build, tmp_path: Path) -> None:
    path = written(coupled(built), tmp_path)
    result = compare(path, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    for row in (
        r"plant\.y\W+0\W+0\W",
        r"toy\.diagnostics\.status\W+not recorded\W+not recorded",
        r"largest\W+[\d.e-]+",
    ):
        assert re.search(row, result.stdout), row
    for tool in MASTERS:
        with (tmp_path / "out" / f"{tool}.csv").open() as file:
            rows = list(csv.reader(file))
        assert rows[0][:2] == ["time", "plant.y"] and len(rows) == 52
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "<td>plant.y</td><td>0</td><td>0</td>" in page and "the limit is 1e-12" in page


@pytest.mark.usefixtures("other_masters")
def test_compare_fails_where_the_tools_differ(built: Build, tmp_path: Path) -> None:
    path = written(coupled(built, {"start.x1": 1.25}), tmp_path)
    other = edited(path, lambda text: text.replace('"initialValues"', '"other"'), "other")
    assert "other.ssp: the tools differ by" in refused(compare(other, "--masters", "fmpy,ecos"), 1)


@pytest.mark.usefixtures("other_masters")
def test_compare_refuses_what_it_cannot_do_in_one_line(built: Build, tmp_path: Path) -> None:
    path = written(coupled(built), tmp_path)
    assert "there is no master 'ecoss'; did you mean 'ecos'" in refused(compare(path, "--masters", "fmpy,ecoss"), 2)
    for names in ("fmpy", "fmpy,fmpy", "ecos,ecos"):
        assert f"masters '{names}': a comparison needs two" in refused(compare(path, "--masters", names), 2)
    (tmp_path / "taken").write_text("a file")
    assert "cannot write to" in refused(compare(path, "--out", tmp_path / "taken"), 2)
    with pytest.raises(ExperimentError, match="needs two"):
        record_all(path, [])
    assert "there is no such file" in refused(compare(tmp_path / "nowhere.ssp"), 2)


def test_a_tool_that_is_not_installed_is_named_in_one_line(
    built: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ecospy.py").write_text("raise ImportError('libtbb.so.12: cannot open shared object file')")
    monkeypatch.syspath_prepend(tmp_path)
    line = refused(compare(written(coupled(built), tmp_path), "--masters", "fmpy,ecos"), 1)
    assert "ecos: not installed here (libtbb.so.12" in line and "docs/masters.md" in line
