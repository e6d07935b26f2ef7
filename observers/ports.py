"""The ports that every observer of a model has: the names of design and documentation, made in one place.

The arguments that all observers share:
    model: the equations; what a method cannot treat it refuses by name.
    sample_time: Ts [s], start value of the fixed parameter `sample_time`; finite, at least SHORTEST_SAMPLE_TIME.
    guess: by name, start values of `guess.*` that differ from the model's: states and what else is estimated.
    name: the component's, hence the FMU's; `<model>_<observer>` if absent.
    max_step: the longest step of the prediction between samples [s]; a longer one is cut into equal parts.
    stop_time: of the default experiment [s].
Those of ukf, riccati, least_squares and pseudospectral with an arrival cost, start values of parameters, by name:
    process_noise: `tuning.process_noise.<state or unknown parameter>`, in the variable's unit per sqrt(s): between samples the
        variance grows at the rate of its square.
    measurement_noise: `tuning.measurement_noise.<output>`, standard deviation of a sample.
    initial_std: `tuning.initial_std.<state or unknown parameter>`, standard deviation of the guess; fixed.
A name that is not in a mapping has its default: in process_noise, for a sample, 5e-4 of a state's nominal value and 2e-3 of an unknown
parameter's (divided by sqrt(Ts)); in measurement_noise 0.1 of it; in initial_std the nominal value. Where measurement_noise is not given
at all, the noise is estimated: see `observers.vigilance`.

Inputs are the model's outputs, its known inputs, then a flag for each output that says whether its sample has arrived. `estimate.*` is of
the current time, `filtered.*` of the last sample instant.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from observers import units
from observers.component import SHORTEST_SAMPLE_TIME, Port
from observers.model import Model, ModelError, Variable
from observers.numerics.finite import HUGE
from observers.status import CODE, STATUS


@dataclass(frozen=True)
class Deviation:
    """What a standard deviation of the tuning is: `text`; `per_root_second`: in the variable's unit per sqrt(s), an intensity."""

    text: str
    per_root_second: bool = False


LARGEST_STD = 1e30  # of a nominal value: a deviation that says nothing is known; its fourth power is a number
STATE_PART, PARAMETER_PART = 5e-4, 2e-3  # of a nominal value: default process noise a sample
PROCESS_NOISE = Deviation("process noise intensity of", per_root_second=True)
MEASUREMENT_NOISE = Deviation("standard deviation of a sample of")
INITIAL_STD = Deviation("standard deviation of the guess of")
COUNTERS = (
    Port("diagnostics.rejected_samples", "samples rejected so far", kind="Integer", variability="discrete"),
    Port("diagnostics.solver_failures", "solves that failed so far", kind="Integer", variability="discrete"),
)

# A paragraph of an FMU's documentation.
VALIDITY_HTML = (
    "<p>Where a sample has not arrived, set its <code>measurement_valid.*</code> to false for that step: it then takes no part in the "
    "correction and does not count as rejected.</p>"
)


VERDICT = (
    Port(
        "diagnostics.status",
        "what the estimate is worth, the gravest that applies",
        start=CODE.propagated_guess,
        kind="Enumeration",
        enumeration=STATUS,
        variability="discrete",
    ),
    Port(
        "diagnostics.trusted",
        "whether the estimate is claimed to be within its stated uncertainty",
        kind="Boolean",
        variability="discrete",
    ),
)
FALSE_ALARM = Port(
    "tuning.false_alarm",
    "probability with which a consistency test of the innovations raises a false alarm at a sample",
    start=1e-4,
    min=1e-12,
    max=0.1,
    variability="tunable",
)
DEVIATION_LIMIT = Port(
    "tuning.deviation_limit",
    "standard deviation of an estimate, in units of nominal values, above which the status is uncertain",
    start=0.3,
    min=0.0,
    variability="tunable",
)
RESTARTS = Port(
    "diagnostics.restarts", "times the estimate started again so far", kind="Integer", variability="discrete"
)


def sample_time(owner: str, start: float) -> Port:
    """The fixed parameter `sample_time`, Ts [s], of an observer whose algebra does not depend on it.

    Raises:
        ValueError: `start` is not finite or below SHORTEST_SAMPLE_TIME.
    """
    if not (math.isfinite(start) and start >= SHORTEST_SAMPLE_TIME):
        raise ValueError(f"{owner}: sample_time = {start:g} must be at least {SHORTEST_SAMPLE_TIME:g} s and finite")
    return Port("sample_time", "sample time", "s", start, min=SHORTEST_SAMPLE_TIME, max=1e6, variability="fixed")


