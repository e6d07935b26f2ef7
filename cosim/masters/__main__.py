"""The child process of one tool: python -m cosim.masters <tool> <system.ssp> <recording.csv> <steps>.

Ends with 0 and the recording, or with 1 and the reason as the last line of stderr. Each step adds a byte to the file <steps>.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

from cosim.masters.experiment import MasterError, read_experiment
from cosim.results import write_columns


def main(tool: str, system: str, recording: str, steps: str) -> None:
    try:
        module = importlib.import_module(f"cosim.masters.{tool}")
    except (ImportError, OSError) as error:  # OSError: a library that the package needs
        sys.exit(f"not installed here ({error}); docs/masters.md says how to install it")
    try:
        with Path(steps).open("wb", buffering=0) as done:
            columns = module.record(read_experiment(Path(system)), lambda: done.write(b"."))
    except MasterError as error:
        sys.exit(" ".join(str(error).split()))
    write_columns(columns, Path(recording))


if __name__ == "__main__":
    main(*sys.argv[1:])
