"""What a run yields, and its form as a CSV file."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cosim.errors import suggest
from cosim.whole import whole

ROWS_AT_ONCE = 10_000  # that are written to a CSV file


class Message(NamedTuple):
    """What an FMU logged; `status` is one of "ok", "warning", "discard", "error", "fatal", "pending"."""

    element: str
    status: str
    category: str
    text: str


@dataclass(frozen=True)
class Result:
    """The record of a run: row 0 after initialisation, row i after step i.

    Attributes:
        system: the system's name.
        step: the communication step size [s].
        time: (n,) [s].
        names: of the m columns: `<element>.<variable>` of all numeric outputs, element by element, as the FMUs list them;
            then the system's own output connectors by their names.
        values: (n, m); enumerations and integers as they are, booleans as 0 and 1.
        units, descriptions: by column name; "" where the FMU has none.
        kinds: "Real", "Integer", "Boolean" or "Enumeration", by column name.
        items: for enumerations, by column name, the item names by their values.
        step_ns: (n - 1,) wall time of each fmi2DoStep [ns], by element.
        messages: what the FMUs logged, in order.
        sources: for each element those whose outputs drive its inputs.
        notes: what whoever reads the numbers should know of how they came about, a line each.
    """

    system: str
    step: float
    time: np.ndarray
    names: tuple[str, ...]
    values: np.ndarray
    units: Mapping[str, str]
    descriptions: Mapping[str, str]
    kinds: Mapping[str, str]
    items: Mapping[str, Mapping[int, str]]
    step_ns: Mapping[str, np.ndarray]
    messages: Sequence[Message]
    sources: Mapping[str, frozenset[str]]
    notes: Sequence[str] = ()

    def __getitem__(self, name: str) -> np.ndarray:
        """The column `name`, or "time" [s]; (n,).

        Raises:
            KeyError: there is none; the message lists near matches.
        """
        if name == "time":  # every column of results.csv has its name there: <element>.<variable>, and this one
            return self.time
        try:
            return self.values[:, self.names.index(name)]
        except ValueError:
            raise KeyError(f"no column '{name}'; {suggest(name, ('time', *self.names))}") from None


def write_csv(result: Result, path: Path) -> None:
    """Write `time` and all columns; doubles in the shortest form that reads back exactly."""
    columns = {
        name: result[name] if result.kinds[name] == "Real" else result[name].astype(int) for name in result.names
    }
    write_columns({"time": result.time, **columns}, path)


def write_columns(columns: Mapping[str, np.ndarray], path: Path) -> None:
    """Write columns (n,) by name, `time` first; the file is there whole or not at all."""
    with whole(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        count = len(columns["time"])
        for first in range(0, count, ROWS_AT_ONCE):  # Python's numbers take four times the memory of an array's
            rows = (column[first : first + ROWS_AT_ONCE].tolist() for column in columns.values())
            writer.writerows(zip(*rows, strict=True))


def read_csv(path: Path) -> dict[str, np.ndarray]:
    """The columns (n,) of a file that `write_columns` made, `time` included, by name.

    Raises:
        ValueError: not such a file; the message names the file and what is wrong.
    """
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    if not rows or rows[0][:1] != ["time"]:
        raise ValueError(f"{path}: the first line does not start with 'time'")
    try:
        table = np.array(rows[1:], dtype=float).reshape(len(rows) - 1, len(rows[0]))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return dict(zip(rows[0], table.T, strict=True))
