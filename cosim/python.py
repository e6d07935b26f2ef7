"""This project's modules in a process of their own, whatever its working directory is."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
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


def end(process: subprocess.Popen[bytes]) -> None:
    """End a process that leads a session, and what it started."""
    with contextlib.suppress(ProcessLookupError, PermissionError):  # it is gone already
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    process.wait()
