"""A tool in a process of its own: when it aborts, as libcosim does at an enumeration, that is a message and no more."""

from __future__ import annotations

import signal
import subprocess
import tempfile
import time
from pathlib import Path

from cosim.master.watched import LIMIT, LOOK
from cosim.masters.experiment import MasterError, Recording
from cosim.python import command, end, environment
from cosim.results import read_csv

LAST = 65536  # bytes of what a tool says that are looked at


def record(tool: str, system: Path, limit: float = LIMIT) -> Recording:
    """What `tool`, a module of cosim.masters, records of the .ssp file at `system`; a step may take `limit` [s].

    Raises:
        MasterError: the tool is not installed, refused the system, did not return, or ended its process; the message holds
            its last words.
    """
    with tempfile.TemporaryDirectory(prefix="cosim-", ignore_cleanup_errors=True) as directory:
        recording, said, steps = (Path(directory) / name for name in ("recording.csv", "said", "steps"))
        # What the tool unpacks, and leaves behind when it aborts, goes with the directory, and so does what the FMUs write.
        with said.open("wb") as words:
            child = subprocess.Popen(
                command("cosim.masters", tool, str(system.resolve()), str(recording), str(steps)),
                cwd=directory,
                env=environment({"TMPDIR": directory}),
                stdin=subprocess.DEVNULL,
                stdout=words,
                stderr=words,
                start_new_session=True,  # so that what FMUs start ends with it
            )
        try:
            returned = _watch(child, steps, limit)
        finally:
            end(child)
        if child.returncode == 0 and returned:
            return read_csv(recording)
        last = _last_lines(said)
    if not returned:
        raise MasterError(f"{tool}: a step, or what comes before the first, has not returned for {limit:g} s")
    if child.returncode > 0:
        raise MasterError(f"{tool}: {last[-1] if last else f'ended with status {child.returncode}'}")
    told = "; ".join(last[-2:]) or "it said nothing"
    raise MasterError(f"{tool}: the process ended by {signal.Signals(-child.returncode).name}: {told}")


def _watch(child: subprocess.Popen[bytes], steps: Path, limit: float) -> bool:
    """Whether the child ended by itself; False: nothing came to the file `steps` for `limit` [s]."""
    seen, since = -1, time.monotonic()
    while True:
        try:
            child.wait(timeout=LOOK)
            return True
        except subprocess.TimeoutExpired:
            now = steps.stat().st_size if steps.exists() else 0
            if now != seen:
                seen, since = now, time.monotonic()
            elif time.monotonic() - since > limit:
                return False


def _last_lines(file: Path) -> list[str]:
    with file.open("rb") as words:
        words.seek(max(0, file.stat().st_size - LAST))
        text = words.read().decode("utf-8", "replace")
    return [line.strip() for line in text.splitlines() if line.strip()]
