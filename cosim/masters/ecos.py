"""Ecos (PyPI: ecospy, with Debian's libtbb12) runs an .ssp file.

Ecos knows no enumerations and leaves them out. An FMU's fmi2Error does not stop it, neither in a step nor when it sets a
parameter: the run goes on with the values of before, and nothing is said. It starts at t = 0, whatever it is asked.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from ecospy import EcosLib, EcosSimulation

from cosim.masters.experiment import Experiment, MasterError, Recording
from cosim.system.ssp_writer import PARAMETER_SET


def record(experiment: Experiment, stepped: Callable[[], object]) -> Recording:
    """The columns of all Real, Integer and Boolean outputs; calls `stepped` after each step.

    Raises:
        MasterError: Ecos cannot load or initialise the system, or not start it at its start time.
    """
    EcosLib.set_log_level("warn")
    try:
        simulation = EcosSimulation(experiment.step, ssp_path=str(experiment.path))
    except Exception as error:  # ecospy raises no narrower type
        raise MasterError(str(error)) from error
    # Without the name of a parameter set Ecos applies none.
    if not simulation.init(experiment.start, PARAMETER_SET):
        raise MasterError(f"initialisation failed: {EcosLib.get_last_error()}")
    if simulation.get_time() != experiment.start:
        raise MasterError(f"starts at t = {simulation.get_time():g}, not at {experiment.start:g} as asked")
    read = {"Real": simulation.get_real, "Integer": simulation.get_integer, "Boolean": simulation.get_bool}
    outputs = [output for output in experiment.outputs if output.kind in read]
    rows = np.empty((experiment.steps + 1, 1 + len(outputs)))
    for i in range(experiment.steps + 1):
        rows[i, 0] = simulation.step(1) if i else simulation.get_time()
        for column, output in enumerate(outputs, start=1):
            rows[i, column] = read[output.kind](f"{output.element}::{output.variable}")
        stepped()
    simulation.terminate()
    simulation.free()
    return dict(zip(["time", *(output.column for output in outputs)], rows.T, strict=True))
