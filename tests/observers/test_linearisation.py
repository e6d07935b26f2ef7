"""A model's linearisation against differences, and what is refused because no output sees it."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from observers.free_motion import free_motion
from observers.linearisation import (
    MOST_SUBSTEPS,
    chosen_step,
    linearisation,
    prediction_step,
    refuse_undetectable,
    refuse_unobservable,
    unseen,
)
from observers.model import Model, ModelError, Variable

WOBBLY = Model(
    name="wobbly",
    states=[Variable("a", start=0.3), Variable("b", start=-0.2)],
    inputs=[Variable("u", start=0.7)],
    parameters=[Variable("k", start=1.4)],
    unknown_parameters=[Variable("theta", start=0.6)],
    outputs=[Variable("y1"), Variable("y2")],
    ode=lambda x, u, p, t: [x.b * ca.cos(2 * t), -p.k * ca.sin(x.a) - p.theta * x.b * u.u + t**2],
    output=lambda x, u, p, t: [x.a * x.b + t, p.theta * x.a + u.u],
)


def rates(m, u, k, t):
    a, b, theta = m
    return np.array([b * math.cos(2 * t), -k * math.sin(a) - theta * b * u + t**2, 0])


def outputs(m, u, k, t):
    return np.array([m[0] * m[1] + t, m[2] * m[0] + u])


@pytest.mark.parametrize("t", [0.0, 1.3])
def test_values_and_derivatives_are_those_of_the_equations_in_the_order_states_then_parameters(t: float) -> None:
    line = linearisation(WOBBLY)
    assert [v.name for v in line.variables] == ["a", "b", "theta"]
    m, u, k, h = np.array([0.3, -0.2, 0.6]), 0.7, 1.4, 1e-6
    np.testing.assert_allclose(line.rate(m, u, k, t).full().ravel(), rates(m, u, k, t), rtol=0, atol=1e-15)
    np.testing.assert_allclose(line.measure(m, u, k, t).full().ravel(), outputs(m, u, k, t), rtol=0, atol=1e-15)
    for made, function in ((line.jacobian, rates), (line.gradient, outputs)):
        expected = np.column_stack(
            [(function(m + e, u, k, t) - function(m - e, u, k, t)) / (2 * h) for e in h * np.eye(3)]
        )
        np.testing.assert_allclose(made(m, u, k, t).full(), expected, rtol=0, atol=6e-10)
    expected = (rates(m, u, k, t + h) - rates(m, u, k, t - h)) / (2 * h)
    np.testing.assert_allclose(line.rate_t(m, u, k, t).full().ravel(), expected, rtol=0, atol=4e-10)


def hidden(rate: float, **changes: object) -> Model:
    """No output sees h, whose own rate is `rate`; m is seen by itself, and theta by nothing."""
    arguments: dict[str, object] = dict(
        name="hidden",
        states=[Variable("m", start=1.0), Variable("h", start=0.5)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-x.m, rate * x.h],
        output=lambda x, u, p, t: [x.m],
    )
    return Model(**(arguments | changes))  # type: ignore[arg-type]


def test_what_no_output_sees_is_named() -> None:
    assert unseen(hidden(-1.0)) == [1]
    with pytest.raises(ModelError, match=r"method: model 'hidden' is not observable: no output ever sees h$"):
        refuse_unobservable(hidden(-1.0), "method")
    blind = hidden(-1.0, unknown_parameters=[Variable("theta"), Variable("phi")])
    with pytest.raises(ModelError, match=r"no output ever sees h, theta, phi$"):
        refuse_unobservable(blind, "method")
    refuse_unobservable(WOBBLY, "method")


def test_what_is_hidden_may_decay_by_itself() -> None:
    refuse_undetectable(hidden(-0.1), "method")
    refuse_undetectable(WOBBLY, "method")
    for rate in (0.0, 0.3):
        with pytest.raises(ModelError) as refused:
            refuse_undetectable(hidden(rate), "method")
        assert str(refused.value) == (
            "method: model 'hidden' is not detectable: no output ever sees h, "
            f"whose slowest mode has the rate {rate:g} 1/s at the start values, not below 0"
        )
    with pytest.raises(ModelError, match=r"no output ever sees h, theta, .* rate 0 1/s"):
        refuse_undetectable(hidden(-1.0, unknown_parameters=[Variable("theta")]), "method")


def test_detectability_is_judged_at_time_zero() -> None:
    """The hidden state decays then, and grows a second later."""
    made = hidden(0.0, ode=lambda x, u, p, t: [-x.m, (2 * t - 1) * x.h])
    refuse_undetectable(made, "method")


def test_an_output_sees_through_algebraic_variables() -> None:
    made = Model(
        name="through",
        states=[Variable("m"), Variable("h")],
        algebraic=[Variable("z")],
        outputs=[Variable("y")],
        ode=lambda x, z, u, p, t: [z.z, -x.h],
        output=lambda x, z, u, p, t: [x.m],
        algebraic_equations=lambda x, z, u, p, t: [z.z - x.h],
    )
    assert unseen(made) == []


def decay(rate, **state: float) -> Model:
    return Model(
        name="decay",
        states=[Variable("x", **state)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-rate(x.x)],
        output=lambda x, u, p, t: [x.x],
    )


def test_the_prediction_step_is_halved_for_what_is_stiff_at_the_start_a_bound_or_a_nominal_value_away() -> None:
    assert prediction_step(decay(lambda x: x), 0.1) == 0.1
    assert prediction_step(decay(lambda x: 100 * x), 0.1) == 0.025  # 100 * 0.025 < 3
    cubic = lambda x: 100 * x**3 / 3  # noqa: E731  slope 100 x^2
    assert prediction_step(decay(cubic, start=0.1), 0.1) == 0.1 / 8  # at start + nominal: 121
    assert prediction_step(decay(cubic, start=0.1, nominal=0.1), 0.1) == 0.1
    assert prediction_step(decay(cubic, start=0.1, nominal=0.1, max=1.0), 0.1) == 0.025
    assert prediction_step(decay(cubic, start=-0.1, nominal=0.1, min=-1.0), 0.1) == 0.025
    assert prediction_step(decay(cubic, start=-0.1, nominal=1.0, max=0.0), 0.1) == 0.1 / 8
    assert prediction_step(decay(cubic, start=0.5, nominal=1.0, min=0.0, max=1.0), 0.1) == 0.025  # none beyond a bound


def test_an_order_that_is_set_is_kept_with_the_error_of_a_prediction() -> None:
    model = decay(lambda x: x, start=1.0)
    for order in (4, 8):
        tableau, step = chosen_step(model, free_motion(model, 0.1), 0.1, order)
        assert (tableau.order, step) == (order, 0.1)
    with pytest.raises(ValueError, match="order = 5 must be 4 or 8"):
        chosen_step(model, None, 0.1, 5)


def test_a_bound_at_which_too_many_substeps_would_be_needed_is_not_looked_at() -> None:
    steep = lambda x: 100 * x**3 / 3  # noqa: E731
    near = math.sqrt(0.9 * 3 * MOST_SUBSTEPS / 0.1 / 100)
    far = math.sqrt(1.1 * 3 * MOST_SUBSTEPS / 0.1 / 100)
    assert prediction_step(decay(steep, nominal=0.01, max=near), 0.1) == 0.1 / MOST_SUBSTEPS
    assert prediction_step(decay(steep, nominal=0.01, max=far), 0.1) == 0.1


def test_a_second_stiff_state_is_found_with_the_others_where_they_start() -> None:
    made = Model(
        name="pair",
        states=[Variable("a", start=2.0), Variable("b", start=1.0)],
        inputs=[Variable("u", start=3.0)],
        parameters=[Variable("k", start=5.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-x.a, -x.a * u.u * p.k * x.b],
        output=lambda x, u, p, t: [x.a + x.b],
    )
    # -d b'/d b = 15 a: 45 at a + nominal
    assert prediction_step(made, 0.1) == 0.05
