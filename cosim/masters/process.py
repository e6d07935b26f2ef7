"""A tool in a process of its own: when it aborts, as libcosim does at an enumeration, that is a message and no more."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from cosim.masters.experiment import MasterError, Recording
from cosim.results import read_csv


def record(tool: str, system: Path) -> Recording:
    """What `tool`, a module of cosim.masters, records of the .ssp file at `system`.

    Raises:
        MasterError: the tool is not installed, refused the system, or ended its process; the message holds its last words.
    """
    with tempfile.TemporaryDirectory(prefix="cosim-") as directory:
        recording = Path(directory) / "recording.csv"
        command = [sys.executable, "-m", "cosim.masters", tool, str(system.resolve()), str(recording)]
        # What the tool unpacks, and leaves behind when it aborts, goes with the directory.
        environment = os.environ | {"TMPDIR": directory}
        child = subprocess.run(command, env=environment, capture_output=True, text=True, errors="replace")
        if child.returncode == 0:
            return read_csv(recording)
    words = [line.strip() for line in (child.stdout + child.stderr).splitlines() if line.strip()]
    if child.returncode > 0:
        raise MasterError(f"{tool}: {words[-1] if words else f'ended with status {child.returncode}'}")
    said = "; ".join(words[-2:]) or "it said nothing"
    raise MasterError(f"{tool}: the process ended by {signal.Signals(-child.returncode).name}: {said}")
