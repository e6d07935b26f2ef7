"""The default experiment: from where the model starts, driven by the plant beside it, and never in the way of the FMU."""

from __future__ import annotations

import zipfile
from pathlib import Path

import casadi as ca
import fmpy
import pytest

from build_fmus import components_of
from fmu_src import ExportWarning, export
from observers.model import Model, Variable
from observers.ukf import ukf
from reference_models.duffing import DUFFING
from reference_models.plant import plant

LEVEL = Model(
    name="level",
    states=[Variable("h", start=0.04)],
    outputs=[Variable("y"), Variable("root"), Variable("said", start=7.0)],
    ode=lambda x, u, p, t: [-ca.sqrt(x.h)],  # empties within 0.4 s, where the root ends
    output=lambda x, u, p, t: [x.h, ca.sqrt(x.h), x.h],
)


def test_a_measurement_that_nobody_connects_is_that_of_the_start_values() -> None:
    starts = {port.name: port.start for port in ukf(LEVEL, sample_time=0.1).inputs}
    assert (starts["y"], starts["root"]) == (0.04, 0.2)
    assert starts["said"] == 7.0  # what the user says of an output stays
    assert {port.name: port.start for port in ukf(DUFFING, sample_time=0.1).inputs}["y"] == 2.5


def test_an_experiment_that_fails_leaves_an_fmu_that_says_so(tmp_path: Path) -> None:
    with pytest.warns(
        ExportWarning, match=r"level\.fmu is built, but the .* experiment of 'level' fails: .* t = 0\.\d"
    ):
        path = export(plant(LEVEL, stop_time=2.0, max_step=0.01), tmp_path)
    assert fmpy.read_model_description(str(path)).modelName == "level"
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        page = archive.read("documentation/index.html").decode()
    assert "No plot: " in page and "fmi-ls-ref" not in page
    assert not [name for name in names if "ls-ref" in name]
    assert [name for name in names if name.startswith("binaries/")]


MINE = """
from observers.ukf import ukf
from reference_models.duffing import DUFFING, DUFFING_KNOWN
from reference_models.plant import plant
{lines}
"""


@pytest.mark.parametrize(
    ("lines", "driver"),
    [
        ("a = ukf(DUFFING, sample_time=0.1)\nb = plant(DUFFING)", "duffing"),
        ("a = ukf(DUFFING, sample_time=0.1, name='other_ukf')\nb = plant(DUFFING)", "duffing"),
        # The name decides between two plants that both put out what the observer measures.
        ("a = ukf(DUFFING, sample_time=0.1)\nb = plant(DUFFING)\nc = plant(DUFFING_KNOWN)", "duffing"),
        ("a = ukf(DUFFING_KNOWN, sample_time=0.1)\nb = plant(DUFFING)\nc = plant(DUFFING_KNOWN)", "duffing_known"),
        ("a = ukf(DUFFING, sample_time=0.1, name='other_ukf')\nb = plant(DUFFING)\nc = plant(DUFFING_KNOWN)", None),
        ("a = ukf(DUFFING, sample_time=0.1)", None),
    ],
)
def test_the_plant_in_the_same_file_drives_the_observer(tmp_path: Path, lines: str, driver: str | None) -> None:
    (tmp_path / "mine.py").write_text(MINE.format(lines=lines))
    found = components_of(tmp_path / "mine.py")
    chosen = {name: made().name if made is not None else None for name, (_, made) in found.items()}
    observer = next(name for name in chosen if name.endswith("_ukf"))
    assert chosen.pop(observer) == driver
    assert set(chosen.values()) <= {None}  # a plant is driven by nothing
