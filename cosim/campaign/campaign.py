"""A Monte Carlo campaign: many runs of a system with varied start values and seeds, on Dask, resumable.

Each finished run is a file in the campaign's folder, written whole or not at all; a campaign that is started again does the
runs that have none. The values of a run depend on the seed and the run's number only, so neither the number of workers, nor
their order, nor an interruption changes the table.
"""

from __future__ import annotations

import csv
import hashlib
import json
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from distributed import KilledWorker, as_completed, get_worker
from distributed.diagnostics.plugin import UploadFile

from cosim.campaign.run import SETTLE, Experiment, Outcome, failed, load, perform, save
from cosim.campaign.variation import Variations, check, draw
from cosim.campaign.workers import connected
from cosim.errors import ExperimentError, SystemFileError
from cosim.fmu import Value, unit_of
from cosim.master import count_steps, start_values
from cosim.master.watched import LIMIT
from cosim.report.estimates import Pair, paired
from cosim.system.resolve import find_variable, resolve_ssp
from cosim.system.resolved import ResolvedSystem
from cosim.whole import whole

QUESTION, RUNS, TABLE = "campaign.json", "runs", "runs.csv"
LARGEST_QUESTION = 2**24  # bytes


@dataclass(frozen=True)
class Campaign:
    """A finished campaign.

    Attributes:
        system: the system's name.
        experiment: what the runs share.
        pairs: the estimates that are rated, with their truths.
        units: the units of the truths, by column name.
        outcomes: one for each run, by number.
    """

    system: str
    experiment: Experiment
    pairs: list[Pair]
    units: Mapping[str, str]
    outcomes: list[Outcome]


