"""A user's equations, called with symbols: what a function returned, or one sentence with its line and the CasADi way."""

from __future__ import annotations

import linecache
import re
import sysconfig
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

_LIBRARIES = tuple({sysconfig.get_paths()[name] for name in ("purelib", "platlib", "stdlib")})
_NOT_THE_USERS = (*(str(Path(place).parent) for place in (__file__, str(ca.__file__), np.__file__)), *_LIBRARIES)
_NO_TRUTH = (
    "Python's if, while, and, or, not, min, max and a < b < c want to know now what only the running observer knows: write "
    "ca.if_else(condition, a, b), ca.logic_and(a, b), ca.logic_or(a, b), ca.logic_not(a), ca.fmin(a, b), ca.fmax(a, b)"
)
_NO_NUMBER = "{what} wants a number, and a symbol stands for one that is not known yet: write {cure}"
_TABLE = (
    "ca.interpolant('ocv', 'linear', [grid], values), or 'bspline', wants the grid as a list within a list, ascending, and a value for "
    "each of its points"
)
_SYMBOL = "; a symbol stands for a number that is not known yet, so that only CasADi's functions take it (import casadi as ca)"


class ModelError(ValueError):
    """The equations or the names of a model contradict each other; the message names what and where."""


class _NoNumber(Exception):
    """A symbol was taken for a number."""


def evaluated(where: str, equations: Callable[..., Iterable[Any]], arguments: Sequence[Any], names: str) -> list[Any]:
    """The expressions that a user's function returns for symbols; `names` are those of its arguments, `(x, u, p, t)`.

    Raises:
        ModelError: it is no function, it fails, or it returns one expression by itself; the message begins with `where`.
    """
    if not callable(equations):
        raise ModelError(
            f"{where}: a function of {names} is wanted, lambda {names[1:-1]}: [...], not {described(equations)}"
        )
    try:
        with _symbols_are_no_numbers(), warnings.catch_warnings():
            # numpy's functions on symbols give what CasADi's own do; casadi announces a change of shapes.
            warnings.filterwarnings("ignore", category=FutureWarning)
            return listed(equations(*arguments))
    except ModelError as error:
        raise ModelError(f"{where}{_line(error)[0]}: {error}") from None
    except Exception as error:  # a user's equations can fail in any way; the message says where
        line, text = _line(error)
        raise ModelError(f"{where}{line}: {_cure(error, text, names)}") from error


def listed(returned: Any) -> list[Any]:
    """The expressions that a user's function returned.

    Raises:
        ModelError: it is one by itself, or none.
    """
    if isinstance(returned, (int, float, ca.DM, ca.SX)):
        raise ModelError("a list of expressions is wanted, [...], not one by itself")
    if isinstance(returned, (str, dict)) or not isinstance(returned, Iterable):
        raise ModelError(f"a list of expressions is wanted, [...], not {described(returned)}")
    return list(returned)


def described(value: Any) -> str:
    """What a user gave, for a message: text, None, a dict, the number 3."""
    if value is None:
        return "None"
    if isinstance(value, str):
        return f"the text {value!r}"
    if isinstance(value, (int, float)):
        return f"the number {value!r}"
    name = type(value).__name__
    return f"{'an' if name[0].lower() in 'aeiou' else 'a'} {name}"


def _line(error: Exception) -> tuple[str, str]:
    """ ", line 7" of the user's file, where the error came from, and the text of that line."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if not frame.filename.startswith((*_NOT_THE_USERS, "<")) and frame.lineno is not None:
            text = linecache.getline(frame.filename, frame.lineno)
            return f", line {frame.lineno} of {Path(frame.filename).name}", text
    return "", ""


def _cure(error: Exception, line: str, names: str) -> str:
    message = str(error)
    if "truth value" in message and ("CasADi" in message or "SX" in message):
        return _NO_TRUTH
    if isinstance(error, _NoNumber):
        found = re.search(r"\bmath\.(\w+)", line)
        if found:
            cure = f"ca.{found[1]}" if hasattr(ca, found[1]) else "it with CasADi's functions"
            return _NO_NUMBER.format(what=f"math.{found[1]}", cure=cure)
        return _NO_NUMBER.format(
            what="float(), or a function of the module math,", cure="CasADi's, such as ca.sin, ca.sqrt"
        )
    if isinstance(error, TypeError) and ("positional argument" in message or "unexpected keyword" in message):
        return f"{message}: a function of {names} is wanted"
    table = of_a_table(error)
    if table:
        return table
    told = f"{type(error).__name__}: {message}"
    if "array element with a sequence" in message:  # what scipy's functions say of symbols
        return f"{told}{_SYMBOL}; for a table, ca.interpolant"
    return told + _SYMBOL if re.search(r"\bSX\b", message) else told


def of_a_table(error: BaseException) -> str:
    """What a failed `ca.interpolant` comes down to, in one sentence; nothing for any other error."""
    message = str(error)
    if not isinstance(error, RuntimeError) or "interpolant" not in message.lower():
        return ""
    said = re.search(r"failed:\s*([^\n]+)", message)
    return f"{said[1].strip().rstrip('.')}; {_TABLE}" if said else _TABLE


@contextmanager
def _symbols_are_no_numbers() -> Iterator[None]:
    """float() of a symbol fails: in CasADi it is NaN, so that math.sin(x) goes on as a NaN without a word."""
    original = ca.SX.__float__

    def number(self: ca.SX) -> float:
        if not self.is_constant():
            raise _NoNumber
        return float(original(self))

    setattr(ca.SX, "__float__", number)  # noqa: B010  # mypy knows it as a method
    try:
        yield
    finally:
        setattr(ca.SX, "__float__", original)  # noqa: B010
