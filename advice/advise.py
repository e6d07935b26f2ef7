"""The advice: a model is moved through its region, its observability judged, and every observer that applies tried on the same data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from advice.candidates import METHODS, Candidate, Refused, Task, candidate
from advice.choice import choose
from advice.log import Recorded, predictions
from advice.observability import Observability, observability
from advice.region import Region, noise_of, region
from advice.sampling import sample_time as fitting
from advice.shown import shown
from advice.streams.corruptions import CLEAN
from advice.streams.motion import Motion
from advice.streams.native import sampled
from advice.streams.streams import Scenario, Streams
from advice.streams.verdicts import Tried
from advice.trajectories import SETTLED, Trajectories
from advice.trial import Outcome, in_nominal, trial
from cosim.results import Result
from observers.model import Model
from reference_models.plant import plant

MOTIONS = 6
CORRUPTED = (0, 1)  # the motions that are corrupted too: one driven by steps, one by sines
SAMPLES = 300  # of a motion
UNDETERMINED = 30  # samples of a window where none determines everything
STEPS = 10  # of the plant, in a sample
AHEAD = 3  # windows that fit into what is predicted of a record
FRESH = MOTIONS  # the motion that no observer is tried on: the choice is shown on it
STAGES = 3 + MOTIONS + 3 * len(METHODS)  # of which `progress` is told at most


@dataclass(frozen=True)
class Advice:
    """What was looked at, found and chosen.

    `rate`: of the fastest mode that the outputs show [1/s], None where the sample time was given; `ahead`: over a record, errors are those
    of predictions so many samples ahead, 0 where they are those of the estimates; `shown`: the choice over a motion that no observer was
    tried on, or over the record, None where there is no choice.
    """

    model: Model
    region: Region
    noise: Mapping[str, float]
    sample_time: float
    rate: float | None
    observability: Observability
    refused: tuple[Refused, ...]
    outcomes: tuple[Outcome, ...]
    choice: Outcome | None
    ahead: int
    shown: Result | None


@np.errstate(all="ignore")  # an observer that runs away is judged; nobody is warned of it
def advise(
    model: Model,
    *,
    noise: Mapping[str, float] | None = None,
    sample_time: float | None = None,
    record: Recorded | None = None,
    progress: Callable[[str], None] = lambda stage: None,
) -> Advice:
    """Which observer for `model`.

    Args:
        noise: standard deviation of a sample by output; a hundredth of the nominal value where it is not given.
        sample_time: Ts [s]; chosen by the model where it is not given.
        record: a log of the system: its inputs drive the motions, its sample time is taken, and errors are those of predicting it.
        progress: is told what is being done, up to STAGES times.

    Raises:
        AdviceError: nothing moves, or nothing that moves can be followed; a noise of what is no output.
    """
    around, deviations = region(model), noise_of(model, noise or {})
    progress("sample time")
    Ts, rate = record.sample_time if record is not None else sample_time, None
    if record is not None:
        around = record.region(model, around)
    if Ts is None:
        Ts, rate = fitting(model, around, deviations)
    true_system = plant(model, max_step=Ts / STEPS)
    settled, linear = round(SETTLED * SAMPLES), model.input_between_samples == "linear"
    scenario = Scenario(model.name, true_system, Ts, SAMPLES, deviations, settled, linear=linear)
    moved = Trajectories(model, around, scenario, record.drive if record is not None else None)
    streams: dict[int, Streams] = {}
    for seed in (*range(MOTIONS), FRESH):
        progress(f"motion {seed + 1}")
        streams[seed] = moved.streams(seed)
    fresh = streams.pop(FRESH)
    progress("observability")
    motion = Motion(true_system, Ts, linear)
    seen = observability(model, motion, streams)
    task = Task(model, Ts, deviations, seen.window or UNDETERMINED)
    made = []
    for method in METHODS:
        progress(f"{method}: building")
        made.append(candidate(method, task))
    able = [c for c in made if isinstance(c, Candidate)]
    outcomes = trial(model, able, streams, CORRUPTED, progress) if able else []
    ahead = 0
    if record is not None:
        ahead = min(AHEAD * task.window, record.samples // 10)
        outcomes = [predicted(model, outcome, record, motion, ahead) for outcome in outcomes]
    choice = choose(outcomes)
    return Advice(
        model,
        around,
        deviations,
        Ts,
        rate,
        seen,
        tuple(c for c in made if isinstance(c, Refused)),
        tuple(sorted(outcomes, key=lambda o: o.total)),
        choice,
        ahead,
        _shown(choice, record, fresh) if choice is not None else None,
    )


def _shown(choice: Outcome, record: Recorded | None, fresh: Streams) -> Result:
    component, Ts = choice.candidate.component, fresh.scenario.sample_time
    tried, method = Tried(component, {}, sampled(component, Ts)), choice.candidate.method
    if record is not None:
        return shown(
            tried, f"{method} over {record.path.name}", record.measured | record.inputs, {}, record.samples, Ts
        )
    stream = fresh.stream(CLEAN, FRESH)
    return shown(tried, f"{method} on a fresh motion", stream.measured | stream.inputs, stream.truth, SAMPLES, Ts)


def predicted(model: Model, outcome: Outcome, record: Recorded, motion: Motion, ahead: int) -> Outcome:
    """The outcome with errors of predictions over the record."""
    component = outcome.candidate.component
    tried = Tried(component, {}, sampled(component, record.sample_time))
    errors = predictions(record, motion, tried, ahead)
    return replace(outcome, errors=errors, total=in_nominal(errors, model.outputs))
