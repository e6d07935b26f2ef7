"""A recorded log: a CSV file (also compressed, .csv.gz) with one line of names and one line for each instant."""

from __future__ import annotations

import csv
import zlib
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from cosim.errors import ExperimentError, not_a_file, suggest
from cosim.replay import cells, units
from cosim.replay.cells import Converter, Unfit
from cosim.replay.reading import (
    NotReadable,
    Reading,
    cells_of,
    found_decimal,
    found_separator,
    is_comment,
    lines_of,
    rows_of,
    sample_of,
    text_of,
    usual_width,
)

MOST_COLUMNS = 10_000
MOST_NUMBERS = 20_000_000  # that are kept of a log
SKIP = "--skip-bad-rows leaves such rows out"


@dataclass(frozen=True)
class Column:
    """A column: its head as it is written, the name in it, and the unit in it or below it ("" for none)."""

    head: str
    name: str
    unit: str


@dataclass(frozen=True)
class Log:
    """What the head of a log tells.

    Attributes:
        path: the file.
        reading: as it was asked for.
        separator, decimal: as they were given or found.
        columns: in the order of the file.
        units_below: the line under the names holds units.
        body: the number of the line after which the values begin.
    """

    path: Path
    reading: Reading
    separator: str
    decimal: str
    columns: tuple[Column, ...]
    units_below: bool
    body: int

    @property
    def heads(self) -> list[str]:
        """The heads of the columns."""
        return [column.head for column in self.columns if column.head]

    def find(self, name: str) -> Column | None:
        """The column whose head is `name`, or else the one with that name before its unit.

        Raises:
            ExperimentError: two have that name, in different units.
        """
        found = [column for column in self.columns if name and column.head == name] or [
            column for column in self.columns if name and column.name == name
        ]
        if len(found) > 1:
            raise ExperimentError(f"{self.path}: two columns are called '{name}'")
        return found[0] if found else None

    def column(self, name: str) -> Column:
        """As `find`.

        Raises:
            ExperimentError: there is none either.
        """
        found = self.find(name)
        if found is None:
            raise ExperimentError(f"{self.path}: there is no column '{name}'; {suggest(name, self.heads)}")
        return found

    def number(self) -> Converter:
        """Reads a number as this log writes them."""
        return cells.number(self.decimal, self.reading.missing)

    def numbers(self, name: str) -> np.ndarray:
        """The numbers of one column, (n,); an empty cell is NaN.

        Raises:
            ExperimentError: as `read`, or there is no such column.
        """
        return self.read({self.column(name).head: self.number()}).values[self.column(name).head]

    def read(self, wanted: Mapping[str, Converter]) -> Rows:
        """The values of columns, by their heads.

        Raises:
            ExperimentError: a row with too few or too many cells or with one that does not suit its converter, unless bad rows are
                skipped; no row; a file that cannot be read or is too large. The message names the line.
        """
        heads = [column.head for column in self.columns]
        index = [heads.index(head) for head in wanted]
        values = [array("d") for _ in wanted]
        lines = array("q")
        converters = list(wanted.values())
        skipped, reason = 0, ""
        for line, row in self._rows():
            try:
                numbers = self._converted(row, index, converters, heads)
            except Unfit as error:
                if not self.reading.skip_bad_rows:
                    raise ExperimentError(f"{self.path}, line {line}: {error}; {SKIP}") from None
                skipped, reason = skipped + 1, reason or f"line {line}: {error}"
                continue
            for column, value in zip(values, numbers, strict=True):
                column.append(value)
            lines.append(line)
            if len(lines) * len(index) > MOST_NUMBERS:
                raise ExperimentError(f"{self.path}: more than {MOST_NUMBERS} numbers in the columns that are read")
        if not lines:
            told = f": all {skipped} were skipped, the first one, {reason}" if skipped else ""
            raise ExperimentError(
                f"{self.path}: wants at least one line of values under the names of the columns{told}"
            )
        made = {head: np.frombuffer(column) for head, column in zip(wanted, values, strict=True)}
        return Rows(made, np.frombuffer(lines, dtype=np.int64), skipped, reason)

    def _converted(
        self, row: list[str], index: list[int], converters: list[Converter], heads: list[str]
    ) -> list[float]:
        if len(row) != len(heads):
            raise Unfit(f"{len(row)} cells under {len(heads)} names of columns")
        numbers = []
        for i, convert in zip(index, converters, strict=True):
            try:
                numbers.append(convert(row[i]))
            except Unfit as error:
                raise Unfit(str(error).replace("{where}", f"in column '{heads[i]}'")) from None
        return numbers

    def _rows(self) -> Iterator[tuple[int, list[str]]]:
        """The rows below the head, each with the line of the file on which it ends, without blank ones at the end."""
        with _readable(self.path), text_of(self.path, self.reading.encoding) as text:
            counted = _Counted(lines_of(text))
            for _ in islice(counted, self.body):
                pass
            blank: list[int] = []
            for row in rows_of((line for line in counted if not is_comment(line)), self.separator):
                if row == [""]:
                    blank.append(counted.number)
                    continue
                yield from ((line, [""]) for line in blank)
                blank.clear()
                yield counted.number, row


