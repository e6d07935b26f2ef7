"""Units of covariances and weights: products of unit expressions ("m/s2", "1/(V2.s2)"), as text.

The grammar is that of `Variable.unit`: exponents are whole numbers, so that a unit per sqrt(s) has no expression.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable

from observers.model import Variable

NONE = ""  # a quantity whose unit has no expression
_FACTOR = re.compile(r"([A-Za-z]+|%|1(?![0-9]))([+-]?[0-9]+)?\Z")


def difference(unit: str) -> str:
    """The unit of a difference of two values in `unit`: K for degC, whose zero is no difference's."""
    return "K" if unit == "degC" else unit


def power(unit: str, exponent: int) -> str:
    """`unit` to a power."""
    return product([(unit, exponent)])


def product(factors: Iterable[tuple[str, int]]) -> str:
    """The product of units to whole powers, symbols in the order of their first use; NONE where one of them is no unit expression."""
    exponents: Counter[str] = Counter()
    for unit, power_of_unit in factors:
        numerator, _, denominator = unit.partition("/")
        for part, sign in ((numerator, 1), (denominator or "1", -1)):
            for symbol in part.removeprefix("(").removesuffix(")").split("."):
                match = _FACTOR.match(symbol)
                if not match:
                    return NONE
                exponents[match[1]] += sign * power_of_unit * int(match[2] or 1)
    del exponents["1"]
    above = [_written(symbol, count) for symbol, count in exponents.items() if count > 0]
    below = [_written(symbol, -count) for symbol, count in exponents.items() if count < 0]
    text = ".".join(above) or "1"
    if not below:
        return text
    return f"{text}/{below[0]}" if len(below) == 1 else f"{text}/({'.'.join(below)})"


def common(variables: Iterable[Variable]) -> str:
    """The unit of a difference that all `variables` share; NONE where they have several."""
    found = {difference(v.unit) for v in variables}
    return found.pop() if len(found) == 1 else NONE


def _written(symbol: str, exponent: int) -> str:
    return symbol if exponent == 1 else f"{symbol}{exponent}"
