"""This project's modules in a process of their own, whatever its working directory is."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path


def command(module: str, *arguments: str) -> list[str]:
    """What runs `module` as a program; nothing is imported from the working directory, where FMUs leave files."""
    return [sys.executable, "-P", "-m", module, *arguments]


def environment(more: Mapping[str, str] | None = None) -> dict[str, str]:
    """This process's, and where this one finds its modules."""
    paths = os.pathsep.join(str(Path(path or ".").resolve()) for path in sys.path)
    return {**os.environ, "PYTHONPATH": paths, **(more or {})}