def last_name(port: Port) -> str:
    """The part of a structured name behind its last dot."""
    return port.name.rsplit(".", 1)[-1]


def inputs(model: Model) -> tuple[Port, ...]:
    """Measurements, then known inputs, by the model's names. A measurement that nobody connects is that of the start values."""
    return (
        *(
            replace(_like(v.name, v, "measured", "continuous"), start=start)
            for v, start in zip(model.outputs, model.output_starts, strict=True)
        ),
        *(_like(v.name, v, "known input:", "continuous") for v in model.inputs),
    )


def validity(model: Model) -> tuple[Port, ...]:
    """`measurement_valid.<output>`: false where a sample has not arrived."""
    return tuple(
        Port(
            f"measurement_valid.{v.name}",
            f"whether the sample of {v.description or v.name} has arrived",
            start=1,
            kind="Boolean",
            variability="discrete",
        )
        for v in model.outputs
    )


@dataclass(frozen=True)
class Inputs:
    """The parts of the input vector u: `y` (ny), measured, `known` (nu), and `offered` (ny), 1 where `measurement_valid` is true."""

    y: Any
    known: Any
    offered: Any


def n_inputs(model: Model) -> int:
    """The length of the input vector: `inputs`, then `validity`."""
    return 2 * len(model.outputs) + len(model.inputs)


def read(model: Model, u: Any) -> Inputs:
    """The parts of u, a CasADi column with `n_inputs` entries."""
    ny, nu = len(model.outputs), len(model.inputs)
    known = u[ny : ny + nu] if nu else type(u)(0, 1)  # an empty slice would be 1 x 0
    return Inputs(u[:ny], known, u[ny + nu :] > 0.5)


def judged(values: Any, offered: Any) -> tuple[Any, Any]:
    """(valid, rejected): which measurements act (ny), and whether one that was offered is not finite.

    `values` (ny): the measurements, or what a method makes of them before they act.
    """
    finite = ca.fabs(values) <= HUGE  # false for NaN
    valid = ca.logic_and(finite, offered)
    return valid, ca.sum1(ca.logic_and(offered, ca.logic_not(finite))) > 0


def wrapped(model: Model, residual: Any) -> Any:
    """A residual of the outputs (ny), those of an angle (`Variable.wrap`) brought to half a turn on either side of 0."""
    turns = ca.DM([v.wrap for v in model.outputs])
    if not any(v.wrap for v in model.outputs):
        return residual
    whole = ca.DM([v.wrap or 1.0 for v in model.outputs])
    return ca.if_else(turns > 0, residual - whole * ca.floor(residual / whole + 0.5), residual)


def guesses(model: Model, guess: Mapping[str, float]) -> tuple[Port, ...]:
    """`guess.<state or unknown parameter>`: the first guess; the model's start value where `guess` has none.

    Raises:
        ModelError: a name in `guess` that is not estimated, or a value outside the variable's bounds.
    """
    known = {v.name: v for v in _estimated(model)}
    for name, value in guess.items():
        if name not in known:
            raise ModelError(
                f"guess of '{name}': model '{model.name}' has no such state or unknown parameter; known: {', '.join(known)}"
            )
        v = known[name]
        if isinstance(value, (int, float)) and math.isfinite(value) and not v.min <= value <= v.max:
            raise ModelError(f"guess of '{name}' = {value:g} lies outside [{v.min:g}, {v.max:g}]")
        known[name] = replace(v, start=value)
    return tuple(_like(f"guess.{v.name}", v, "first guess of the", "fixed") for v in known.values())


def known_parameters(model: Model) -> tuple[Port, ...]:
    """`parameter.<parameter>`."""
    return tuple(_like(f"parameter.{v.name}", v, "", "tunable") for v in model.parameters)


def estimates(model: Model) -> tuple[Port, ...]:
    """`estimate.<...>` of the current time, then `filtered.<...>` of the last sample instant."""
    return (
        *(_like(f"estimate.{v.name}", v, "estimated current", "continuous") for v in _estimated(model)),
        *(
            _like(f"filtered.{v.name}", v, "estimate at the last sample instant of the", "discrete")
            for v in _estimated(model)
        ),
    )