def campaign(
    system: Path | str,
    out: Path | str,
    *,
    runs: int,
    vary: Variations,
    overrides: Mapping[str, Value] | None = None,
    seed: int = 0,
    stop: float | None = None,
    step: float | None = None,
    settle: float = SETTLE,
    scheduler: str | None = None,
    workers: int | None = None,
    limit: float = LIMIT,
    dashboard: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Campaign:
    """Run an .ssp file `runs` times with varied start values; what is in `out` already is not run again.

    Called from a script, it must stand under `if __name__ == "__main__":`, because local workers are processes that import
    the script. A cluster's workers need this package; the .ssp file is sent to them.

    Args:
        system: the .ssp file.
        out: the campaign's folder; afterwards the table of the runs is in its `runs.csv`.
        runs: how many. More than the last time goes on from there.
        vary: by path, the bounds of a uniform distribution (a whole number for an Integer), or None for whole numbers that are
            distinct in all runs: `{"plant.start.x1": (-1.0, 1.0), "plant.sensor.seed": None}`.
        overrides: start values that all runs share.
        seed: of the random draws.
        stop, step: stop time and communication step [s]; default: the system's.
        settle: how long after the start and each jump of a true parameter an estimate may take to settle [s].
        scheduler: address of a Dask scheduler; default: processes on this machine.
        workers: how many processes on this machine; default: one for each processor.
        limit: how long a call of an FMU may take [s].
        dashboard: Dask's own page about the processes on this machine, which only this machine can see; it wants bokeh.
        progress: called with the number of finished runs and of all.

    Raises:
        SystemFileError: the system or its file is not sound, or the record of a run in `out` is damaged.
        ExperimentError: a varied or set variable is unknown or unfit, the system has no estimate with a truth, `out` holds
            another campaign, the scheduler does not answer.
        OSError: `out` cannot be written.
    """
    system, out = Path(system).resolve(), Path(out).resolve()
    overrides = overrides or {}
    for what, value, least in (("runs", runs, 1), ("seed", seed, 0), ("workers", 1 if workers is None else workers, 1)):
        if value < least:
            raise ExperimentError(f"{what} = {value} must be at least {least}")
    if not settle >= 0:
        raise ExperimentError(f"settle = {settle:g} s must not be negative")
    if scheduler is not None and workers is not None:
        raise ExperimentError("the number of workers is the cluster's: give a scheduler or workers")
    with tempfile.TemporaryDirectory(prefix="campaign-") as directory:
        resolved = resolve_ssp(system, Path(directory))
    typed = start_values(resolved, overrides)
    overrides = {path: _typed(resolved, typed, path, value) for path, value in overrides.items()}
    check(vary, resolved, overrides, runs)
    stop, step = resolved.experiment(stop, step)
    count_steps(resolved.system.start, stop, step)
    found = _rated(resolved)
    parameters = tuple(
        p.truth
        for p in found
        if f"parameter.{p.variable}" in resolved.variables[find_variable(resolved.variables, p.truth)[0]]
    )
    experiment = Experiment(overrides, stop, step, settle, parameters)
    digest = hashlib.sha256(system.read_bytes()).hexdigest()
    _open_folder(out, {"system": digest, "vary": dict(vary), "seed": seed, **asdict(experiment)})

    values = {number: draw(vary, resolved, seed, number) for number in range(runs)}
    records = {number: out / RUNS / f"{number:06d}.npz" for number in range(runs)}
    todo = {number: values[number] for number in range(runs) if not records[number].exists()}
    progress(runs - len(todo), runs)
    if todo:
        performed = _perform_all(system, digest, experiment, todo, limit, scheduler, workers, dashboard)
        for i, outcome in enumerate(performed, start=1):
            save(outcome, records[outcome.run])
            progress(runs - len(todo) + i, runs)
    outcomes = [load(record, number, values[number], len(found)) for number, record in records.items()]
    _write_table(outcomes, out / TABLE)
    units = {pair.truth: _unit(resolved, pair.truth) for pair in found}
    return Campaign(resolved.system.name, experiment, found, units, outcomes)


def _rated(resolved: ResolvedSystem) -> list[Pair]:
    """The estimates of `resolved` with a truth beside them.

    Raises:
        ExperimentError: there are none.
    """
    names = [
        f"{element}.{variable.name}"
        for element, description in resolved.descriptions.items()
        for variable in description.modelVariables
        if variable.causality == "output" and variable.type == "Real"
    ]
    found = paired(names, resolved.sources())
    if not found:
        raise ExperimentError(
            f"system '{resolved.system.name}' has no estimate beside its truth "
            "(outputs <observer>.estimate.<variable> and, of a plant that it observes, <plant>.x.<variable> or .z.<variable>): "
            "there is nothing to rate"
        )
    return found


def _typed(resolved: ResolvedSystem, typed: Mapping[str, Mapping[str, Value]], path: str, value: Value) -> Value:
    """The value of an override as its variable takes it; of a connector of the system as it was given."""
    if path in resolved.system.connectors:
        return value
    element, variable = find_variable(resolved.variables, path)
    return typed[element][variable.name]


def _unit(resolved: ResolvedSystem, path: str) -> str:
    return unit_of(find_variable(resolved.variables, path)[1])


def _open_folder(out: Path, question: Mapping[str, Any]) -> None:
    """Make the campaign's folder, or see that it holds runs of the same question.

    Raises:
        ExperimentError: it holds another campaign; the message says what differs.
        SystemFileError: its campaign.json is damaged.
    """
    asked = json.loads(json.dumps(question))
    path = out / QUESTION
    if not path.exists():
        (out / RUNS).mkdir(parents=True, exist_ok=True)
        with whole(path) as partial:
            partial.write_text(json.dumps(asked, indent=1) + "\n", encoding="utf-8")
        return
    try:
        if path.stat().st_size > LARGEST_QUESTION:
            raise ValueError(f"more than {LARGEST_QUESTION} bytes")
        held = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(held, dict) or held.keys() != asked.keys():
            raise ValueError("it holds something else")
    except (ValueError, RecursionError) as error:
        raise SystemFileError(f"{path}: not the head of a campaign ({error})") from None
    if held != asked:
        differing = [key for key in asked if held[key] != asked[key]]
        differences = [
            "the contents of the .ssp file" if key == "system" else f"{key} was {held[key]}, now {asked[key]}"
            for key in differing
        ]
        raise ExperimentError(f"{out} holds another campaign ({'; '.join(differences)}): choose another folder")


def _perform_all(
    system: Path,
    digest: str,
    experiment: Experiment,
    todo: Mapping[int, Mapping[str, float | int]],
    limit: float,
    scheduler: str | None,
    workers: int | None,
    dashboard: bool,
) -> Iterator[Outcome]:
    """The outcomes of the runs `todo`, as they finish."""
    with connected(scheduler, workers, dashboard) as client:
        upload = UploadFile(str(system), load=False)
        upload.filename = f"{digest}.ssp"  # a worker may serve several campaigns
        client.register_plugin(upload, name=digest)
        numbers = {
            client.submit(_perform_here, upload.filename, experiment, number, values, limit, pure=False): number
            for number, values in todo.items()
        }
        for future in as_completed(list(numbers)):
            number = numbers.pop(future)
            error = future.exception()
            if isinstance(error, KilledWorker):
                reason = "the process that ran it died, repeatedly: an FMU crashed, or memory ran out"
                yield failed(number, todo[number], reason)
            elif isinstance(error, ImportError):
                raise ExperimentError(f"a worker cannot run the campaign: {error}")
            elif error is not None:
                raise error
            else:
                yield future.result()
        client.unregister_worker_plugin(digest)


def _perform_here(
    name: str, experiment: Experiment, number: int, values: Mapping[str, float | int], limit: float
) -> Outcome:
    """On a worker: a run of the system that was sent to its folder."""
    return perform(Path(get_worker().local_directory).resolve() / name, experiment, number, values, limit)


def _write_table(outcomes: list[Outcome], path: Path) -> None:
    """One line a run: number, failure, varied values, errors and counts; empty where a run failed."""
    heads = ["run", "failure", *outcomes[0].values]
    columns = list(dict.fromkeys(name for outcome in outcomes for name in outcome.numbers))
    with whole(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*heads, *columns])
        for outcome in outcomes:
            numbers = [outcome.numbers.get(name, "") for name in columns]
            writer.writerow([outcome.run, outcome.failure, *outcome.values.values(), *numbers])
