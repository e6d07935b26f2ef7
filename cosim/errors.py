"""What can be wrong with a system or with what is asked of it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path


class SystemFileError(ValueError):
    """A system, its .ssp file or one of its FMUs is not what it should be; the message names which and why."""


class ExperimentError(ValueError):
    """What was asked of a system is impossible: an unknown variable, a value of the wrong kind, an unfit step."""


def number(text: str) -> float:
    """The number that `text` is. Python's float also takes 1_0.5 and the digits of all alphabets.

    Raises:
        ValueError: it is none.
    """
    if "_" in text or not text.isascii():
        raise ValueError(f"'{text}' is not a number")
    return float(text)


def whole_number(text: str) -> int:
    """The whole number that `text` is, likewise.

    Raises:
        ValueError: it is none.
    """
    if "_" in text or not text.isascii():
        raise ValueError(f"'{text}' is not a whole number")
    return int(text)


def one_line(text: str, most: int = 0) -> str:
    """`text` as one line of characters that a terminal shows and does not obey; cut to `most` characters, if that is not 0."""
    line = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in " ".join(text.split()))
    return f"{line[:most]} ..." if most and len(line) > most else line


def not_a_file(path: Path) -> str:
    """The error message about a `path` that is no file."""
    return f"{path}: is a folder, where a file is wanted" if path.is_dir() else f"{path}: there is no such file"


def suggest(name: str, known: Iterable[str]) -> str:
    """The end of an error message about the unknown `name`: the names near it, or else all that are known."""
    known = list(known)
    near = (
        difflib.get_close_matches(name, known, n=4, cutoff=0.5) or [k for k in known if name.lower() in k.lower()][:4]
    )
    if near:
        return "did you mean " + " or ".join(f"'{n}'" for n in near) + "?"
    shown = ", ".join(known[:12]) + (f", and {len(known) - 12} more" if len(known) > 12 else "")
    return f"known: {shown or 'none'}"
