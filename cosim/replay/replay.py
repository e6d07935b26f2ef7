"""Replay: an observer FMU over a recorded log, as if it had been connected when the log was made."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fmpy.model_description import ModelDescription, ModelVariable

from cosim.errors import ExperimentError, suggest
from cosim.fmu import Value, read_description, typed_value
from cosim.master import run
from cosim.replay.log import Log, read_log
from cosim.replay.sampling import Sampling, sampling, times
from cosim.results import Result
from cosim.system import Element, System

ELEMENT = "observer"  # the FMU's name in the record
VALID = "measurement_valid."  # an input of this prefix says whether the measurement of that name counts; it starts at 1


@dataclass(frozen=True)
class Replay:
    """A replayed log.

    Attributes:
        result: the FMU's outputs, `observer.<output>`: row k is of time start + k Ts and rests on the samples before it; the last
            row lies one sample time after the last sample.
        sampling: which row was the sample of which instant.
        recorded: the number of rows in the log.
        columns: the column that fed each input.
        ignored: the columns that fed none.
        kept: the inputs without a column, which kept the value that they were set to or start at.
        empty: how many of the samples of each input were NaN: empty cells and instants without a row.
    """

    result: Result
    sampling: Sampling
    recorded: int
    columns: Mapping[str, str]
    ignored: list[str]
    kept: list[str]
    empty: Mapping[str, int]


def replay(
    fmu: Path | str,
    log: Path | str,
    *,
    sample_time: float | None = None,
    mapping: Mapping[str, str] | None = None,
    overrides: Mapping[str, Value] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Replay:
    """Run an observer FMU over a log, sample by sample.

    The FMU samples at start + k Ts, where start is the time of the first row and Ts is its own: its parameter `sample_time`, or
    the step size of its default experiment. The sample of an instant is the row recorded nearest to it, at most Ts / 2 away;
    the others are left out. An empty or NaN cell is given to the FMU as NaN. At an instant without a row the measurements are
    NaN and the other inputs keep their last value; measurements are the inputs that have a `measurement_valid.<name>` beside
    them, or all inputs where the FMU has no such inputs.

    Args:
        fmu: the FMU.
        log: CSV, also compressed (.csv.gz), with columns named like the FMU's inputs and a column `time` [s]; those of Boolean
            inputs hold true and false, or 1 and 0.
        sample_time: time between the rows of a log without a column `time` [s]; the first is then of time 0.
        mapping: the column of an input whose name is another, `{"y": "V2"}`.
        overrides: start values of parameters; the constant values of inputs without a column.
        progress: called now and then with the number of steps done and of all.

    Raises:
        SystemFileError: the FMU is not sound.
        ExperimentError: the log cannot be read, lacks a column, or its times do not ascend or do not suit the FMU's sample time; an
            unknown or unfit override or mapping.
        cosim.master.slave.RunError: the FMU failed; `partial` of the error has the rows up to there.
    """
    fmu, log, overrides = Path(fmu).resolve(), Path(log), overrides or {}
    description = read_description(fmu)
    recorded = read_log(log)
    inputs = {v.name: v for v in description.modelVariables if v.causality == "input" and v.type != "String"}
    columns = _columns(recorded, inputs, mapping or {}, overrides)
    taken = sampling(recorded, times(recorded, sample_time), _sample_time(description, overrides))
    signals = {name: _signal(recorded, inputs[name], column, taken.rows, inputs) for name, column in columns.items()}
    system = System(
        f"{fmu.stem} over {log.name}",
        {ELEMENT: Element(fmu)},
        start=taken.start,
        stop=taken.start + len(taken.rows) * taken.sample_time,
        step=taken.sample_time,
    )
    result = run(
        system,
        overrides={f"{ELEMENT}.{name}": value for name, value in overrides.items()},
        inputs={f"{ELEMENT}.{name}": values for name, values in signals.items()},
        progress=progress,
    )
    used = {"time", *columns.values()}
    return Replay(
        result=result,
        sampling=taken,
        recorded=len(recorded.rows),
        columns=columns,
        ignored=[name for name in recorded.names if name not in used],
        kept=[name for name in inputs if name not in columns],
        empty={name: int(np.isnan(values[:-1]).sum()) for name, values in signals.items()},
    )


def _columns(
    log: Log, inputs: Mapping[str, ModelVariable], mapping: Mapping[str, str], overrides: Mapping[str, Value]
) -> dict[str, str]:
    """The column of each input that has one."""
    for name, column in mapping.items():
        if name not in inputs:
            raise ExperimentError(f"the FMU has no input '{name}' to map; {suggest(name, inputs)}")
        if column not in log.names:
            raise ExperimentError(f"{log.path}: there is no column '{column}'; {suggest(column, log.names)}")
    columns = {name: mapping.get(name, name) for name in inputs if name in mapping or name in log.names}
    for name in inputs:
        if name not in columns and name not in overrides and not name.startswith(VALID):
            raise ExperimentError(
                f"{log.path}: there is no column for the input '{name}' among {', '.join(log.names)}; name one by "
                f"--map {name}=COLUMN, or give a constant by --set {name}=VALUE"
            )
        if name in columns and name in overrides:
            raise ExperimentError(f"input '{name}' is set and has the column '{columns[name]}': only one is possible")
    if not columns:
        raise ExperimentError(f"{log.path}: no column feeds an input of the FMU")
    return columns


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


def _signal(
    log: Log, variable: ModelVariable, column: str, rows: np.ndarray, inputs: Mapping[str, ModelVariable]
) -> np.ndarray:
    """The values of an input at the sample instants and one sample time after the last, (n + 1,)."""
    recorded = log.column(column, truth=variable.type == "Boolean")
    if variable.type != "Real":
        wrong = ~np.isin(recorded, (0, 1)) if variable.type == "Boolean" else np.mod(recorded, 1) != 0
        if wrong.any():
            first = int(np.argmax(wrong))
            cell = log.rows[first][log.names.index(column)]
            raise ExperimentError(
                f"{log.path}, line {log.lines[first]}: '{variable.name}' is {variable.type}, and column '{column}' holds '{cell}'"
            )
    taken = np.append(rows, -1)
    values = recorded[np.maximum.accumulate(taken)]  # the rows ascend: where there is none (-1), the last one
    known = {name.removeprefix(VALID) for name in inputs if name.startswith(VALID)}
    measured = variable.name in known if known else True
    if measured and variable.type == "Real":
        values[taken < 0] = np.nan
    return values
