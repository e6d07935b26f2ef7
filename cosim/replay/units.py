"""Units in the head of a log ("v [mV]"), and what turns the numbers of one into those of another."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

import numpy as np

from cosim.system.units import EXPONENTS, Unit, conversion

NONE = ("", "-", "1")  # how a head says that a number has no unit

_BRACKETS = re.compile(r"(?P<name>.*\S)\s*\[\s*(?P<unit>[^\[\]]*?)\s*\]\Z", re.S)
_PARENTHESES = re.compile(r"(?P<name>.*\S)\s*\(\s*(?P<unit>[^()]*?)\s*\)\Z", re.S)
# Nothing else gets to pint, which would work out 9**9**9**9 first.
_FACTOR = r"(?:1|[^\W\d_]{1,20}|[°%µμΩ][^\W\d_]{0,20})(?:(?:\^|\*\*)?[+-]?[1-9])?|[^\W\d_]{0,20}[²³]"
_EXPRESSION = re.compile(rf"\(?(?:{_FACTOR})(?:[.*·/ ]\(?(?:{_FACTOR})\)?)*\)?\Z")
_EXPONENT = re.compile(r"(?<=[^\W\d_])(?:\^|\*\*)?([+-]?[1-9])")
_ALIASES = {"Ohm": "ohm", "rev": "turn", "Nm": "N*m", "percent": "%", "sec": "s", "ºC": "degC"}
_PINT_BASE = (
    "kilogram",
    "meter",
    "second",
    "ampere",
    "kelvin",
    "mole",
    "candela",
    "radian",
)  # in the order of EXPONENTS

DIMENSIONLESS = Unit("1", (0,) * len(EXPONENTS))
SECOND = Unit("s", tuple(int(base == "s") for base in EXPONENTS))


def split(header: str) -> tuple[str, str]:
    """Name and unit of a column: "v [mV]" or "v (mV)"; the unit is "" where there is none. `x[1]` is a name."""
    match = _BRACKETS.match(header)
    if match and not re.fullmatch(r"[\d, ]+", match["unit"]):
        return match["name"], match["unit"]
    match = _PARENTHESES.match(header)
    if match and (match["unit"] in NONE or parse(match["unit"]) is not None):
        return match["name"], match["unit"]
    return header, ""


@cache
def parse(text: str) -> Unit | None:
    """What a unit means, in the spelling of FMI (m/s2) and of most people (m/s^2, m/s²); None for no known unit."""
    if text in NONE:
        return DIMENSIONLESS
    if not _EXPRESSION.match(text) or text.count("(") != text.count(")"):
        return None
    written = _EXPONENT.sub(r"**\1", text.replace("²", "**2").replace("³", "**3").replace("·", ".").replace(".", "*"))
    words = re.sub(r"[^\W\d_]+", lambda word: _ALIASES.get(word[0], word[0]), written.replace(" ", "*"))
    registry = _registry()
    try:
        unit = registry.parse_units(words)
        origin, far = (registry.Quantity(value, unit).to_base_units() for value in (0.0, 2.0**30))
    except Exception:  # pint has no class of errors for what is no unit: of the tokeniser, of its own, of Python
        return None
    exponents = {name: float(power) for name, power in origin.unit_items()}
    if exponents.keys() - set(_PINT_BASE) or any(power % 1 for power in exponents.values()):  # bits, counts; roots
        return None
    # From afar, so that the offset of a temperature costs the factor no digits.
    factor = float(f"{(far.magnitude - origin.magnitude) / 2.0**30:.15g}")
    return Unit(text, tuple(int(exponents.get(name, 0)) for name in _PINT_BASE), factor, float(origin.magnitude))


def expression(text: str) -> str:
    """The unit in the spelling of FMI: "m/s^2" and "m/s²" are m/s2, "°C" is degC, "N*m" is N.m; "" for none."""
    if text in ("", "-"):
        return "" if not text else "1"
    written = _EXPONENT.sub(r"\1", text.replace("²", "2").replace("³", "3"))
    for other, ours in (
        ("·", "."),
        ("*", "."),
        (" ", "."),
        ("°C", "degC"),
        ("°", "deg"),
        ("Ω", "Ohm"),
        ("µ", "u"),
        ("μ", "u"),
    ):
        written = written.replace(other, ours)
    return re.sub(r"[^\W\d_]+", lambda word: {"sec": "s", "Nm": "N.m"}.get(word[0], word[0]), written)


@cache
def _registry() -> Any:
    import pint  # takes half a second, and most logs have the unit of the variable or none

    return pint.UnitRegistry(cache_folder=None, autoconvert_offset_to_baseunit=False)


def converted(values: np.ndarray, given: Unit, wanted: Unit) -> np.ndarray:
    """`values` of a unit in another one.

    Raises:
        ValueError: they measure different things.
    """
    linear = conversion(given, wanted)
    divisor = 1 / linear.factor
    if abs(divisor) > 1 and abs(divisor - round(divisor)) < 1e-12 * abs(divisor):
        return values / round(divisor) + linear.offset  # 3850.802 mV is then the number nearest to 3.850802 V
    return values * linear.factor + linear.offset
