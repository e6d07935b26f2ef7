"""Status, tuning and diagnostics of the observer by elementary problems, as its FMU shows them."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from observers import ports
from observers.component import Port
from observers.elementary.iteration import contributors
from observers.elementary.output_problem import output_problems
from observers.elementary.problems import METHOD, Elementary
from observers.model import Model

SMALLEST = 1e-12  # a weight: with 0 a problem would be singular

DIAGNOSTICS = (
    *ports.VERDICT,
    Port(
        "diagnostics.cost", "sum of squared output residuals over the window, in nominal values", variability="discrete"
    ),
    Port("diagnostics.iterations", "iterations at the last sample", kind="Integer", variability="discrete"),
    Port(
        "diagnostics.change",
        "largest change of a state in the last iteration, in nominal values: compared with tuning.epsilon",
        variability="discrete",
    ),
    Port(
        "diagnostics.contraction",
        "ratio of the last two iterations' changes: how fast the iterations converge",
        variability="discrete",
    ),
    Port(
        "diagnostics.visibility",
        "rms change of the outputs for one nominal value in the least visible direction; 0: not determined",
        variability="discrete",
    ),
)


def limits(K: int) -> tuple[Port, ...]:
    """When the iterations of a sample end, and what counts as seen."""
    epsilon = "change at or below which the iterations stop"
    limit = "iterations a sample at most: what bounds its time; the next sample goes on from where they ended"
    visibility = "diagnostics.visibility below which the status is undetermined"
    return (
        Port("tuning.epsilon", epsilon, start=1e-4, min=0.0, variability="tunable"),
        Port("tuning.iteration_limit", limit, start=K, min=1, max=K, kind="Integer", variability="tunable"),
        Port("tuning.visibility_limit", visibility, start=1e-3, min=0.0, variability="tunable"),
    )


def tuning(
    model: Model,
    problems: tuple[Elementary, ...],
    q: Mapping[str, float],
    r: Mapping[str, Mapping[str, float]],
    weights: Mapping[str, Mapping[str, float]],
) -> tuple[Port, ...]:
    """`tuning.q.<state>`, `tuning.r.<state>.<control>` of each problem, `tuning.weight.<variable>.<state>` of each average; start values 1.

    A problem of a disturbed output goes by the output's name.

    Raises:
        ValueError: a name that is no problem, or no control of it; a value below SMALLEST.
    """
    seen = output_problems(model)
    # The problems go by the names of their states and outputs.
    named = [v.name for v in model.states] + [model.outputs[p.index].name for p in seen]
    controls = {named[p.index]: [v.name for v in p.controls(model)] for p in problems}
    controls |= {
        model.outputs[p.index].name: [model.unknown_disturbances[k].name for k in p.disturbances] for p in seen
    }
    variables = [v.name for v in (*model.states, *model.unknown_disturbances)]
    averaged = {v: [named[i] for i in of] for v, of in zip(variables, contributors(model, problems), strict=True)}
    _check("q", {"": q}, {"": named})
    _check("r", r, controls)
    _check("weights", weights, averaged)
    made = [("q." + name, f"weight of the reference in the problem of {name}", q.get(name, 1.0)) for name in named]
    for name, of in controls.items():
        made += [(f"r.{name}.{c}", f"weight of {c} in the problem of {name}", r.get(name, {}).get(c, 1.0)) for c in of]
    for name, of in averaged.items():
        made += [
            (f"weight.{name}.{c}", f"weight of the problem of {c} in {name}", weights.get(name, {}).get(c, 1.0))
            for c in of
        ]
    return tuple(
        Port(f"tuning.{name}", text, start=start, min=SMALLEST, variability="tunable") for name, text, start in made
    )


def _check(what: str, given: Mapping[str, Mapping[str, float]], known: Mapping[str, list[str]]) -> None:
    for owner, values in given.items():
        if owner not in known:
            raise ValueError(f"{METHOD}: {what} of '{owner}': known are {', '.join(known)}")
        for name, value in values.items():
            label = f"{owner}.{name}".lstrip(".")
            if name not in known[owner]:
                raise ValueError(f"{METHOD}: {what} of '{label}': known are {', '.join(known[owner]) or 'none'}")
            if not SMALLEST <= value < float("inf"):
                raise ValueError(f"{METHOD}: {what} of '{label}' = {value:g} must be finite and at least {SMALLEST:g}")


def guesses(model: Model, guess: Mapping[str, float]) -> tuple[Port, ...]:
    """`guess.<state>`, then `guess.<disturbance>`."""
    disturbances = {v.name: v for v in model.unknown_disturbances}
    states = ports.guesses(model, {name: value for name, value in guess.items() if name not in disturbances})
    return states + tuple(
        Port(
            f"guess.{v.name}",
            f"first guess of the {v.description or v.name}",
            v.unit,
            guess.get(v.name, v.start),
            v.nominal,
            v.min,
            v.max,
            variability="fixed",
        )
        for v in model.unknown_disturbances
    )


def estimates(model: Model) -> tuple[Port, ...]:
    """`estimate.*` of states and disturbances, then `filtered.*`; a disturbance is the mean over the last sample interval."""
    of_states = ports.estimates(model)
    made = []
    for group, variability in (("estimate", "continuous"), ("filtered", "discrete")):
        made += [port for port in of_states if port.name.startswith(group)]
        for v in model.unknown_disturbances:
            text = f"unknown {v.description or v.name}, mean over the last sample interval"
            made.append(Port(f"{group}.{v.name}", text, v.unit, v.start, v.nominal, variability=variability))
    return tuple(made)


def null_direction(model: Model) -> tuple[Port, ...]:
    """`diagnostics.null.<state or disturbance>`: the least visible direction."""
    return tuple(
        Port(
            f"diagnostics.null.{v.name}",
            f"part of {v.name} in the direction that the window sees least; the largest is one nominal value",
            v.unit,
            nominal=v.nominal,
            variability="discrete",
        )
        for v in (*model.states, *model.unknown_disturbances)
    )


def documentation(model: Model, N: int, problems: list[str], null: str) -> str:
    """The method in short, its problems, and what it leaves open, as HTML."""
    listed = "".join(f"<li>{escape(line)}</li>" for line in problems)
    open_ = (
        f"<p>Not determined by a window, along the model's own motion: {escape(null)}. <code>diagnostics.null.*</code> shows such a "
        "direction, <code>diagnostics.visibility</code> how little the measurements see of it; bounds on the disturbance can determine it."
        "</p>"
        if null
        else ""
    )
    return (
        f"<p>States and unknown disturbances of the model {model.name} that fit the last {N} samples, by elementary problems: one scalar "
        "optimal control problem for each state, solved in turns (Calvillo-Corona and Alamir). Connect the measurements and the known "
        f"inputs, and step with at most the sample time.</p><ul>{listed}</ul>{open_}"
        "<p><code>diagnostics.status</code> says whether the estimate can be trusted; <code>estimate.*</code> is of the current time, "
        "<code>filtered.*</code> of the last sample instant. A disturbance is the mean over the last sample interval.</p>"
        f"{ports.VALIDITY_HTML}"
    )
