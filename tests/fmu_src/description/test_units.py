"""Every unit symbol against the SI brochure's table (9th edition, tables 2 to 8), and products of units against their exponents."""

from __future__ import annotations

import math

import pytest

from fmu_src.description import units
from fmu_src.description.units import parse
from observers.model import Variable
from observers.units import NONE, common, difference, power, product

# Exponents of kg, m, s, A, K, mol, cd, rad; factor to SI base units. FMI counts the radian among the base units, the steradian not.
SI = {
    "1": ((0, 0, 0, 0, 0, 0, 0, 0), 1),
    "g": ((1, 0, 0, 0, 0, 0, 0, 0), 1e-3),
    "m": ((0, 1, 0, 0, 0, 0, 0, 0), 1),
    "s": ((0, 0, 1, 0, 0, 0, 0, 0), 1),
    "A": ((0, 0, 0, 1, 0, 0, 0, 0), 1),
    "K": ((0, 0, 0, 0, 1, 0, 0, 0), 1),
    "mol": ((0, 0, 0, 0, 0, 1, 0, 0), 1),
    "cd": ((0, 0, 0, 0, 0, 0, 1, 0), 1),
    "rad": ((0, 0, 0, 0, 0, 0, 0, 1), 1),
    "sr": ((0, 0, 0, 0, 0, 0, 0, 0), 1),
    "Hz": ((0, 0, -1, 0, 0, 0, 0, 0), 1),
    "N": ((1, 1, -2, 0, 0, 0, 0, 0), 1),
    "Pa": ((1, -1, -2, 0, 0, 0, 0, 0), 1),
    "J": ((1, 2, -2, 0, 0, 0, 0, 0), 1),
    "W": ((1, 2, -3, 0, 0, 0, 0, 0), 1),
    "C": ((0, 0, 1, 1, 0, 0, 0, 0), 1),
    "V": ((1, 2, -3, -1, 0, 0, 0, 0), 1),
    "F": ((-1, -2, 4, 2, 0, 0, 0, 0), 1),
    "Ohm": ((1, 2, -3, -2, 0, 0, 0, 0), 1),
    "S": ((-1, -2, 3, 2, 0, 0, 0, 0), 1),
    "Wb": ((1, 2, -2, -1, 0, 0, 0, 0), 1),
    "T": ((1, 0, -2, -1, 0, 0, 0, 0), 1),
    "H": ((1, 2, -2, -2, 0, 0, 0, 0), 1),
    "lm": ((0, 0, 0, 0, 0, 0, 1, 0), 1),
    "lx": ((0, -2, 0, 0, 0, 0, 1, 0), 1),
    "L": ((0, 3, 0, 0, 0, 0, 0, 0), 1e-3),
    "l": ((0, 3, 0, 0, 0, 0, 0, 0), 1e-3),
    "bar": ((1, -1, -2, 0, 0, 0, 0, 0), 1e5),
    "t": ((1, 0, 0, 0, 0, 0, 0, 0), 1e3),
    "min": ((0, 0, 1, 0, 0, 0, 0, 0), 60),
    "h": ((0, 0, 1, 0, 0, 0, 0, 0), 3600),
    "d": ((0, 0, 1, 0, 0, 0, 0, 0), 86400),
    "deg": ((0, 0, 0, 0, 0, 0, 0, 1), 0.017453292519943295),
    "rev": ((0, 0, 0, 0, 0, 0, 0, 1), 6.283185307179586),
    "rpm": ((0, 0, -1, 0, 0, 0, 0, 1), 0.10471975511965977),
    "degC": ((0, 0, 0, 0, 1, 0, 0, 0), 1),
    "%": ((0, 0, 0, 0, 0, 0, 0, 0), 0.01),
}
NO_PREFIX = {"1", "min", "h", "d", "deg", "rev", "rpm", "degC", "%"}
PREFIXES = {"T": 12, "G": 9, "M": 6, "k": 3, "h": 2, "da": 1, "d": -1, "c": -2, "m": -3, "u": -6, "n": -9, "p": -12}


def exponents(row: tuple[int, ...]) -> dict[str, int]:
    return {
        base: count for base, count in zip(("kg", "m", "s", "A", "K", "mol", "cd", "rad"), row, strict=True) if count
    }


def test_no_symbol_is_known_that_the_table_does_not_have() -> None:
    assert units._SYMBOLS.keys() | units._WHOLE.keys() == SI.keys()
    assert units._PREFIXES.keys() == PREFIXES.keys() and units._WHOLE.keys() | {"1"} == NO_PREFIX


@pytest.mark.parametrize("symbol", SI)
def test_a_symbol_is_what_the_si_says(symbol: str) -> None:
    row, factor = SI[symbol]
    unit = parse(symbol)
    assert unit.exponents == exponents(row)
    assert math.isclose(unit.factor, factor, rel_tol=1e-15)
    assert unit.offset == (273.15 if symbol == "degC" else 0)