@dataclass(frozen=True)
class Rows:
    """Values of a log, (n,) by the heads of their columns; the line of each; how many rows were skipped, and why the first."""

    values: Mapping[str, np.ndarray]
    lines: np.ndarray
    skipped: int
    reason: str


class _Counted:
    """Lines, and the number of the one that was taken last."""

    def __init__(self, lines: Iterator[str]):
        self._lines, self.number = lines, 0

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        line = next(self._lines)
        self.number += 1
        return line


def read_log(path: Path, reading: Reading | None = None) -> Log:
    """Read the head of a log.

    Raises:
        ExperimentError: no such file, no text, no names, two columns of one head, an option that makes no sense.
    """
    reading = reading or Reading()
    _check(reading)
    if not path.is_file():
        raise ExperimentError(not_a_file(path))
    with _readable(path), text_of(path, reading.encoding) as text:
        counted = _Counted(lines_of(text))
        for _ in islice(counted, reading.skip_lines):
            pass
        head, comment = "", ""
        for head in counted:
            if head.strip() and not is_comment(head):
                break
            comment, head = head if is_comment(head) else comment, ""
        head, body = head.rstrip("\r\n"), counted.number
        sample = sample_of(counted)
        separator = reading.separator or found_separator(head, sample)
        names = cells_of(head, separator)
        if len(names) > MOST_COLUMNS:
            raise ExperimentError(f"{path}, line {body}: more than {MOST_COLUMNS} columns")
        if all(cells.is_number(name) for name in names):  # numpy.savetxt hides the names behind a #
            hidden = cells_of(comment.lstrip().removeprefix("#"), separator)
            if len(hidden) != len(names) or any(not name or cells.is_number(name) for name in hidden):
                raise ExperimentError(f"{path}, line {body}: wants the names of the columns, not numbers")
            sample, names, body = [head, *sample], hidden, body - 1
        rows = list(rows_of(iter(sample), separator))
    if not any(names) or not rows:
        raise ExperimentError(f"{path}: wants a line with the names of the columns and at least one line of values")
    below = _units_below(names, rows[0])
    columns = tuple(Column(name, *units.split(name)) for name in names)
    if below:
        columns = tuple(Column(c.head, c.head, unit.strip("[]()")) for c, unit in zip(columns, rows[0], strict=True))
        body = _line_after(path, reading, body)
    for name, count in Counter(names).items():
        if name and count > 1:
            raise ExperimentError(f"{path}: two columns are called '{name}'")
    _check_widths(path, body, names, rows)
    decimal = reading.decimal or found_decimal([cell for row in rows for cell in row])
    return Log(path, reading, separator, decimal, columns, below, body)


def _line_after(path: Path, reading: Reading, body: int) -> int:
    """The number of the first line after `body` that is neither blank nor a comment."""
    with _readable(path), text_of(path, reading.encoding) as text:
        for number, line in enumerate(lines_of(text), start=1):
            if number > body and line.strip() and not is_comment(line):
                return number
    return body


def _units_below(names: list[str], row: list[str]) -> bool:
    """Does the first row hold nothing but units?"""
    wordless = [cell.strip("[]()") for cell in row]
    return (
        len(row) == len(names)
        and any(cell not in units.NONE for cell in wordless)
        and not any(cells.is_number(cell) or cells.is_moment(cell) for cell in row)
        and all(units.split(name)[1] == "" for name in names)
        and all(units.parse(cell) is not None for cell in wordless)
    )


def _check_widths(path: Path, body: int, names: list[str], rows: list[list[str]]) -> None:
    """Refuse a first line that holds no names: a title, or what an instrument says of itself."""
    width, same = usual_width(rows)
    if width != len(names) and 2 * same > len(rows):
        raise ExperimentError(
            f"{path}, line {body}: {len(names)} names of columns over {width} cells in most lines; if the names come "
            "later, --skip-lines leaves out what comes before them; --separator gives what lies between cells"
        )


def _check(reading: Reading) -> None:
    if reading.separator is not None and (len(reading.separator) != 1 or reading.separator in '"\r\n#'):
        raise ExperimentError(f"--separator {reading.separator!r} must be one character, such as ',', ';' or tab")
    if reading.decimal not in (None, ".", ","):
        raise ExperimentError(f"--decimal {reading.decimal!r} must be '.' or ','")
    if reading.decimal is not None and reading.decimal == reading.separator == ".":
        raise ExperimentError("--separator and --decimal cannot both be '.'")
    if reading.skip_lines < 0:
        raise ExperimentError(f"--skip-lines {reading.skip_lines} must not be negative")


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """What keeps a file from being read as text becomes an ExperimentError."""
    try:
        yield
    except (OSError, EOFError, zlib.error, UnicodeError, csv.Error, NotReadable) as error:
        cure = "; --encoding says how it is written, such as cp1252" if isinstance(error, UnicodeError) else ""
        raise ExperimentError(f"{path}: cannot be read as CSV text ({error}){cure}") from None
    except LookupError as error:
        raise ExperimentError(f"{path}: --encoding: {error}") from None
