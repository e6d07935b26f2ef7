"""Tools that the tests need and that a machine may lack: there the tests skip, but never in CI."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from _pytest.mark import ParameterSet

TESTS = Path(__file__).parent
ROOT = TESTS.parent
DEBIANS_WINE = "/usr/lib/wine/wine64"  # which puts no name on PATH
QEMU = shutil.which("qemu-aarch64")
ARM_ROOT = Path("/usr/aarch64-linux-gnu")  # where Debian keeps the C library for it
WINE = DEBIANS_WINE if Path(DEBIANS_WINE).is_file() else shutil.which("wine64")


def need(found: bool, reason: str) -> None:
    """Skip the test with `reason` where a tool is not found; in CI, which installs all of them, fail."""
    if found:
        return
    if os.environ.get("CI"):
        pytest.fail(f"CI skips nothing: {reason}")
    pytest.skip(reason)


def imports(package: str) -> bool:
    """Whether the package can be imported, in a process that it may end."""
    return subprocess.run([sys.executable, "-c", f"import {package}"], capture_output=True).returncode == 0


def few(cases: Iterable[Any], count: int = 1) -> list[Any]:
    """`cases` to parametrise a test with: the first `count` in every run, the others, which ask the same of more, where long tests run."""
    marked = [
        case if isinstance(case, ParameterSet) else pytest.param(*(case if isinstance(case, tuple) else (case,)))
        for case in cases
    ]
    return [
        *marked[:count],
        *(pytest.param(*p.values, marks=[*p.marks, pytest.mark.long], id=p.id) for p in marked[count:]),
    ]


def examples(quick: int, whole: int) -> int:
    """How many examples hypothesis makes: `quick` in every run, `whole` in CI."""
    return whole if os.environ.get("CI") else quick
