"""The ports that observers share, and what of the inputs counts: names, units, bounds, and every verdict in its order."""

from __future__ import annotations

import itertools
import math

import casadi as ca
import numpy as np
import pytest

from observers import ports, status
from observers.model import Model, ModelError, Variable

MIXED = Model(
    name="mixed",
    states=[
        Variable("T", "temperature", "degC", start=20.0, nominal=50.0, min=-40.0, max=90.0),
        Variable("v", "speed", "m/s", start=1.0, nominal=4.0),
    ],
    inputs=[Variable("heat", "heating", "W", start=3.0)],
    parameters=[Variable("mass", "mass", "kg", start=2.0, min=0.1, max=9.0)],
    unknown_parameters=[Variable("k", unit="1/s", start=0.25, nominal=0.5, min=0.0)],
    outputs=[Variable("y1", "first", "degC", nominal=50.0), Variable("y2", "second", "m/s", start=7.0)],
    ode=lambda x, u, p, t: [p.k * (5 - x.T) + u.heat / p.mass, -p.k * x.v],
    output=lambda x, u, p, t: [x.T, 2 * x.v + t],
)


def fields(port: ports.Port, *names: str) -> tuple[object, ...]:
    return tuple(getattr(port, name) for name in names)


def test_measurements_start_where_the_model_does_and_known_inputs_where_they_say() -> None:
    found = [fields(p, "name", "unit", "start", "variability") for p in ports.inputs(MIXED)]
    assert found == [
        ("y1", "degC", 20.0, "continuous"),
        ("y2", "m/s", 7.0, "continuous"),  # its own start value comes first
        ("heat", "W", 3.0, "continuous"),
    ]
    assert [fields(p, "name", "kind", "start") for p in ports.validity(MIXED)] == [
        ("measurement_valid.y1", "Boolean", 1),
        ("measurement_valid.y2", "Boolean", 1),
    ]
    assert ports.n_inputs(MIXED) == 5


def test_the_parts_of_the_inputs_are_read_where_the_ports_put_them() -> None:
    u = ca.DM([1.5, 2.5, 9.0, 1.0, 0.0])
    parts = ports.read(MIXED, u)
    assert parts.y.full().ravel().tolist() == [1.5, 2.5] and float(parts.known) == 9.0
    assert parts.offered.full().ravel().tolist() == [1, 0]


@pytest.mark.parametrize(
    ("values", "offered", "valid", "rejected"),
    [
        ([1.0, 2.0], [1, 1], [1, 1], 0),
        ([math.nan, 2.0], [1, 1], [0, 1], 1),
        ([math.nan, 2.0], [0, 1], [0, 1], 0),  # missing is not rejected
        ([1.0, math.inf], [1, 1], [1, 0], 1),
        ([1.0, 2.0], [0, 0], [0, 0], 0),
        ([2e150, math.nan], [1, 1], [0, 0], 1),
        ([1e150, -1e150], [1, 1], [1, 1], 0),
    ],
)
def test_a_measurement_counts_if_it_was_offered_and_is_a_number(values, offered, valid, rejected) -> None:
    found, bad = ports.judged(ca.DM(values), ca.DM(offered))
    assert found.full().ravel().tolist() == valid and float(bad) == rejected


def test_guesses_take_the_models_start_or_the_given_one_within_the_bounds() -> None:
    found = [fields(p, "name", "start", "min", "max", "unit", "variability") for p in ports.guesses(MIXED, {"v": -2.0})]
    assert found == [
        ("guess.T", 20.0, -40.0, 90.0, "degC", "fixed"),
        ("guess.v", -2.0, -math.inf, math.inf, "m/s", "fixed"),
        ("guess.k", 0.25, 0.0, math.inf, "1/s", "fixed"),
    ]
    with pytest.raises(ModelError, match="guess of 'mass': model 'mixed' has no such state or unknown parameter"):
        ports.guesses(MIXED, {"mass": 1.0})
    with pytest.raises(ModelError, match=r"guess of 'T' = 91 lies outside \[-40, 90\]"):
        ports.guesses(MIXED, {"T": 91.0})


