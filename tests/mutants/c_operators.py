"""The faults that are tried on C: found in its tokens. What does not compile without a warning is no mutant (sandbox.py)."""

from __future__ import annotations

import re

Mutation = tuple[str, int, int, str]  # (operator, start, end, new text)

_BLANK = re.compile(
    r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])*\'|^[ \t]*#(?!define)[^\n]*', re.S | re.M
)
_OPERAND = r"(?<=[\w)\]])"

# (operator, pattern whose whole match is replaced, what by)
PATTERNS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("arithmetic", _OPERAND + r" \+ (?=[\w(])", (" - ",)),
    ("arithmetic", _OPERAND + r" - (?=[\w(])", (" + ",)),
    ("arithmetic", _OPERAND + r" \* (?=[\w(])", (" / ",)),
    ("arithmetic", _OPERAND + r" / (?=[\w(])", (" * ",)),
    ("comparison", r" < ", (" <= ", " >= ")),
    ("comparison", r" <= ", (" < ", " > ")),
    ("comparison", r" > ", (" >= ", " <= ")),
    ("comparison", r" >= ", (" > ", " < ")),
    ("comparison", r" == ", (" != ",)),
    ("comparison", r" != ", (" == ",)),
    ("and/or", r" && ", (" || ",)),
    ("and/or", r" \|\| ", (" && ",)),
    ("condition", r"(?<=[ (])!(?=[\w(])", ("",)),
    ("swapped function", r"\bfmin\b", ("fmax",)),
    ("swapped function", r"\bfmax\b", ("fmin",)),
    ("swapped function", r"\bfloor\b", ("ceil",)),
    ("swapped function", r"\bceil\b", ("floor",)),
    ("swapped function", r"\bisnan\b", ("isinf",)),
    ("constant", r"\btrue\b", ("false",)),
    ("constant", r"\bfalse\b", ("true",)),
)
_NUMBER = re.compile(r"(?<![\w.])(\d+\.\d*(?:[eE][+-]?\d+)?|\d+[eE][+-]?\d+|\d+)(?![\w.])")
_STATEMENT = re.compile(
    r"^[ \t]+((?:[\w.\[\]]|->)+ (?:[-+|*^]?=) [^;{}]*;|(?:mem(?:set|cpy)|report|set_defaults)\([^;{}]*\);|\w[\w.>-]*\+\+;)",
    re.M,
)


def mutations(text: str) -> list[Mutation]:
    """Every fault that the operators know in `text`."""
    code = _BLANK.sub(lambda match: re.sub(r"[^\n]", " ", match[0]), text)
    found: list[Mutation] = []
    for operator, pattern, news in PATTERNS:
        for match in re.finditer(pattern, code):
            found += [(operator, match.start(), match.end(), new) for new in news]
    for match in _NUMBER.finditer(code):
        number = match[0]
        new = str(int(number) + 1) if number.isdigit() else repr(2 * float(number) or 1.0)
        found.append(("constant", match.start(), match.end(), new))
    found += [("dropped statement", match.start(1), match.end(1), ";") for match in _STATEMENT.finditer(code)]
    return found
