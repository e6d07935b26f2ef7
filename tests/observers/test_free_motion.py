"""The step is chosen where a model goes, not only where it starts; and what no step would mend does not choose it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from observers.free_motion import DWELL, FAR, HORIZON, POINTS, free_motion
from observers.linearisation import prediction_step
from observers.model import Model, Variable

LONGEST = 0.05


def single(rate: Callable[[Any, Any], Any], start: float, min: float = -math.inf) -> Model:
    return Model(
        name="single",
        states=[Variable("x", start=start, min=min)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [rate(x.x, t)],
        output=lambda x, u, p, t: [x.x],
    )


def relaxation(mu: float, x: float, v: float = 0.0) -> Model:
    """Van der Pol's oscillator: slow near x = 0, v = 0, fast on its way."""
    return Model(
        name="relaxation",
        states=[Variable("x", start=x), Variable("v", start=v)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.v, mu * (1 - x.x**2) * x.v - x.x],
        output=lambda x, u, p, t: [x.x],
    )


def relaxation_dae(mu: float, x: float) -> Model:
    return Model(
        name="relaxation_dae",
        states=[Variable("x", start=x), Variable("v")],
        algebraic=[Variable("a", start=-x)],
        outputs=[Variable("y")],
        ode=lambda x, z, u, p, t: [x.v, z.a],
        algebraic_equations=lambda x, z, u, p, t: [z.a - mu * (1 - x.x**2) * x.v + x.x],
        output=lambda x, z, u, p, t: [x.x],
    )


@pytest.mark.parametrize("start", [(2.0, 0.0), (1.0, 0.0), (0.5, 0.0), (0.01, 0.0), (0.0, 1.0), (-3.0, 5.0)])
def test_the_step_is_short_enough_for_where_the_model_goes(start: tuple[float, float]) -> None:
    """On the limit cycle the fastest rate is 300 1/s: 3 / 300 s would be stable, and a third of it is accurate."""
    assert 0.001 < prediction_step(relaxation(100.0, *start), LONGEST, tolerance=1e-6) <= LONGEST / 16


def test_so_it_is_with_algebraic_variables() -> None:
    assert prediction_step(relaxation_dae(100.0, 0.5), LONGEST, tolerance=1e-6) == LONGEST / 16


def test_a_tighter_tolerance_wants_a_shorter_step() -> None:
    steps = [prediction_step(relaxation(100.0, 0.5), LONGEST, tolerance=part) for part in (1e-2, 1e-6, 1e-10)]
    assert steps == sorted(steps, reverse=True) and steps[0] > steps[-1]


@pytest.mark.parametrize(
    "model",
    [
        single(lambda x, t: -x, 1.0),
        single(lambda x, t: x, 1.0),  # grows for ever
        single(lambda x, t: x + x**3, 0.1),  # is infinite at 2.3 s
        single(lambda x, t: x**2, 1.0),
        single(lambda x, t: 0.3 - ca.sign(x), 1.0),  # slides along a jump
        single(lambda x, t: ca.if_else(ca.sin(t) > 0, 1.0, -1.0) - x, 0.0),
        single(lambda x, t: ca.fmod(t, 1.0) - x, 0.0),
        single(lambda x, t: ca.fabs(ca.sin(t)) - x, 0.0),
        single(lambda x, t: -ca.sqrt(x), 1.0),  # empty at 2 s, and not a number afterwards
        single(lambda x, t: -ca.sqrt(x), 1.0, min=0.0),
        single(lambda x, t: -1 / x, 1.0, min=0.0),  # infinitely fast at 0.5 s
        single(lambda x, t: ca.log(x) - 1, 1.0),
        single(lambda x, t: 1e3, 0.0),
    ],
)
def test_what_no_step_would_mend_leaves_it_alone(model: Model) -> None:
    assert prediction_step(model, LONGEST) == LONGEST


def test_a_motion_ends_where_it_is_left_alone_for_long() -> None:
    found = free_motion(single(lambda x, t: -x, 1.0), LONGEST)
    assert found is not None
    assert found.times[0] == 0 and found.times[-1] == HORIZON * LONGEST and len(found.times) < POINTS
    assert np.allclose(found.states[0], np.exp(-found.times), rtol=0, atol=1e-5)
    assert found.scale == [1.0]


def test_a_motion_is_left_before_it_leaves_the_bounds() -> None:
    found = free_motion(single(lambda x, t: -1.0, 40.0, min=0.0), 0.1)
    assert found is not None and found.times[-1] <= 40.0 - DWELL * 0.1 + 1e-6
    assert free_motion(single(lambda x, t: -10.0, 4.0, min=0.0), 0.1) is None  # leaves them at once
    assert free_motion(single(lambda x, t: FAR, 0.0), 0.1) is None


def test_inputs_and_parameters_are_at_their_start_values() -> None:
    model = Model(
        name="driven",
        states=[Variable("x")],
        inputs=[Variable("u", start=3.0)],
        parameters=[Variable("k", start=2.0)],
        unknown_parameters=[Variable("a", start=5.0)],
        unknown_disturbances=[Variable("w", start=1.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [p.k * (u.u + p.a + u.w - x.x)],
        output=lambda x, u, p, t: [x.x],
    )
    found = free_motion(model, 0.1)
    assert found is not None and abs(found.states[0, -1] - 9.0) < 1e-4