def test_parameters_estimates_and_innovations_have_the_models_units_and_sizes() -> None:
    (mass,) = ports.known_parameters(MIXED)
    assert fields(mass, "name", "start", "min", "max", "variability") == ("parameter.mass", 2.0, 0.1, 9.0, "tunable")
    found = [fields(p, "name", "unit", "nominal", "variability") for p in ports.estimates(MIXED)]
    assert found == [
        ("estimate.T", "degC", 50.0, "continuous"),
        ("estimate.v", "m/s", 4.0, "continuous"),
        ("estimate.k", "1/s", 0.5, "continuous"),
        ("filtered.T", "degC", 50.0, "discrete"),
        ("filtered.v", "m/s", 4.0, "discrete"),
        ("filtered.k", "1/s", 0.5, "discrete"),
    ]
    assert all(p.min == -math.inf and p.max == math.inf for p in ports.estimates(MIXED))
    found = [fields(p, "name", "unit", "nominal") for p in ports.innovations(MIXED)]
    assert found == [("diagnostics.innovation[1]", "K", 50.0), ("diagnostics.innovation[2]", "m/s", 1.0)]


def test_deviations_are_the_given_ones_or_a_part_of_the_nominal_value() -> None:
    made = ports.deviations("m", "initial_std", ports.INITIAL_STD, MIXED.states, {"v": 3.0}, 0.1, "fixed", 1e-3)
    found = [fields(p, "name", "unit", "start", "min", "variability") for p in made]
    assert found == [
        ("tuning.initial_std.T", "K", 5.0, 0.05, "fixed"),
        ("tuning.initial_std.v", "m/s", 3.0, 0.004, "fixed"),
    ]
    made = ports.deviations("m", "process_noise", ports.PROCESS_NOISE, MIXED.states, None, 0.5)
    found = [fields(p, "unit", "start", "min", "variability") for p in made]
    assert found == [("", 25.0, 0.0, "tunable"), ("", 2.0, 0.0, "tunable")]
    assert made[0].description.endswith(", in K per sqrt(s)") and made[1].description.endswith(", in m/s per sqrt(s)")
    with pytest.raises(ModelError, match="m: initial_std of 'w'; known: T, v"):
        ports.deviations("m", "initial_std", ports.INITIAL_STD, MIXED.states, {"w": 3.0}, 0.1)


def test_the_default_process_noise_is_a_part_of_the_nominal_value_a_sample() -> None:
    """Its variance grows with the time: over a sample of 0.25 s to a quarter of that over a second."""
    found = [p.start for p in ports.process_noise("m", MIXED, {"v": 7.0}, 0.25)]
    np.testing.assert_allclose(found, [5e-4 * 50 / 0.5, 7.0, 2e-3 * 0.5 / 0.5], rtol=1e-15)


def test_the_same_thing_said_twice_is_refused() -> None:
    ports.refuse_both("m", "Q0", None, "initial_std", {"v": 1})
    ports.refuse_both("m", "Q0", 1, "initial_std", None)
    with pytest.raises(ValueError, match="m: Q0 and initial_std say the same thing"):
        ports.refuse_both("m", "Q0", 1, "initial_std", {})


@pytest.mark.parametrize("value", [0.0, -0.1, math.nan, math.inf, 0.9e-6])
def test_a_sample_time_that_is_none_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match=f"m: sample_time = {value:g} must be at least 1e-06 s and finite"):
        ports.sample_time("m", value)
    made = ports.sample_time("m", 1e-6)
    assert fields(made, "start", "min", "max", "unit", "variability") == (1e-6, 1e-6, 1e6, "s", "fixed")


def test_the_last_part_of_a_structured_name() -> None:
    assert ports.last_name(ports.Port("a.b.c")) == "c" and ports.last_name(ports.Port("y")) == "y"


def test_of_two_conditions_the_graver_is_the_status_whatever_their_order() -> None:
    codes = range(1, len(status.STATUS.items) + 1)
    assert float(ca.DM(status.worst())) == status.CODE.estimating == 1
    for one, other in itertools.permutations(codes, 2):
        for a, b in itertools.product((0, 1), repeat=2):
            expected = max(one * a, other * b, 1)
            assert float(status.worst((ca.DM(a), one), (ca.DM(b), other))) == expected


def test_what_is_trusted_are_the_statuses_up_to_a_rejected_sample() -> None:
    names = [item for item, _ in status.STATUS.items]
    found = [names[code - 1] for code in range(1, len(names) + 1) if status.trusted(code)]
    assert found == ["estimating", "prediction_kept", "outlier", "sample_rejected"]
    np.testing.assert_array_equal(status.shown(ca.DM(status.CODE.outlier)).full().ravel(), [3, 1])
    np.testing.assert_array_equal(status.shown(ca.DM(status.CODE.settling)).full().ravel(), [5, 0])
