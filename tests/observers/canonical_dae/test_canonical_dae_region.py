"""Where the canonical DAE observer's assumptions are looked at: between the bounds, and where the equations have a value."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from observers.canonical_dae.region import POINTS, region
from observers.model import Model, ModelError, Variable


def leaking(rate: Callable[[Any], Any], output: Callable[[Any], Any] = lambda x: x.b) -> Model:
    return Model(
        name="leaking",
        states=[Variable("a", start=0.2, min=-1.0, max=1.0), Variable("b", start=3.0, nominal=2.0)],
        inputs=[Variable("u", min=0.0, max=5.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [rate(x), u.u - x.b],
        output=lambda x, u, p, t: [output(x)],
    )


def test_points_lie_within_the_bounds_and_a_nominal_value_to_either_side_where_there_are_none() -> None:
    found = region(leaking(lambda x: -x.a)).points
    assert len(found) == POINTS
    points = np.array([[*states, *inputs] for states, inputs, _, _ in found])
    low, high = np.array([-1.0, 1.0, 0.0]), np.array([1.0, 5.0, 5.0])
    assert (points >= low).all() and (points <= high).all()
    assert (points.min(axis=0) < low + 0.1 * (high - low)).all() and (
        points.max(axis=0) > high - 0.1 * (high - low)
    ).all()


@pytest.mark.parametrize(
    "model",
    [leaking(lambda x: -ca.sqrt(x.a)), leaking(lambda x: -x.a, lambda x: x.b + ca.log(x.a))],
    ids=["a rate", "an output"],
)
def test_points_where_one_of_the_equations_has_no_value_are_left_out(model: Model) -> None:
    a = np.array([states[0] for states, _, _, _ in region(model).points])
    everywhere = np.array([states[0] for states, _, _, _ in region(leaking(lambda x: -x.a)).points])
    np.testing.assert_array_equal(a, everywhere[everywhere > 0])


def test_a_model_without_a_value_at_any_point_is_refused_with_one_of_them() -> None:
    with pytest.raises(
        ModelError, match=r"'leaking' are not finite anywhere .* for example at a = \S+, b = \S+, u = \S+$"
    ):
        region(leaking(lambda x: ca.sqrt(1e-6 - (x.a - 0.2) ** 2)))
