"""An observer with its plant inside under wine and qemu: loaded from a folder with an umlaut, a blank and a per cent sign, the numbers of
linux64, and resumed from a file bit by bit."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pytest

import plant_fmu
from fmu_src import PlantFMU, export
from observers.ukf import ukf
from slave import Slave
from test_emulated import MACHINES, Machine, bits
from test_plant_fmu import H, measured, steps

pytestmark = pytest.mark.long


@pytest.fixture(scope="session", params=MACHINES)
def machine(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return MACHINES[request.param](tmp_path_factory.mktemp(request.param))


def test_the_plant_is_found_and_gives_linux64s_numbers(
    machine: Machine, plants: Callable[..., Path], tmp_path: Path
) -> None:
    (tmp_path / "c").mkdir()
    other = plant_fmu.compiled(tmp_path / "c", machine.platform)
    path = plants("pendulum", others={machine.platform: other})
    model = PlantFMU(path, outputs=["y"], inputs=["force"], parameters=["mass.m"], unknown_parameters=["spring.c"])
    made = export(ukf(model, sample_time=H), tmp_path, platforms=["host", machine.platform])
    folder = tmp_path / "Prüf stand 25%"
    fmpy.extract(str(made), str(folder))
    description = fmpy.read_model_description(str(folder))
    variables = {v.name: v.valueReference for v in description.modelVariables}
    shown = ["estimate.mass_r", "estimate.mass_phi", "estimate.spring_c", "diagnostics.std.mass_r"]
    uri = (folder / "resources").as_uri()
    if machine.platform == "win64":
        uri = uri.replace("file:///", "file:///Z:/")
    read = "getReal " + " ".join(str(variables[name]) for name in shown)

    def driven(first: int, last: int) -> list[str]:
        lines = []
        for k in range(first, last):
            y, force = measured(k)
            lines += [f"setReal {variables['y']} {bits(y)}", f"setReal {variables['force']} {bits(force)}"]
            lines += [f"step {bits(k * H)} {bits(H)}", read]
        return lines

    library = folder / "binaries" / machine.platform / f"{description.coSimulation.modelIdentifier}{machine.suffix}"
    begin = [f"instantiate one {description.guid} {uri}", "logging"]
    start = [f"setup {bits(0.0)} {bits(10.0)}", "enter", "exit"]
    answers = machine.calls(
        library, [*begin, *start, *driven(0, 20), "save state.bin", *driven(20, 40), "terminate", "free"], tmp_path
    )
    found = np.array([[struct.unpack(">d", bytes.fromhex(w))[0] for w in a[1:]] for a in answers if a[0] == "real"])
    fmu = Slave(folder).initialize()
    wanted = np.array([[row[name] for name in shown] for row in steps(fmu, 0, 40)])
    fmu.fmu.freeInstance()
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=0)  # cos and sin are the platform's
    resumed = machine.calls(library, [*begin, "load state.bin", *driven(20, 40), "terminate", "free"], tmp_path)
    assert [a for a in resumed if a[0] == "real"] == [a for a in answers if a[0] == "real"][20:]
