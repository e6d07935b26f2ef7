"""A recorded log: a CSV file (also compressed, .csv.gz) with one head line and one line for each instant."""

from __future__ import annotations

import csv
import gzip
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cosim.errors import ExperimentError, not_a_file, suggest


@dataclass(frozen=True)
class Log:
    """The cells of a log as text: names of the columns, rows, and the line of the file on which each row ends."""

    path: Path
    names: list[str]
    rows: list[list[str]]
    lines: list[int]

    def column(self, name: str, truth: bool = False) -> np.ndarray:
        """The numbers of a column, (n,); an empty cell is NaN. With `truth`, `true` and `false` are 1 and 0, in letters of any case.

        Raises:
            ExperimentError: there is no such column, or a cell is not a number; the message names its line.
        """
        if name not in self.names:
            raise ExperimentError(f"{self.path}: there is no column '{name}'; {suggest(name, self.names)}")
        index, values = self.names.index(name), np.empty(len(self.rows))
        words = {"true": 1.0, "false": 0.0} if truth else {}
        for i, row in enumerate(self.rows):
            try:
                values[i] = words.get(row[index].lower(), row[index] or "nan")
            except ValueError:
                raise ExperimentError(
                    f"{self.path}, line {self.lines[i]}: '{row[index]}' in column '{name}' is not a number"
                    + (", true or false" if truth else "")
                ) from None
        return values


def read_log(path: Path) -> Log:
    """Read a log.

    Raises:
        ExperimentError: no such file, no text, no rows, two columns of one name, a line with too few or too many cells.
    """
    open_text = gzip.open if path.suffix == ".gz" else open
    rows, lines = [], []
    try:
        if not path.is_file():
            raise ExperimentError(not_a_file(path))
        with open_text(path, "rt", encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            for row in reader:
                rows.append([cell.strip() for cell in row] or [""])
                lines.append(reader.line_num)
    except (OSError, EOFError, zlib.error, UnicodeDecodeError, csv.Error) as error:
        raise ExperimentError(f"{path}: cannot be read as CSV text ({error})") from None
    while len(rows) > 1 and rows[-1] == [""] != rows[0]:
        rows.pop()
    if len(rows) < 2:
        raise ExperimentError(f"{path}: wants a line with the names of the columns and at least one line of values")
    names = rows[0]
    for name in names:
        if names.count(name) > 1:
            raise ExperimentError(f"{path}: two columns are called '{name}'")
    for row, line in zip(rows, lines, strict=False):
        if len(row) != len(names):
            raise ExperimentError(f"{path}, line {line}: {len(row)} cells under {len(names)} names of columns")
    return Log(path, names, rows[1:], lines[1 : len(rows)])
