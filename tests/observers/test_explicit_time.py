"""The time that the equations of an observer see: every one follows a model whose rates and outputs depend on t by itself.

It starts at the truth and gets exact samples, so that what it is off by is its own: the collocation's, the interpolation's, or a time that
is not the one it is.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from swing import CONVERGENT, EXACT, SPAN, SWING, T0, TS

from observers.component import Component
from observers.instance import Instance
from observers.least_squares import least_squares
from observers.status import CODE
from reference_models.plant import plant


def errors(component: Component, Ts: float, slope: float = 0.0, settled: float = 0.0) -> float:
    """The largest error of `estimate.*` and `filtered.*` beside the plant, with an input that rises by `slope` per s within each step."""
    observer, true, worst = Instance(component, t0=T0), Instance(plant(SWING), t0=T0), 0.0
    for k in range(round(SPAN / Ts)):
        for one in (observer, true):
            one.set("u", 0.4 + slope * k * Ts)
        observer.set("y", true.get("y"))
        before = [true.get(f"x.{name}") for name in "ab"]
        derivatives = np.zeros(len(observer.u))
        derivatives[[port.name for port in component.inputs].index("u")] = slope
        observer.step(T0 + k * Ts, Ts, derivatives)
        true.step(T0 + k * Ts, Ts, slope)
        if k * Ts < settled:
            continue
        now = [true.get(f"x.{name}") for name in "ab"]
        found = [observer.get(f"{branch}.{name}") for branch in ("filtered", "estimate") for name in "ab"]
        worst = max(worst, float(np.abs(np.array(found) - [*before, *now]).max()))
    assert observer.get("diagnostics.status") == CODE.estimating
    return worst


@pytest.mark.parametrize("kind", EXACT)
def test_from_the_first_sample_on_the_estimate_of_a_time_varying_model_is_exact(kind: str) -> None:
    make, limit = EXACT[kind]
    assert errors(make(TS), TS) < limit


@pytest.mark.parametrize("kind", CONVERGENT)
def test_the_error_falls_with_the_order_of_the_method(kind: str) -> None:
    make, order = CONVERGENT[kind]
    coarse, fine = errors(make(TS), TS, settled=1.0), errors(make(TS / 2), TS / 2, settled=1.0)
    assert fine < coarse / 2 ** (order - 0.7), (coarse, fine)


FOLLOWED = [("ukf", "held"), ("ukf", "linear"), ("riccati", "held"), ("riccati", "linear"), ("elementary", "linear")]


@pytest.mark.parametrize(("kind", "between"), FOLLOWED)
def test_an_input_with_derivatives_moves_the_prediction_as_it_moves_the_plant(kind: str, between: str) -> None:
    """Filters follow the derivatives whatever the model says; what solves for the past has to be told that the input was linear."""
    make, limit = EXACT[kind]
    assert errors(make(TS, replace(SWING, input_between_samples=between)), TS, slope=0.7) < limit


@pytest.mark.parametrize("intervals", [3, 7])
def test_an_interval_that_is_no_clean_quotient_counts_its_samples(intervals: int) -> None:
    """0.3 / 0.1 and 0.7 / 0.1 are below 3 and 7 in doubles. With a guess that is wrong, a reset shows in the conditioning."""
    Ts = 0.1
    assert round(0.1 * intervals, 1) / Ts < intervals
    run = Instance(least_squares(SWING, sample_time=Ts, T=round(0.1 * intervals, 1)), {"guess.b": 0.5})
    sizes = []
    for k in range(4 * intervals):
        run.set("y", 0.3)
        run.step(k * Ts, Ts)
        sizes.append(run.get("diagnostics.contraction"))
        assert run.get("diagnostics.intervals") == k // intervals
    # Within an interval what remains of the initial error goes down, and from its first sample on it starts again.
    starts = [k for k in range(1, len(sizes)) if sizes[k] > sizes[k - 1]]
    assert {later - earlier for earlier, later in pairwise(starts)} == {intervals}
    assert len(starts) >= 3
