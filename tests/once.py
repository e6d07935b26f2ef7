"""What several processes need, made once."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from filelock import FileLock


def once(folder: Path, fill: Callable[[Path], object]) -> Path:
    """`folder`, complete: where it is missing, one of the processes that ask for it lets `fill` make it, the others wait."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(f"{folder}.lock"):
        if not folder.exists():
            scratch = Path(tempfile.mkdtemp(dir=folder.parent))
            fill(scratch)
            scratch.rename(folder)
    return folder
