"""What a check yields."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

LONGEST = 300  # characters of a text from the FMU that a finding repeats
_SHOWN = 3  # subjects of a cause that a line names
_PARTICULAR = re.compile(
    r"""'[^']*'|"[^"]*"|(?<![\w.])[-+]?\d[\w.]*(e[-+]\d+)?|\b(nan|inf|infinity|True|False)\b""", re.IGNORECASE
)


class CannotCheck(Exception):
    """The check cannot go on; the message names the file and says why."""


@dataclass(frozen=True)
class Finding:
    """A rule broken: `subject` is the variable, file or function, `expected` and `found` say the rest.

    `more`: further subjects with the same cause.
    """

    rule: str
    section: str
    subject: str
    expected: str
    found: str
    more: tuple[str, ...] = ()

    @property
    def subjects(self) -> tuple[str, ...]:
        return (self.subject, *self.more)

    def __str__(self) -> str:
        named = ", ".join(self.subjects[:_SHOWN])
        rest = len(self.subjects) - _SHOWN
        subject = f"{named} and {rest} more" if rest > 0 else named
        return f"{self.rule} [{self.section}] {subject}: expected {self.expected}; found {self.found}"


@dataclass
class Report:
    """What was found in one FMU, of this version of FMI. `checked`: the rules that were applied; `notes`: why others were not."""

    fmu: Path
    version: str = "2.0"
    checked: list[str] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def escaped(text: str) -> str:
    """`text` without what could end or rewrite a line of a terminal."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def one_line(text: str) -> str:
    """The same, not longer than LONGEST."""
    cut = escaped(text.strip()[:LONGEST])
    return cut if len(text.strip()) <= LONGEST else f"{cut} ..."


def by_cause(findings: Iterable[Finding]) -> list[Finding]:
    """One finding for each rule and cause, in the order of the first ones, with the other subjects in `more`."""
    groups: dict[tuple[str, str], list[Finding]] = {}
    for found in findings:
        groups.setdefault((found.rule, _cause(found)), []).append(found)
    return [
        replace(first, more=tuple(dict.fromkeys(s for f in group for s in f.subjects if s != first.subject)))
        for group in groups.values()
        for first in group[:1]
    ]


def _cause(found: Finding) -> str:
    """What is expected and found, without what is particular to the subject: its name, numbers, quoted words."""
    text = f"{found.expected}; {found.found}"
    text = re.sub(rf"(?<!\w){re.escape(found.subject)}(?!\w)", "*", text) if found.subject else text
    return re.sub(r"\*(, \*)+", "*", _PARTICULAR.sub("*", text))