@pytest.mark.parametrize("prefix", PREFIXES)
def test_a_prefix_is_a_power_of_ten_of_every_symbol_that_takes_one(prefix: str) -> None:
    for symbol in SI.keys() - NO_PREFIX:
        if prefix + symbol in SI:  # min, cd, Pa: symbols of their own come first
            continue
        row, factor = SI[symbol]
        unit = parse(prefix + symbol)
        assert unit.exponents == exponents(row), prefix + symbol
        assert math.isclose(unit.factor, factor * 10.0 ** PREFIXES[prefix], rel_tol=1e-14), prefix + symbol
    for symbol in sorted(NO_PREFIX - {"1", "h", "d"}):
        if prefix + symbol not in SI:
            with pytest.raises(ValueError, match=r"unknown|no unit"):
                parse(prefix + symbol)


@pytest.mark.parametrize(
    ("expression", "row", "factor", "offset"),
    [
        ("m2", (0, 2, 0, 0, 0, 0, 0, 0), 1, 0),
        ("mm2", (0, 2, 0, 0, 0, 0, 0, 0), 1e-6, 0),
        ("km/h", (0, 1, -1, 0, 0, 0, 0, 0), 1 / 3.6, 0),
        ("l/min", (0, 3, -1, 0, 0, 0, 0, 0), 1e-3 / 60, 0),
        ("kg.m2/s2", (1, 2, -2, 0, 0, 0, 0, 0), 1, 0),
        ("kN.m/(rad.s)", (1, 2, -3, 0, 0, 0, 0, -1), 1e3, 0),
        ("m+2", (0, 2, 0, 0, 0, 0, 0, 0), 1, 0),
        ("W/(m2.degC)", (1, 0, -3, 0, -1, 0, 0, 0), 1, 0),  # a difference: no offset
        ("degC/s", (0, 0, -1, 0, 1, 0, 0, 0), 1, 0),
        ("(m.s)/A", (0, 1, 1, -1, 0, 0, 0, 0), 1, 0),
        ("1/ms", (0, 0, -1, 0, 0, 0, 0, 0), 1e3, 0),
        ("s/s", (0, 0, 0, 0, 0, 0, 0, 0), 1, 0),
    ],
)
def test_a_product_multiplies_exponents_and_factors(
    expression: str, row: tuple[int, ...], factor: float, offset: float
) -> None:
    unit = parse(expression)
    assert unit.exponents == exponents(row)
    assert math.isclose(unit.factor, factor, rel_tol=1e-14) and unit.offset == offset


@pytest.mark.parametrize(
    ("expression", "words"),
    [
        ("", "'' is no unit"),
        ("m..s", "'' is no unit"),
        ("m/s.kg", "'s.kg' after the solidus needs parentheses"),
        ("m/s/s", "'s/s' is no unit with an integer exponent"),
        ("1m", "'1m' is no unit"),
        ("10", "'10' is no unit"),
        ("km1.5", "'5' is no unit"),
        ("kmin", "the symbol 'kmin' is unknown"),
    ],
)
def test_what_is_no_unit_is_refused_with_the_part_that_is_none(expression: str, words: str) -> None:
    with pytest.raises(ValueError) as refused:
        parse(expression)
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("factors", "text"),
    [
        ([("m/s2", 1), ("s", 2)], "m"),
        ([("V", -2)], "1/V2"),
        ([("V", -2), ("s", -2)], "1/(V2.s2)"),
        ([("m", 1), ("m", 1)], "m2"),
        ([("1", 3)], "1"),
        ([("m", 1), ("s", -1)], "m/s"),
        ([("m", 1), ("1/m", 1)], "1"),
        ([("kg.m2/(s3.A)", 2)], "kg2.m4/(s6.A2)"),
        ([("s-1", 1), ("m", 1)], "m/s"),
        ([("%", 2)], "%2"),
        ([("m", 1), (NONE, 1)], NONE),
        ([("m 2", 1)], NONE),
    ],
)
def test_products_of_unit_expressions_are_written_in_their_grammar(factors: list[tuple[str, int]], text: str) -> None:
    assert product(factors) == text
    if text:
        expected = units.ONE
        for unit, count in factors:
            expected = expected * parse(unit) ** count
        assert parse(text).exponents == expected.exponents


def test_a_power_is_a_product_and_a_difference_of_temperatures_is_in_kelvin() -> None:
    assert power("m/s", 2) == "m2/s2" and power("m/s", -1) == "s/m" and power("m/s", 0) == "1"
    assert difference("degC") == "K" and difference("rad/s") == "rad/s"


def test_variables_share_a_unit_or_have_none_in_common() -> None:
    a, b, c = Variable("a", unit="degC"), Variable("b", unit="K"), Variable("c", unit="m")
    assert common([a, b]) == "K" and common([c]) == "m" and common([a, c]) == NONE and common([]) == NONE
