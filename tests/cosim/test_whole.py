"""Tables and reports are there whole or not at all, and what was there before stays until then."""

from __future__ import annotations

import multiprocessing
import os
import signal
import stat
from pathlib import Path

import numpy as np
import pytest

from cosim.results import ROWS_AT_ONCE, read_csv, write_columns
from cosim.whole import whole

ROWS = 10 * ROWS_AT_ONCE


class Deadly:
    """A column that kills its process, as kill -9 does, after half of the rows."""

    def __len__(self) -> int:
        return ROWS

    def __getitem__(self, rows: slice) -> np.ndarray:
        if rows.start >= ROWS // 2:
            os.kill(os.getpid(), signal.SIGKILL)
        return np.arange(*rows.indices(ROWS), dtype=float)


def _write_and_die(path: Path) -> None:
    write_columns({"time": Deadly()}, path)  # type: ignore[dict-item]


def test_a_killed_process_leaves_the_table_that_was_there(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    write_columns({"time": np.arange(ROWS, dtype=float)}, path)
    child = multiprocessing.get_context("spawn").Process(target=_write_and_die, args=(path,))
    child.start()
    child.join()
    assert child.exitcode == -signal.SIGKILL
    np.testing.assert_array_equal(read_csv(path)["time"], np.arange(ROWS))


def test_an_error_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), whole(tmp_path / "report.html") as partial:
        partial.write_text("half")
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_what_is_written_can_be_read_by_others(tmp_path: Path) -> None:
    with whole(tmp_path / "report.html") as partial:
        partial.write_text("all")
    assert (tmp_path / "report.html").read_text() == "all"
    assert stat.S_IMODE((tmp_path / "report.html").stat().st_mode) == 0o644


def test_a_folder_of_that_name_is_refused(tmp_path: Path) -> None:
    (tmp_path / "results.csv").mkdir()
    with pytest.raises(IsADirectoryError), whole(tmp_path / "results.csv"):
        pass
    assert list(tmp_path.iterdir()) == [tmp_path / "results.csv"]
