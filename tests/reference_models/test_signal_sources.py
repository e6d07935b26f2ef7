"""Signal sources stand for any quantity: they declare no unit, so that every tool lets them drive any input."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import fmpy
import pytest

from cosim.system import Element, System
from cosim.system.resolve import resolve
from fmu_src import export
from observers.component import Component
from reference_models.ramp import ramp
from reference_models.sine import sine


@pytest.mark.parametrize("make", [sine, ramp])
def test_the_signal_and_its_size_have_no_unit_and_drive_an_input_in_any(
    make: Callable[[], Component], built: Callable[[str], Path], tmp_path: Path
) -> None:
    source, driven = export(make(), tmp_path), built("duffing")
    variables = {v.name: v for v in fmpy.read_model_description(str(source)).modelVariables}
    for name in {"y", "amplitude", "offset", "height"} & variables.keys():
        assert variables[name].unit is None and variables[name].declaredType is None, name
    assert {v.unit for v in variables.values() if v.unit} <= {"s", "rad", "rad/s"}
    system = System(
        "driven", {"source": Element(source), "plant": Element(driven)}, [("source.y", "plant.u")], stop=1.0
    )
    assert [str(c) for c in resolve(system).connections] == ["source.y -> plant.u"]
