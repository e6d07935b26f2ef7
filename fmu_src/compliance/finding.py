"""What a check yields."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class Finding:
    """A rule broken: `subject` is the variable, file or function, `expected` and `found` say the rest."""

    rule: str
    section: str
    subject: str
    expected: str
    found: str

    def __str__(self) -> str:
        return f"{self.rule} [{self.section}] {self.subject}: expected {self.expected}; found {self.found}"


@dataclass
class Report:
    """What was found in one FMU. `checked`: the rules that were applied; `notes`: why others were not."""

    fmu: Path
    checked: list[str] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
