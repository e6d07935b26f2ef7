"""The tuning that observers share, as their FMUs show it: start values and units."""

from collections.abc import Callable

import pytest

from components import MOVED
from observers.units import common, difference, power, product
from slave import Slave


@pytest.mark.parametrize("name", ["moved_riccati", "moved_least_squares"])
def test_in_the_fmu_deviations_have_their_variables_unit(slave: Callable[..., Slave], name: str) -> None:
    variables = slave(name).initialize().variables
    assert variables["tuning.measurement_noise.y"].unit == "m"
    assert variables["tuning.initial_std.s"].unit == "m" and variables["tuning.initial_std.v"].unit == "m/s"
    assert variables["diagnostics.innovation"].unit == "m"


def test_in_the_fmu_a_process_noise_has_no_unit_but_the_description_says_it(slave: Callable[..., Slave]) -> None:
    fmu = slave("moved_riccati").initialize()
    noise = fmu.variables["tuning.process_noise.v"]
    assert noise.unit is None and noise.declaredType is None
    assert noise.description == "process noise intensity of speed, in m/s per sqrt(s)"
    found = [fmu.get(f"tuning.{name}") for name in ("process_noise.v", "process_noise.s", "measurement_noise.y")]
    # By default 5e-4 of the nominal value, 1 m, a sample of 0.1 s.
    assert found == pytest.approx([0.3, 5e-4 / 0.1**0.5, 0.2], rel=1e-15)
    assert [fmu.get(f"tuning.initial_std.{v}") for v in "sv"] == [2.0, 1.0]


@pytest.mark.parametrize(
    ("factors", "expected"),
    [
        ([("m/s", 2)], "m2/s2"),
        ([("m", 1), ("m/s", 1)], "m2/s"),
        ([("V", -2), ("s", -1)], "1/(V2.s)"),
        ([("1/(V2.s2)", 1), ("V2", 1)], "1/s2"),
        ([("kg.m/s2", -1)], "s2/(kg.m)"),
        ([("1", 2)], "1"),
        ([("m", 1), ("m", -1)], "1"),
        ([("m-1", 2)], "1/m2"),
        ([("", 2)], ""),
        ([("m^2", 1)], ""),
    ],
)
def test_products_of_units_are_unit_expressions_or_nothing(factors: list[tuple[str, int]], expected: str) -> None:
    assert product(factors) == expected


def test_units_of_deviations_of_temperatures_and_of_states_with_several_units() -> None:
    assert difference("degC") == "K" and power(difference("degC"), 2) == "K2"
    assert common(MOVED.states) == "" and common(MOVED.outputs) == "m"
