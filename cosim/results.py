"""What a run yields, and its form as a CSV file."""

from __future__ import annotations

import csv
from array import array
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cosim.errors import number, suggest
from cosim.whole import whole

MOST_MESSAGES = 100_000  # that are kept
LONGEST_MESSAGE = 1000  # characters of them
ROWS_AT_ONCE = 10_000  # that are written to a CSV file


class Message(NamedTuple):
    """What an FMU logged; `status` is one of "ok", "warning", "discard", "error", "fatal", "pending"."""

    element: str
    status: str
    category: str
    text: str


class Given(NamedTuple):
    """What a Real input was given: values (n,), its unit, and whether it is a measurement, with a `measurement_valid.<name>` beside it."""

    values: np.ndarray
    unit: str
    measured: bool


class Messages(list[Message]):
    """What FMUs log in a run: the first MOST_MESSAGES, the last of which gives way to each later one."""

    def append(self, message: Message) -> None:
        if len(self) >= MOST_MESSAGES:
            self.pop()
        super().append(message._replace(text=message.text[:LONGEST_MESSAGE]))


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
        messages: what the FMUs logged, in order, as of `Messages`.
        sources: for each element those whose outputs drive its inputs.
        inputs: by `<element>.<variable>`, of the Real inputs that are connected or recorded, in the order of the FMUs.
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
    inputs: Mapping[str, Given]
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


def write_parquet(result: Result, path: Path) -> None:
    """Write the same as `write_csv` as Parquet, enumerations in words.

    Raises:
        ImportError: pyarrow, which is an extra, is not installed.
    """
    import pyarrow
    from pyarrow import parquet

    columns = {"time": pyarrow.array(result.time)}
    for name in result.names:
        values = result[name]
        if result.kinds[name] == "Enumeration":
            items = result.items[name]
            column = pyarrow.array([items.get(int(v), str(int(v))) for v in values]).dictionary_encode()
        elif result.kinds[name] == "Boolean":
            column = pyarrow.array(values != 0)
        else:
            column = pyarrow.array(values if result.kinds[name] == "Real" else values.astype(np.int32))
        columns[name] = column
    with whole(path) as partial:
        parquet.write_table(pyarrow.table(columns), partial)


def write_legend(result: Result, path: Path) -> None:
    """Write what the codes of each enumeration mean, a row each: column, code, word. Without enumerations there is no file."""
    if not result.items:
        return
    with whole(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("column", "code", "word"))
        writer.writerows((name, code, word) for name, items in result.items.items() for code, word in items.items())


def write_columns(columns: Mapping[str, np.ndarray], path: Path) -> None:
    """Write columns (n,) by name, `time` first; the file is there whole or not at all."""
    with whole(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        count = len(columns["time"])
        for first in range(0, count, ROWS_AT_ONCE):  # Python's numbers take four times the memory of an array's
            rows = (column[first : first + ROWS_AT_ONCE].tolist() for column in columns.values())
            writer.writerows(zip(*rows, strict=True))


def read_csv(path: Path, wanted: Collection[str] | None = None) -> dict[str, np.ndarray]:
    """The columns (n,) of a file that `write_columns` made, `time` first, by name; of the others those in `wanted` (None: all).

    Raises:
        ValueError: not such a file; the message names the file, the line and what is wrong.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            names = next(reader, [])
            if names[:1] != ["time"]:
                raise ValueError(f"{path}: the first line does not start with 'time' and a comma")
            kept = [i for i, name in enumerate(names) if i == 0 or wanted is None or name in wanted]
            if len({names[i] for i in kept}) < len(kept):
                raise ValueError(f"{path}: two columns have one name")
            columns = {names[i]: array("d") for i in kept}
            for row in reader:
                if len(row) != len(names):
                    raise ValueError(
                        f"{path}, line {reader.line_num}: {len(row)} cells under {len(names)} names of columns"
                    )
                for i, column in zip(kept, columns.values(), strict=True):
                    try:
                        column.append(number(row[i]))
                    except ValueError:
                        raise ValueError(
                            f"{path}, line {reader.line_num}: {row[i][:40]!r} in the column {names[i][:40]!r} is not a number"
                        ) from None
    except (csv.Error, UnicodeError) as error:
        raise ValueError(f"{path}: cannot be read as CSV text in UTF-8 ({error})") from None
    return {name: np.array(column) for name, column in columns.items()}
