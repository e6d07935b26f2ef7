"""From a foreign FMU to an estimate by the command line alone."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

import plant_fmu
from cosim.master import run
from cosim.masters.comparison import MASTERS, differences, largest, record_all
from once import compiled_once
from tools import ROOT
from verbs import observer_fmus, refused

WRAP = ("--output", "y", "--input", "force", "--parameter", "mass.m", "--estimate", "spring.c", "--sample-time", 0.05)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with pendulum.fmu, relay.fmu and what wrap makes of the first."""
    made = tmp_path_factory.mktemp("wrap")
    library = plant_fmu.library()
    for kind in ("pendulum", "relay"):
        plant_fmu.write(made / f"{kind}.fmu", library, kind, slopes=True)
    with compiled_once(), pytest.MonkeyPatch.context() as patch:
        patch.chdir(made)
        options = ("--process-noise", "spring.c=0.05", "--measurement-noise", "y=0.01", "--guess", "spring_c=45")
        result = observer_fmus("wrap", "pendulum.fmu", *WRAP, *options)
        assert result.exit_code == 0, result.output
    return made


@pytest.fixture(autouse=True)
def within(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.chdir(folder)
    yield


def test_wrap_writes_the_observer_the_plant_and_their_system_which_finds_the_stiffness(folder: Path) -> None:
    assert sorted(p.name for p in (folder / "fmus").iterdir()) == ["pendulum_plant.fmu", "pendulum_ukf.fmu"]
    noisy = {"plant.sensor.noise_std": 0.01, "plant.sensor.sample_time": 0.05}
    found = run(folder / "systems" / "pendulum_ukf.ssp", overrides=noisy)
    assert found["observer.estimate.spring_c"][0] == 45.0
    assert abs(found["observer.estimate.spring_c"][-1] - 40.0) < 1.0
    assert abs(found["observer.estimate.mass_r"][-1] - found["plant.x.mass_r"][-1]) < 0.02


@pytest.mark.long
@pytest.mark.usefixtures("other_masters")
def test_ecos_and_libcosim_run_the_system(folder: Path) -> None:
    path = folder / "systems" / "pendulum_ukf.ssp"
    recordings = record_all(path, MASTERS)
    for tool in ("ecos", "libcosim"):
        found = differences(recordings["fmpy"], recordings[tool])
        assert largest(found) < 1e-12, found
        assert recordings[tool]["observer.estimate.spring_c"][0] == 45.0


def test_describe_lists_what_there_is_and_ends_with_what_is_in_the_way(folder: Path) -> None:
    good = observer_fmus("describe", "pendulum.fmu")
    assert good.exit_code == 0
    text = " ".join(good.output.split())
    assert "4 states" in text and "mass.r m --output" in text
    assert "spring.c 40 --estimate, --parameter" in text
    assert "Nothing is in the way of an observer" in text
    bad = observer_fmus("describe", "relay.fmu")
    assert bad.exit_code == 1
    assert "In the way of an observer: it remembers: der(x1) at the same point is" in bad.output
    made = observer_fmus("describe", "fmus/pendulum_ukf.fmu")
    assert made.exit_code == 1
    assert "co-simulation only: FMI 2.0 gives no way to write its states" in " ".join(made.output.split())


def test_mistakes_are_one_line_and_write_nothing(folder: Path) -> None:
    before = sorted(folder.rglob("*"))
    for arguments, said in (
        (("nowhere.fmu", *WRAP), "nowhere.fmu"),
        (("relay.fmu", "--output", "y", "--sample-time", 0.1), "remembers"),
        (
            ("pendulum.fmu", *WRAP, "--observer", "kalman"),
            "--observer kalman: must be one of ukf, riccati, pseudospectral",
        ),
        (("pendulum.fmu", *WRAP, "--output", "z"), "the output 'z' is no variable of it"),
        (
            ("pendulum.fmu", *WRAP, "--process-noise", "spring.c"),
            "--process-noise spring.c: not of the form NAME=VALUE",
        ),
        (("pendulum.fmu", *WRAP, "--process-noise", "spring.c=big"), "--process-noise: 'big' is not a number"),
        (("pendulum.fmu", *WRAP, "--process-noise", "spring.d=1"), "spring_d"),
        (
            ("pendulum.fmu", *WRAP, "--platforms", "win64"),
            "plant 'pendulum.fmu' has no binary for win64; it has linux64",
        ),
        ((ROOT / "README.md", *WRAP), "it cannot be read as an FMU"),
    ):
        assert said in refused(observer_fmus("wrap", *arguments)), arguments
    assert sorted(folder.rglob("*")) == before
