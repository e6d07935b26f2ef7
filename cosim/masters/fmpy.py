"""Our own master, which drives the FMUs by fmpy, runs an .ssp file."""

from __future__ import annotations

from cosim.master.watched import run
from cosim.masters.experiment import Experiment, Recording


def record(experiment: Experiment) -> Recording:
    """The columns of all numeric outputs.

    Raises:
        RunError: an FMU failed, or took its process with it.
    """
    result = run(experiment.path)
    return {"time": result.time, **{name: result[name] for name in result.names}}
