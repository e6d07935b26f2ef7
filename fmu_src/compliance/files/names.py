"""Rules of variables' names: the naming convention, control characters, variables that are branches too."""

from __future__ import annotations

import re
import string
from bisect import bisect_left
from collections.abc import Iterator, Sequence

from fmu_src.compliance.finding import Finding
from fmu_src.compliance.rules import finding

_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")
_INDEXED = r"[A-Za-z_]\w*(?:\[[0-9]+(?:,[0-9]+)*\])?"
_ORDINARY = re.compile(rf"{_INDEXED}(?:\.{_INDEXED})*\Z", re.ASCII)  # most names, and quickly: without quotes and der
_DERIVATIVE = re.compile(r"der\((.*?)(?:,[0-9]+)?\)\Z", re.DOTALL)

_LETTERS = frozenset(string.ascii_letters + "_")
_DIGITS = frozenset(string.digits)
_IN_QUOTES = _LETTERS | _DIGITS | frozenset('!#$%&()*+,-./:;<>=?@[]^{}|~ "\n\r\t\f')

# The grammar of structured names in section 2.2.9 as an automaton, for fmpy's parser of it takes milliseconds a name. The verdicts
# are those of fmpy 0.3.32, which lets a backslash or a double quote stand alone in quotes; so \' may end a quoted name, or not.
_TRANSITIONS: dict[str, list[tuple[frozenset[str], tuple[str, ...]]]] = {
    "begin": [(_LETTERS, ("word",)), (frozenset("'"), ("quote",))],
    "word": [(_LETTERS | _DIGITS, ("word",)), (frozenset("["), ("index",)), (frozenset("."), ("begin",))],
    "quote": [(_IN_QUOTES, ("quoted",)), (frozenset("\\"), ("escape",))],
    "quoted": [(_IN_QUOTES, ("quoted",)), (frozenset("\\"), ("escape",)), (frozenset("'"), ("end",))],
    "escape": [(_IN_QUOTES, ("quoted",)), (frozenset("\\"), ("escape",)), (frozenset("'"), ("end", "quoted"))],
    "end": [(frozenset("["), ("index",)), (frozenset("."), ("begin",))],
    "index": [(_DIGITS, ("number",))],
    "number": [(_DIGITS, ("number",)), (frozenset(","), ("index",)), (frozenset("]"), ("indexed",))],
    "indexed": [(frozenset("."), ("begin",))],
}
_NEXT = {
    state: {character: states for characters, states in rows for character in characters}
    for state, rows in _TRANSITIONS.items()
}
_COMPLETE = frozenset({"word", "end", "indexed"})


def check_names(convention: str, names: Sequence[str]) -> Iterator[Finding]:
    """variable-name and name-branch."""
    for name in names:
        control = _CONTROL.search(name)
        if control is not None:
            yield finding("variable-name", name, "a name without control characters", f"U+{ord(control[0]):04X}")
        elif convention == "structured" and not is_structured(name):
            yield finding("variable-name", name, "a structured name", f"'{name}'")
    if convention == "structured":
        yield from _branches(names)


def _branches(names: Sequence[str]) -> Iterator[Finding]:
    """In the order of characters, the names below a branch begin where the branch and a dot would be."""
    ordered = sorted(set(names))
    for name in names:
        place = bisect_left(ordered, f"{name}.")
        if place < len(ordered) and ordered[place].startswith(f"{name}."):
            yield finding("name-branch", name, "no variable of this name beside those below it", f"'{ordered[place]}'")


def is_structured(name: str) -> bool:
    """Is it a name by the grammar of structured names?"""
    if _ORDINARY.match(name):
        return True
    derivative = _DERIVATIVE.match(name)
    states: tuple[str, ...] = ("begin",)
    for character in derivative[1] if derivative else name:
        states = tuple({after for state in states for after in _NEXT[state].get(character, ())})
        if not states:
            return False
    return not _COMPLETE.isdisjoint(states)
