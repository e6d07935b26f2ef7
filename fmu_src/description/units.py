"""Unit expressions ("m/s2", "1/(V2.s2)", "kN.m") in SI base units: exponents, factor, offset, as FMI defines units.

The grammar is FMI's, hence Modelica's: factors separated by dots, one solidus at most, an integer exponent straight
after the symbol.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from math import pi

BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


@dataclass(frozen=True)
class Unit:
    """SI value = factor * value + offset, in the product of base units to `exponents`."""

    exponents: dict[str, int] = field(default_factory=dict)
    factor: float = 1.0
    offset: float = 0.0

    def __mul__(self, other: Unit) -> Unit:
        exponents = {b: self.exponents.get(b, 0) + other.exponents.get(b, 0) for b in BASE}
        return Unit({b: e for b, e in exponents.items() if e}, self.factor * other.factor)

    def __pow__(self, power: int) -> Unit:
        return Unit({b: e * power for b, e in self.exponents.items() if e * power}, self.factor**power)


ONE = Unit()
_KG, _M, _S, _A, _K, _MOL, _CD, _RAD = (Unit({base: 1}) for base in BASE)
_N = _KG * _M * _S**-2
_J = _N * _M
_W = _J * _S**-1
_V = _W * _A**-1
_WB = _V * _S

_SYMBOLS = {
    "1": ONE,
    "g": Unit({"kg": 1}, 1e-3),
    **{base: Unit({base: 1}) for base in BASE if base != "kg"},
    "sr": ONE,
    "N": _N,
    "J": _J,
    "W": _W,
    "V": _V,
    "Pa": _N * _M**-2,
    "C": _A * _S,
    "F": _A * _S * _V**-1,
    "Ohm": _V * _A**-1,
    "S": _A * _V**-1,
    "Wb": _WB,
    "T": _WB * _M**-2,
    "H": _WB * _A**-1,
    "Hz": _S**-1,
    "lm": _CD,
    "lx": _CD * _M**-2,
    "L": Unit({"m": 3}, 1e-3),
    "l": Unit({"m": 3}, 1e-3),
    "bar": Unit({"kg": 1, "m": -1, "s": -2}, 1e5),
    "t": Unit({"kg": 1}, 1e3),
}
# These take no prefix.
_WHOLE = {
    "min": Unit({"s": 1}, 60.0),
    "h": Unit({"s": 1}, 3600.0),
    "d": Unit({"s": 1}, 86400.0),
    "deg": Unit({"rad": 1}, pi / 180),
    "rev": Unit({"rad": 1}, 2 * pi),
    "rpm": Unit({"rad": 1, "s": -1}, pi / 30),
    "degC": Unit({"K": 1}, 1.0, 273.15),
    "%": Unit({}, 0.01),
}
_PREFIXES = {
    **{"da": 1e1, "h": 1e2, "k": 1e3, "M": 1e6, "G": 1e9, "T": 1e12},
    **{"d": 1e-1, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9, "p": 1e-12},
}
_FACTOR = re.compile(r"([A-Za-z]+|%|1(?![0-9]))([+-]?[0-9]+)?\Z")


def parse(expression: str) -> Unit:
    """The unit that `expression` means.

    Raises:
        ValueError: no unit expression, or an unknown symbol; the message says which.
    """
    if expression in _WHOLE:
        return _WHOLE[expression]  # alone it may have an offset
    numerator, solidus, denominator = expression.partition("/")
    unit = _product(numerator)
    if solidus:
        if "." in denominator and not denominator.startswith("("):
            raise ValueError(f"'{denominator}' after the solidus needs parentheses")
        unit = unit * _product(denominator) ** -1
    return unit


def _product(text: str) -> Unit:
    if text.startswith("(") and text.endswith(")"):
        text = text[1:-1]
    product = ONE
    for part in text.split("."):
        match = _FACTOR.match(part)
        if not match:
            raise ValueError(f"'{part}' is no unit with an integer exponent")
        product = product * _symbol(match[1]) ** int(match[2] or 1)
    return product


def _symbol(symbol: str) -> Unit:
    if symbol in _WHOLE:
        return Unit(_WHOLE[symbol].exponents, _WHOLE[symbol].factor)
    if symbol in _SYMBOLS:
        return _SYMBOLS[symbol]
    for prefix, factor in _PREFIXES.items():
        if symbol.startswith(prefix) and symbol[len(prefix) :] in _SYMBOLS.keys() - {"1"}:
            return Unit({}, factor) * _SYMBOLS[symbol[len(prefix) :]]
    raise ValueError(f"the symbol '{symbol}' is unknown")
