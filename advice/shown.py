"""The record of an observer over a stream or a log, as a run of its FMU would leave it: what the report draws."""

from __future__ import annotations

import numpy as np

from advice.streams.streams import Values
from advice.streams.verdicts import Tried, driven
from cosim.results import Given, Result
from observers.component import Port
from observers.instance import Instance

OBSERVER, PLANT = "observer", "plant"
VALID = "measurement_valid."


def shown(tried: Tried, title: str, given: Values, truth: Values, samples: int, sample_time: float) -> Result:
    """The observer over `given`, its inputs by name (samples,), beside the `truth` by the plant's outputs (samples + 1,), if there is any.

    Row 0 is before the first sample, row k after the k-th, of the time k Ts. A run that ends early has the rows up to there.
    """
    component = tried.component
    rows, _ = driven(tried, given, samples, sample_time)
    kept = int(np.argmin(np.append(~np.isnan(rows).all(axis=1), False)))
    outputs = np.vstack([Instance(component, tried.parameters).outputs(), rows[:kept]])
    columns = {f"{OBSERVER}.{port.name}": port for port in component.outputs}
    true = {f"{PLANT}.{name}": values[: kept + 1] for name, values in truth.items()}
    units = {name: _unit(port) for name, port in columns.items()}
    return Result(
        system=title,
        step=sample_time,
        time=sample_time * np.arange(kept + 1),
        names=(*columns, *true),
        values=np.column_stack([outputs, *true.values()]),
        units=units | {name: units.get(_estimate(name), "") for name in true},
        descriptions={name: port.description for name, port in columns.items()} | dict.fromkeys(true, ""),
        kinds={name: port.kind for name, port in columns.items()} | dict.fromkeys(true, "Real"),
        items={name: _items(port) for name, port in columns.items() if port.enumeration is not None},
        step_ns={},
        messages=[],
        sources={PLANT: frozenset(), OBSERVER: frozenset({PLANT})},
        inputs=_inputs(tried, given, kept),
    )


def _inputs(tried: Tried, given: Values, kept: int) -> dict[str, Given]:
    """At the instants of the samples; after the last one nothing is measured, and a known input stays."""
    measured = {p.name.removeprefix(VALID) for p in tried.component.inputs if p.name.startswith(VALID)}
    found = {}
    for port in tried.component.inputs:
        if port.name in given:
            values, is_measured = given[port.name][:kept], port.name in measured
            last = np.nan if is_measured or not kept else values[-1]
            found[f"{OBSERVER}.{port.name}"] = Given(np.append(values, last), _unit(port), is_measured)
    return found


def _estimate(truth: str) -> str:
    """The column of the estimate of a truth, `plant.x.<v>` or `plant.z.<v>`."""
    return f"{OBSERVER}.estimate.{truth.split('.', 2)[-1]}"


def _unit(port: Port) -> str:
    return "" if port.unit == "1" else port.unit


def _items(port: Port) -> dict[int, str]:
    assert port.enumeration is not None
    return {code: item for code, (item, _) in enumerate(port.enumeration.items, start=1)}
