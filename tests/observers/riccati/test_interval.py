"""Interval bounds against sampled values: never below, and tight where the function allows it."""

import casadi as ca
import numpy as np
import pytest

from observers.riccati.interval import IntervalError, interval, ranges

x, y = ca.SX.sym("x"), ca.SX.sym("y")


@pytest.mark.parametrize(
    "expression",
    [
        x * y + ca.sin(3 * x) - y**3,
        ca.sqrt(x**2 + 1) / (2 + ca.cos(y)),
        ca.tanh(x) * ca.fabs(y) + ca.exp(-(x**2)),
        ca.if_else(x > 0.2, y, -x),
        ca.fmax(x, y) - ca.fmin(x, 0.3) ** 2,
        (x + 3) ** 2.5 + (x + 3) ** -2 + ca.atan(y) + ca.sign(x) + ca.log(3 + y),
    ],
    ids=str,
)
def test_a_range_holds_every_value(expression):
    function = ca.Function("f", [x, y], [expression])
    found = ranges(function, [[interval(-1.0, 0.7)], [interval(-0.5, 2.0)]])[0]
    rng = np.random.default_rng(0)
    values = np.array(
        [float(function(a, b)) for a, b in zip(rng.uniform(-1, 0.7, 500), rng.uniform(-0.5, 2, 500), strict=True)]
    )
    assert np.isfinite(found.radius).all()
    assert np.all(np.abs(values - found.middle[0, 0]) <= found.radius[0, 0] * (1 + 1e-12))


def test_a_bounded_function_of_an_unbounded_variable_has_a_bound_and_another_has_none():
    everything = [[interval(-np.inf, np.inf)]]
    bounded = ranges(ca.Function("f", [x], [ca.cos(x) / 3]), everything)[0]
    assert bounded.radius[0, 0] == pytest.approx(1 / 3, rel=5e-9)
    assert ranges(ca.Function("f", [x], [x**2]), everything)[0].radius[0, 0] == np.inf


def test_an_unknown_operation_is_refused_by_name():
    with pytest.raises(IntervalError, match="OP_ERF"):
        ranges(ca.Function("f", [x], [ca.erf(x)]), [[interval(0.0, 1.0)]])


@pytest.mark.parametrize(
    ("expression", "a", "b", "low", "high"),
    [
        (x**2, -1.0, 3.0, 0.0, 9.0),
        (x**2, 2.0, 3.0, 4.0, 9.0),
        (x**2, -3.0, -2.0, 4.0, 9.0),
        (x * 2 - 1, -1.0, 3.0, -3.0, 5.0),
        (ca.fabs(x), -1.0, 3.0, 0.0, 3.0),
        (ca.exp(x), 0.0, 1.0, 1.0, np.e),
        (1 / x, 2.0, 4.0, 0.25, 0.5),
    ],
    ids=str,
)
def test_a_simple_function_has_exactly_its_range(expression, a, b, low, high):
    found = ranges(ca.Function("f", [x], [expression]), [[interval(a, b)]])[0]
    middle, radius = found.middle[0, 0], found.radius[0, 0]
    assert (middle - radius, middle + radius) == pytest.approx((low, high), abs=1e-7)
    assert middle - radius <= low + 1e-15 and middle + radius >= high - 1e-15
