"""Arguments of the wrong kind, refused by name before anything is worked out: a text for a number, a number for a dict."""

from __future__ import annotations

import functools
import inspect
import types
import typing
from collections.abc import Callable, Mapping
from numbers import Integral, Real
from typing import Any, ParamSpec, TypeVar

from observers.expressions import ModelError, described

P = ParamSpec("P")
R = TypeVar("R")
_WANTED: dict[Any, tuple[Any, str]] = {
    float: (Real, "a number"),
    int: (Integral, "a whole number"),
    str: (str, "a text"),
    bool: (bool, "True or False"),
}


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """`function`, whose arguments are first compared with their annotations, where these are plain.

    That is float, int, str, bool, classes, Mapping[str, float], alternatives of these and None; anything else is the function's own affair.

    Raises:
        ModelError: (by the function that is returned) an argument of another kind; the message names it and what is wanted.
    """
    signature = inspect.signature(function)
    hints: dict[str, Any] = {}

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        if not hints:
            hints.update(typing.get_type_hints(function))
        try:
            given = signature.bind_partial(*args, **kwargs).arguments
        except TypeError:  # too many, or of no such name: the call itself says so
            given = {}
        for name, value in given.items():
            _check(function.__name__, name, value, hints.get(name, Any))
        return function(*args, **kwargs)

    return call


def _check(function: str, name: str, value: Any, hint: Any) -> None:
    mappings = [typing.get_args(one) for one in _alternatives(hint) if typing.get_origin(one) is Mapping]
    if isinstance(value, Mapping) and mappings:
        numbers = any(of is float for _, of in mappings)
        for key, entry in value.items():
            if not isinstance(key, str):
                raise ModelError(f"{function}: {name} has names for keys, not {described(key)}")
            if numbers and (isinstance(entry, (str, bool)) or entry is None):
                raise ModelError(f"{function}: {name} of '{key}' = {described(entry)}, where a number is wanted")
        return
    known = [_known(one) for one in _alternatives(hint)]
    if all(known) and not any(_fits(value, kind) for kind, _ in known if kind is not None):  # type: ignore[misc]
        wanted = " or ".join(text for _, text in known if text)  # type: ignore[misc]
        raise ModelError(f"{function}: {name} = {described(value)}, where {wanted} is wanted")


def _alternatives(hint: Any) -> tuple[Any, ...]:
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return typing.get_args(hint)
    return (hint,)


def _known(hint: Any) -> tuple[Any, str] | None:
    """The class that a plain hint stands for, and its name in a message; None for a hint that is not plain."""
    if hint in _WANTED:
        return _WANTED[hint]
    if hint is type(None):
        return type(None), ""
    if typing.get_origin(hint) is Mapping:
        return Mapping, "a dict of numbers by name, {'y': 0.1},"
    return (hint, f"a {hint.__name__}") if inspect.isclass(hint) and not typing.get_origin(hint) else None


def _fits(value: Any, kind: Any) -> bool:
    if isinstance(value, bool) and kind in (Real, Integral):
        return False
    return isinstance(value, kind)
