"""Numbers that stand in tables of the documentation, held against what is computed."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

NUMBER = r"(-?\d+(?:\.\d+)?(?:e-?\d+)?)"


def rows_of(page: Path) -> dict[tuple[str, str], list[str]]:
    """The cells of every row of the page's tables, by the heading above it and its first cell."""
    found: dict[tuple[str, str], list[str]] = {}
    heading = ""
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            heading = line.lstrip("# ")
        elif line.startswith("|") and not line.startswith("|---"):
            plain = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", line)  # no links
            first, *others = (cell.strip() for cell in plain.strip("|").split("|"))
            found[heading, first] = others
    return found


def numbers_in(text: str, words: str) -> list[str]:
    """The numbers of `text` in the places of `words` that are marked {}."""
    match = re.fullmatch(re.escape(words).replace(r"\{\}", NUMBER), text)
    assert match, f"the page says {text!r}, the test expects {words!r}"
    return list(match.groups())


def check(text: str, words: str, computed: np.ndarray | list[float] | tuple[float, ...], rel: float = 0.01) -> None:
    """The page's numbers are those computed, to half a unit of their last digit and `rel` of them."""
    said = numbers_in(text, words)
    assert len(said) == len(computed), (said, computed)
    for shown, value in zip(said, computed, strict=True):
        assert abs(float(shown) - value) <= 0.501 * unit(shown) + rel * abs(float(shown)), (text, shown, value)


def unit(shown: str) -> float:
    """That of the last digit."""
    digits, _, exponent = shown.partition("e")
    return 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))
