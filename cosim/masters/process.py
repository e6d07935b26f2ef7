"""A tool in a process of its own: when it aborts, as libcosim does at an enumeration, that is a message and no more."""

from __future__ import annotations

import signal
import subprocess
import tempfile
from pathlib import Path

from cosim.masters.experiment import MasterError, Recording
from cosim.python import command, environment
from cosim.results import read_csv


def record(tool: str, system: Path) -> Recording:
    """What `tool`, a module of cosim.masters, records of the .ssp file at `system`.

    Raises:
        MasterError: the tool is not installed, refused the system, or ended its process; the message holds its last words.
    """
    with tempfile.TemporaryDirectory(prefix="cosim-") as directory:
        recording = Path(directory) / "recording.csv"
        # What the tool unpacks, and leaves behind when it aborts, goes with the directory, and so does what the FMUs write.
        child = subprocess.run(
            command("cosim.masters", tool, str(system.resolve()), str(recording)),
            cwd=directory,
            env=environment({"TMPDIR": directory}),
            capture_output=True,
            text=True,
            errors="replace",
        )
        if child.returncode == 0:
            return read_csv(recording)
    words = [line.strip() for line in (child.stdout + child.stderr).splitlines() if line.strip()]
    if child.returncode > 0:
        raise MasterError(f"{tool}: {words[-1] if words else f'ended with status {child.returncode}'}")
    said = "; ".join(words[-2:]) or "it said nothing"
    raise MasterError(f"{tool}: the process ended by {signal.Signals(-child.returncode).name}: {said}")
