"""Our own master, which drives the FMUs by fmpy, runs an .ssp file."""

from __future__ import annotations

from cosim.master.watched import run
from cosim.masters.experiment import Experiment, Recording


def record(experiment: Experiment, limit: float) -> Recording:
    """The columns of all numeric outputs; a call of an FMU may take `limit` [s].

    Raises:
        RunError: an FMU failed, or took its process with it.
    """
    result = run(experiment.path, limit=limit)
    return {"time": result.time, **{name: result[name] for name in result.names}}
