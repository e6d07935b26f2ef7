"""The text of a cell becomes a number: a measurement, a whole number, a truth value, a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from datetime import datetime

from cosim import errors

Converter = Callable[[str], float]
_TRUTHS = {"true": 1.0, "false": 0.0}


class Unfit(ValueError):
    """A cell is not what its column wants; the message says what it is not, and what can be done."""


def number(decimal: str, missing: Sequence[str]) -> Converter:
    """Reads a number written with `decimal`; NaN for an empty cell and for what `missing` lists."""
    words = {word.strip() for word in missing} | {""}
    values = {
        value
        for word in words
        if (value := _plain(word, ".")) is not None or (value := _plain(word, decimal)) is not None
    }

    def read(cell: str) -> float:
        value = _plain(cell, decimal)
        if value is not None:
            return math.nan if value in values else value
        if cell in words:
            return math.nan
        raise Unfit(f"'{cell}' {{where}} is not a number{_cure(cell, decimal)}")

    return read


def whole(decimal: str, missing: Sequence[str]) -> Converter:
    """Reads a whole number."""
    read = number(decimal, missing)

    def checked(cell: str) -> float:
        value = read(cell)
        if not value.is_integer():
            raise Unfit(f"'{cell}' {{where}} is not a whole number")
        return value

    return checked


def truth(cell: str) -> float:
    """Reads true and false, in letters of any case, or 1 and 0."""
    value = _TRUTHS.get(cell.lower())
    if value is None:
        value = _plain(cell, ".")
    if value not in (0.0, 1.0):
        raise Unfit(f"'{cell}' {{where}} is neither true nor false")
    return value


def time(decimal: str) -> Converter:
    """Reads ascending times: numbers, or ISO 8601 as seconds after the first one. What the first cell is, all must be."""
    first: datetime | None = None
    last = -math.inf

    def read(cell: str) -> float:
        nonlocal first, last
        value = _plain(cell, decimal)
        if (value is None or first is not None) and cell:
            moment = _moment(cell)
            if moment is None or (first is None and last > -math.inf):
                raise Unfit(
                    f"'{cell}' {{where}} is neither a number nor a time like 2024-05-01T00:00:00{_cure(cell, decimal)}"
                )
            first = first or moment
            try:
                value = (moment - first).total_seconds()
            except TypeError:  # one has a time zone, the other none
                raise Unfit(f"'{cell}' {{where}} and the first time are not both with or without a time zone") from None
        if value is None or not math.isfinite(value):
            raise Unfit("the time is missing or not finite")
        if not value > last:
            raise Unfit(f"time {value:.10g} does not come after {last:.10g}, the one before")
        last = value
        return value

    return read


def is_number(cell: str) -> bool:
    """Is the cell a number, with a point or a comma?"""
    return _plain(cell, ".") is not None or _plain(cell, ",") is not None


def is_moment(cell: str) -> bool:
    """Is the cell an ISO 8601 time, and no number?"""
    return not is_number(cell) and _moment(cell) is not None


def _plain(cell: str, decimal: str) -> float | None:
    """The number, or None."""
    if decimal != ".":
        if "." in cell:
            return None
        cell = cell.replace(decimal, ".")
    try:
        return errors.number(cell)
    except ValueError:
        return None


def _moment(cell: str) -> datetime | None:
    try:
        return datetime.fromisoformat(cell)
    except ValueError:
        return None


def _cure(cell: str, decimal: str) -> str:
    other = "," if decimal == "." else "."
    if _plain(cell, other) is not None:
        return f"; --decimal '{other}' reads it as one"
    return f"; --missing '{cell}' takes it for an empty cell" if len(cell) <= 20 else ""