def innovations(model: Model) -> tuple[Port, ...]:
    """`diagnostics.innovation`, or `diagnostics.innovation[i]` for several outputs."""
    several = len(model.outputs) > 1
    return tuple(
        Port(
            f"diagnostics.innovation[{i}]" if several else "diagnostics.innovation",
            f"measured minus predicted {v.description or v.name}",
            units.difference(v.unit),
            nominal=v.nominal,
            variability="discrete",
        )
        for i, v in enumerate(model.outputs, start=1)
    )


def standard_deviations(model: Model) -> tuple[Port, ...]:
    """`diagnostics.std.<state or unknown parameter>`, of the current estimate: after the last sample, with the process noise since then."""
    return tuple(
        Port(
            f"diagnostics.std.{v.name}",
            f"standard deviation of the estimated {v.description or v.name}",
            units.difference(v.unit),
            nominal=v.nominal,
        )
        for v in (*model.states, *model.unknown_parameters)
    )


def _estimated(model: Model) -> tuple[Variable, ...]:
    return (*model.states, *model.algebraic, *model.unknown_parameters)


def deviations(
    owner: str,
    group: str,
    what: Deviation,
    variables: Sequence[Variable],
    values: Mapping[str, float] | None,
    part: float,
    variability: str = "tunable",
    smallest: float = 0.0,
) -> tuple[Port, ...]:
    """`tuning.<group>.<variable>`, standard deviations or intensities; by default `part` of the nominal values.

    A standard deviation has its variable's unit. An intensity, in that unit per sqrt(s), has none that FMI could say: the description does.

    Raises:
        ModelError: a name in `values` that is none of the `variables`, a value above LARGEST_STD of the nominal value or below `smallest`.
    """
    given = dict(values or {})
    made = []
    for v in variables:
        unit = units.difference(v.unit)
        words = f", in {unit} per sqrt(s)" if what.per_root_second else ""
        made.append(
            Port(
                f"tuning.{group}.{v.name}",
                f"{what.text} {v.description or v.name}{words}",
                units.NONE if what.per_root_second else unit,
                given.pop(v.name, part * v.nominal),
                min=smallest * v.nominal,
                max=LARGEST_STD * v.nominal,
                variability=variability,
                given=v.name in (values or {}),
            )
        )
    if given:
        raise ModelError(f"{owner}: {group} of '{next(iter(given))}'; known: {', '.join(v.name for v in variables)}")
    return tuple(made)


def intensities(model: Model, sample_time: float, of_state: float, of_parameter: float) -> dict[str, float]:
    """What makes these parts of a nominal value a sample, by name: of states, of unknown parameters, in their unit per sqrt(s)."""
    parts = [(v, of_state) for v in model.states] + [(v, of_parameter) for v in model.unknown_parameters]
    return {v.name: part * v.nominal / math.sqrt(sample_time) for v, part in parts}


def process_noise(owner: str, model: Model, values: Mapping[str, float] | None, sample_time: float) -> tuple[Port, ...]:
    """`tuning.process_noise.<state or unknown parameter>`; by default STATE_PART or PARAMETER_PART of the nominal values a sample.

    Raises:
        ModelError: a name in `values` that is neither.
    """
    variables = (*model.states, *model.unknown_parameters)
    usual = intensities(model, sample_time, STATE_PART, PARAMETER_PART)
    return deviations(owner, "process_noise", PROCESS_NOISE, variables, usual | dict(values or {}), 0.0)


def refuse_both(owner: str, paper: str, by_paper: object, deviation: str, by_deviation: object) -> None:
    """Raise a ValueError if the same thing is given in both ways, neither of them None."""
    if by_paper is not None and by_deviation is not None:
        raise ValueError(f"{owner}: {paper} and {deviation} say the same thing: give one of them")


def _like(name: str, v: Variable, text: str, variability: str) -> Port:
    """A port called `name` with the unit, start and nominal of `v`; a parameter has its bounds too."""
    port = Port(name, f"{text} {v.description or v.name}".strip(), v.unit, v.start, v.nominal, variability=variability)
    return replace(port, min=v.min, max=v.max) if variability in ("fixed", "tunable") else port
