"""How a log is written: what its user says, and what its first lines tell (separator, decimal sign, comments, names, units)."""

from __future__ import annotations

import csv
import gzip
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TextIO

SEPARATORS = (",", ";", "\t", "|", " ")
SAMPLE = 100  # lines, and
SAMPLE_CHARACTERS = 2**20  # at most in them, that are looked at to find the separator and the decimal sign
LONGEST_LINE = 2**20  # characters
MOST_LINES = 20_000_000

_COMMA_NUMBER = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?\Z", re.ASCII)
_POINT_NUMBER = re.compile(r"[+-]?\d*\.\d+([eE][+-]?\d+)?\Z", re.ASCII)
_BYTE_ORDER_MARKS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


class NotReadable(ValueError):
    """A file is no text of the promised form."""


@dataclass(frozen=True)
class Reading:
    """How to read a log, where that is not found from the file.

    Attributes:
        separator: between the cells; None: found.
        decimal: the decimal sign, "." or ","; None: found.
        encoding: of the text; None: UTF-8, or UTF-16 where the file begins with its mark.
        skip_lines: how many lines before that of the names are left out.
        skip_bad_rows: rows that cannot be read are left out and counted, not refused.
        missing: what stands for an empty cell, as text; a number stands for all ways to write it.
    """

    separator: str | None = None
    decimal: str | None = None
    encoding: str | None = None
    skip_lines: int = 0
    skip_bad_rows: bool = False
    missing: Sequence[str] = ()


@contextmanager
def text_of(path: Path, encoding: str | None) -> Iterator[TextIO]:
    """The text of a file, also compressed (.gz)."""
    opened = gzip.open if path.suffix == ".gz" else open
    if encoding is None:
        with opened(path, "rb") as file:
            encoding = _BYTE_ORDER_MARKS.get(file.read(2), "utf-8-sig")
    with opened(path, "rt", encoding=encoding, newline="") as text:
        yield text


def lines_of(text: TextIO) -> Iterator[str]:
    """The lines of a text, none of them longer than LONGEST_LINE, no more than MOST_LINES.

    Raises:
        NotReadable: one is longer, or there are more.
    """
    for number in range(1, MOST_LINES + 1):
        line = text.readline(LONGEST_LINE + 1)
        if not line:
            return
        if len(line) > LONGEST_LINE:
            raise NotReadable(f"line {number} has more than {LONGEST_LINE} characters")
        yield line
    if text.readline(1):
        raise NotReadable(f"more than {MOST_LINES} lines")


def sample_of(lines: Iterator[str]) -> list[str]:
    """The first lines that hold something, as many as SAMPLE and SAMPLE_CHARACTERS allow."""
    found, characters = [], 0
    for line in islice(lines, SAMPLE):
        characters += len(line)
        if line.strip() and not is_comment(line):
            found.append(line)
        if characters > SAMPLE_CHARACTERS:
            break
    return found


def is_comment(line: str) -> bool:
    """Is the line one for people?"""
    return line.lstrip().startswith("#")


def cells_of(line: str, separator: str) -> list[str]:
    """The cells of one line."""
    return next(rows_of(iter([line.strip(" \r\n")]), separator), [""])


def rows_of(lines: Iterator[str], separator: str) -> Iterator[list[str]]:
    """The rows of cells, without blanks around them; a blank line is a row of one empty cell."""
    if separator == " ":  # of which several lie between cells, and some at the ends
        lines = (line.strip() for line in lines)
    for row in csv.reader(lines, delimiter=separator, skipinitialspace=True):
        yield [cell.strip() for cell in row] or [""]


def found_separator(head: str, body: Sequence[str]) -> str:
    """The separator that cuts most of the lines `body` into as many cells as `head`, or at least into as many as each other.

    "," where none cuts them into several.
    """

    def fit(separator: str) -> tuple[bool, int]:
        width, same = usual_width([cells_of(line, separator) for line in body])
        return (width == len(cells_of(head, separator)), same) if width > 1 else (False, 0)

    return max(SEPARATORS, key=fit)  # of equals the first


def usual_width(rows: Sequence[Sequence[str]]) -> tuple[int, int]:
    """The number of cells that most of the rows have, and how many rows that are."""
    return max(Counter(len(row) for row in rows).items(), key=lambda item: item[1], default=(0, 0))


def found_decimal(cells: Sequence[str]) -> str:
    """The decimal sign: a comma where numbers have one and none has a point."""
    if any(_POINT_NUMBER.match(cell) for cell in cells):
        return "."
    return "," if any(_COMMA_NUMBER.match(cell) for cell in cells) else "."
