"""Can an estimate be trusted? Twenty corruptions of the measurements, over all observers: python -m benchmarks.trust.

For each observer: its largest error on clean data, in parts of the truth's rms, and how often it wasn't trusted there; of the estimates
on corrupted streams, how many are wrong, and of these how many silently (`diagnostics.trusted`), but for those that another motion of the
model explains within the noise, which have a column of their own; streams on which wrong estimates were never flagged; samples until the
estimate is right again once the stream is, median and largest, and streams on which it isn't at the end; runs that an error ended.
`streams.verdicts` says what wrong is.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from advice.streams.corruptions import CORRUPTIONS, Corruption
from advice.streams.native import sampled
from advice.streams.streams import Streams
from advice.streams.verdicts import Clean, Tried, Verdict, judge, limits
from benchmarks.streams.catalogue import ENTRIES
from benchmarks.streams.entry import Entry

SEEDS = 3
COLUMNS = ("clean", "alarms", "wrong", "silent", "explained", "unflagged", "recovery", "lost", "ended")

out = Console(width=None if sys.stdout.isatty() else 130)
err = Console(stderr=True)


@dataclass(frozen=True)
class Row:
    """An observer's verdicts, and how it did on clean data."""

    observer: str
    clean: Clean
    verdicts: Sequence[Verdict]


def board(
    entries: dict[str, Entry],
    corruptions: Sequence[Corruption],
    seeds: Sequence[int],
    progress: Callable[[str], None] = lambda name: None,
) -> Iterable[Row]:
    """The rows, one by one."""
    made: dict[str, Streams] = {}
    for name, entry in entries.items():
        progress(name)
        scenario = entry.scenario()
        streams = made.setdefault(scenario.name, Streams(scenario))
        component = entry.make()
        tried = Tried(component, entry.parameters, sampled(component, scenario.sample_time))
        limit, clean = limits(tried, streams, seeds)
        verdicts = [
            judge(tried, streams.stream(corruption, seed), limit)
            for corruption in corruptions
            if scenario.allows(corruption)
            for seed in seeds
        ]
        yield Row(name, clean, verdicts)


def main(
    observer: Annotated[list[str] | None, typer.Option(help="only observers whose name contains this")] = None,
    corruption: Annotated[list[str] | None, typer.Option(help="only this corruption")] = None,
    seeds: Annotated[int, typer.Option(min=1, help="streams of each kind")] = SEEDS,
    each: Annotated[bool, typer.Option("--each", help="a line for each corruption too")] = False,
) -> None:
    """Print the board."""
    entries = {name: e for name, e in ENTRIES.items() if not observer or any(part in name for part in observer)}
    known = {c.name: c for c in CORRUPTIONS}
    for name in corruption or ():
        if name not in known:
            _fail(f"corruption '{name}' is unknown; known: {', '.join(known)}")
    if not entries:
        _fail(f"no observer's name contains {', '.join(observer or ())}; known: {', '.join(ENTRIES)}")
    chosen = [known[name] for name in corruption] if corruption else list(CORRUPTIONS)
    table = _table()
    columns = (TextColumn("{task.description:<42}"), BarColumn(), TextColumn("{task.completed}/{task.total}"))
    with Progress(*columns, TimeElapsedColumn(), console=err, transient=True, disable=not err.is_terminal) as bar:
        task = bar.add_task("", total=len(entries))
        for row in board(entries, chosen, range(seeds), lambda name: bar.update(task, description=name)):
            table.add_row(*_cells(row))
            for name in [c.name for c in chosen] if each else ():
                part = [v for v in row.verdicts if v.corruption.name == name]
                if part:
                    table.add_row(f"  {name}", "", "", *_judged(part))
            bar.advance(task)
    out.print(table)


def _table() -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("observer", no_wrap=True)
    for name in COLUMNS:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _cells(row: Row) -> list[str]:
    clean = f"{np.max(row.clean.largest):.1%}" if np.all(np.isfinite(row.clean.largest)) else "not finite"
    return [row.observer, clean, f"{row.clean.alarms:.1%}", *_judged(row.verdicts)]


def _judged(verdicts: Sequence[Verdict]) -> list[str]:
    wrong, silent, explained = (sum(getattr(v, name) for v in verdicts) for name in ("wrong", "silent", "explained"))
    streams = [v for v in verdicts if v.wrong]
    never_flagged = [v for v in streams if not v.flagged]
    recovery = [v.recovery for v in verdicts if v.recovery is not None]
    lost = [v for v in verdicts if v.never]
    return [
        str(wrong),
        f"{silent / wrong:.1%}" if wrong else "-",
        f"{explained / wrong:.1%}" if wrong else "-",
        f"{len(never_flagged)}/{len(streams)}",
        f"{np.median(recovery):.0f}, {max(recovery)}" if recovery else "-",
        str(len(lost)),
        str(sum(bool(v.ended) for v in verdicts)),
    ]


def _fail(message: str) -> None:
    err.print(f"error: {message}", style="red", markup=False, highlight=False, soft_wrap=True)
    sys.exit(2)


if __name__ == "__main__":
    typer.run(main)
