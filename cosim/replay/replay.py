"""Replay: an observer FMU over a recorded log, as if it had been connected when the log was made."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fmpy.model_description import ModelDescription, ModelVariable

from cosim.errors import ExperimentError
from cosim.fmu import Value, read_description, typed_value
from cosim.master.watched import LIMIT, run
from cosim.replay.log import Column, Log, Rows, read_log
from cosim.replay.reading import Reading
from cosim.replay.sampling import Sampling, sampling
from cosim.replay.signals import Signals, columns_of, converters, inputs_of, measured, read, signals, time_column, times
from cosim.results import Result
from cosim.system import Element, System

ELEMENT = "observer"  # the FMU's name in the record
MOST_RECORDED = 60_000_000  # numbers in the record


@dataclass(frozen=True)
class Replay:
    """A replayed log.

    Attributes:
        result: the FMU's outputs, `observer.<output>`: row k is of time start + k Ts and rests on the samples before it; the last
            row lies one sample time after the last sample.
        sampling: which row was the sample of which instant.
        recorded: the number of rows in the log, without those that were skipped.
        log: how the file was read.
        rows: what was skipped of it.
        signals: the inputs at the rows, and what became of units and empty cells.
        columns: the column that fed each input.
        ignored: the columns that fed none.
        kept: the inputs without a column, which kept the value that they were set to or start at.
        empty: how many of the samples of each input were NaN: empty cells and instants without a row.
        held: how many of the samples of a known input were empty cells, and hold the last value.
    """

    result: Result
    sampling: Sampling
    recorded: int
    log: Log
    rows: Rows
    signals: Signals
    columns: Mapping[str, str]
    ignored: list[str]
    kept: list[str]
    empty: Mapping[str, int]
    held: Mapping[str, int]


def replay(
    fmu: Path | str,
    log: Path | str,
    *,
    sample_time: float | None = None,
    mapping: Mapping[str, str] | None = None,
    reading: Reading | None = None,
    overrides: Mapping[str, Value] | None = None,
    progress: Callable[[int, int], None] | None = None,
    limit: float = LIMIT,
) -> Replay:
    """Run an observer FMU over a log, sample by sample.

    The FMU samples at start + k Ts, where start is the time of the first row and Ts is its own: its parameter `sample_time`, or
    the step size of its default experiment. The sample of an instant is the row recorded nearest to it, at most Ts / 2 away;
    the others are left out. At an empty cell and at an instant without a row a measurement is NaN, and any other input keeps
    its last value; measurements are the inputs that have a `measurement_valid.<name>` beside them, or all inputs where the FMU
    has no such inputs. A unit in a column's head, "y [mV]", or below it is converted into that of the input.

    Args:
        fmu: the FMU.
        log: CSV, also compressed (.csv.gz), with columns named like the FMU's inputs and a column `time`, in s or in the unit of
            its head or as ISO 8601; those of Boolean inputs hold true and false, or 1 and 0.
        sample_time: time between the rows of a log without a column `time` [s]; the first is then of time 0.
        mapping: the column of an input, or of the time, whose name is another, `{"y": "V2", "time": "t"}`.
        reading: how the file is written, where it does not tell.
        overrides: start values of parameters; the constant values of inputs without a column.
        progress: called now and then with the number of steps done and of all.
        limit: how long a call of the FMU, which runs in a process of its own, may take [s].

    Raises:
        SystemFileError: the FMU is not sound.
        ExperimentError: the log cannot be read, lacks a column, or its times do not ascend or do not suit the FMU's sample time; an
            unknown or unfit override or mapping, a unit that is not the input's.
        cosim.master.slave.RunError: the FMU failed, ended its process or did not return; `partial` of the error has the rows up to there.
    """
    overrides = overrides or {}
    made = connected(fmu, log, sample_time, mapping or {}, reading, overrides)
    result = run(
        made.system,
        overrides={f"{ELEMENT}.{name}": value for name, value in overrides.items()},
        inputs={f"{ELEMENT}.{name}": values for name, values in made.fed.items()},
        progress=progress,
        limit=limit,
    )
    there = made.sampling.rows[made.sampling.rows >= 0]
    return Replay(
        result=result,
        sampling=made.sampling,
        recorded=len(made.rows.lines),
        log=made.log,
        rows=made.rows,
        signals=made.signals,
        columns={name: column.head for name, column in made.columns.items()},
        ignored=made.ignored,
        kept=[name for name in made.inputs if name not in made.columns],
        empty={name: int(np.isnan(values[:-1]).sum()) for name, values in made.fed.items()},
        held={name: int(empty[there].sum()) for name, empty in made.signals.missing.items()},
    )


@dataclass(frozen=True)
class Connected:
    """An observer FMU and a log that is to drive it.

    Attributes:
        description: the FMU's.
        system: the FMU as the element ELEMENT, from the first sample instant to one sample time after the last.
        fed: the values of the inputs that have a column, at the communication points.
        inputs: the FMU's, by name; `columns`: of those that have one.
        log, rows, signals, sampling, ignored: as of `Replay`.
    """

    description: ModelDescription
    system: System
    fed: Mapping[str, np.ndarray]
    inputs: Mapping[str, ModelVariable]
    columns: Mapping[str, Column]
    log: Log
    rows: Rows
    signals: Signals
    sampling: Sampling
    ignored: list[str]


def connected(
    fmu: Path | str,
    log: Path | str,
    sample_time: float | None,
    mapping: Mapping[str, str],
    reading: Reading | None,
    overrides: Mapping[str, Value],
) -> Connected:
    """The FMU and the log, found to suit each other. Arguments and errors as of `replay`."""
    fmu = Path(fmu).resolve()
    description = read_description(fmu)
    found = read_log(Path(log), reading)
    inputs = inputs_of(description)
    columns = columns_of(found, inputs, mapping, overrides)
    instants = time_column(found, mapping, sample_time)
    rows = read(found, instants, converters(found, inputs, columns))
    taken = sampling(found.path, times(found, instants, rows, sample_time), _sample_time(description, overrides))
    _check_size(found, taken, description)
    made = signals(found, description, inputs, columns, rows)
    fed = {
        name: at_instants(values, taken.rows, measured(name, inputs) and inputs[name].type == "Real")
        for name, values in made.values.items()
    }
    system = System(
        f"{fmu.stem} over {found.path.name}",
        {ELEMENT: Element(fmu)},
        start=taken.start,
        stop=taken.start + len(taken.rows) * taken.sample_time,
        step=taken.sample_time,
    )
    used = {column.head for column in (*columns.values(), instants) if column is not None}
    ignored = [head for head in found.heads if head not in used]
    return Connected(description, system, fed, inputs, columns, found, rows, made, taken, ignored)


def _check_size(log: Log, taken: Sampling, description: ModelDescription) -> None:
    """Refuse a record that would not fit into memory, such as that of a log with one time far beyond the others."""
    count = sum(v.causality == "output" and v.type != "String" for v in description.modelVariables)
    if len(taken.rows) * max(count, 1) > MOST_RECORDED:
        raise ExperimentError(
            f"{log.path}: {len(taken.rows)} samples of {taken.sample_time:g} s with {count} outputs each make more than "
            f"{MOST_RECORDED} numbers: replay parts of it"
        )


def _sample_time(description: ModelDescription, overrides: Mapping[str, Value]) -> float:
    """Ts [s] of the FMU.

    Raises:
        ExperimentError: it names none.
    """
    parameter = next((v for v in description.modelVariables if v.name == "sample_time" and v.type == "Real"), None)
    experiment = description.defaultExperiment
    if parameter is not None and "sample_time" in overrides:
        try:
            found = float(typed_value(parameter, overrides["sample_time"]))
        except ValueError as error:
            raise ExperimentError(str(error)) from None
    elif parameter is not None:
        found = float(parameter.start)
    else:
        found = float(experiment.stepSize) if experiment is not None and experiment.stepSize is not None else 0.0
    if not found > 0:
        raise ExperimentError(
            f"{description.modelName} names no sample time: neither a parameter 'sample_time' nor the step size of a default "
            "experiment"
        )
    return found


def at_instants(recorded: np.ndarray, rows: np.ndarray, missing: bool) -> np.ndarray:
    """The values at the sample instants and one sample time after the last, (n + 1,); NaN at those without a row if `missing`."""
    taken = np.append(rows, -1)
    values = recorded[np.maximum.accumulate(taken)]  # the rows ascend: where there is none (-1), the last one
    if missing:
        values[taken < 0] = np.nan
    return values
