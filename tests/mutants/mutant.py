"""A mutant: one small, meaningful fault at one place of one file."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Mutant:
    """In `file` (relative to the project), the characters from `start` to `end` become `new`."""

    file: str
    line: int
    operator: str
    start: int
    end: int
    old: str
    new: str

    @property
    def key(self) -> str:
        """The same for the same fault in the same text of a file, whatever stands around it."""
        return hashlib.sha256(repr((self.file, self.operator, self.start, self.old, self.new)).encode()).hexdigest()[
            :12
        ]

    def applied(self, text: str) -> str:
        """`text`, the whole file, with the fault in it."""
        assert text[self.start : self.end] == self.old
        return text[: self.start] + self.new + text[self.end :]

    def __str__(self) -> str:
        def one_line(words: str) -> str:
            return " ".join(words.split())[:60]

        return (
            f"{self.file}:{self.line}: {self.operator}: {one_line(self.old)}  ->  {one_line(self.new) or '(nothing)'}"
        )


def mutants_of(root: Path, file: str) -> list[Mutant]:
    """Every mutant of a file, in the order of its text."""
    import c_operators
    import python_operators

    text = (root / file).read_text()
    found = (python_operators if file.endswith(".py") else c_operators).mutations(text)
    lines = [text.count("\n", 0, start) + 1 for _, start, _, _ in found]
    made = [
        Mutant(file, line, operator, start, end, text[start:end], new)
        for line, (operator, start, end, new) in zip(lines, found, strict=True)
    ]
    return sorted(made, key=lambda mutant: (mutant.start, mutant.operator, mutant.new))
