"""From nothing to a running system: a model file, its FMUs, the two connected by names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from commands.app import app
from cosim.master import run
from cosim.system import read_ssp
from cosim.system.by_name import Ports, connect, element_names
from fmu_src import export
from observers.ukf import ukf
from reference_models.duffing import DUFFING

Build = Callable[[str], Path]


def command(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments])


def refused(result: Result) -> str:
    (line,) = result.stderr.strip().splitlines()
    assert result.exit_code == 2 and line.startswith("error: "), result.output
    return line


def test_a_new_model_builds_and_its_system_runs_to_the_true_friction(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert command("new", "tank").exit_code == 0
    done = command("build", "--file", "tank.py")
    assert done.exit_code == 0, done.output
    assert sorted(path.name for path in (tmp_path / "fmus").iterdir()) == ["tank.fmu", "tank_ukf.fmu"]
    noise = {"plant.sensor.sample_time": 0.05, "plant.sensor.noise_std": 0.01}
    result = run(tmp_path / "systems" / "tank_ukf.ssp", overrides=noise)
    assert result.time[-1] == 20.0 and result.step == 0.05
    assert abs(result["observer.estimate.friction"][-1] - 0.2) < 2e-3
    error = abs(result["observer.estimate.angle"] - result["plant.x.angle"])
    assert error[100:].max() < 0.02 and error[0] < 1e-15


def test_a_new_model_overwrites_nothing_and_has_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("mine")
    assert "mine.py: is there already" in refused(command("new", "mine"))
    assert (tmp_path / "mine.py").read_text() == "mine"
    for name in ("2nd", "a-b", "../out", "class", ""):
        assert "letters, digits and _ name a model" in refused(command("new", "--", name))
    assert [path.name for path in tmp_path.iterdir()] == ["mine.py"]


def test_fmus_are_connected_by_names_and_what_stays_open_is_said(built: Build, tmp_path: Path) -> None:
    (tmp_path / "drive.csv").write_text("time,u\n0,0\n1,0.5\n")
    assert command("signal", tmp_path / "drive.csv", "--out", tmp_path).exit_code == 0
    fmus = (built("duffing"), export(ukf(DUFFING, sample_time=0.1), tmp_path))
    done = command("system", *fmus, tmp_path / "drive.fmu", "--out", tmp_path / "x.ssp")
    assert done.exit_code == 0, done.output
    expected = {("plant.y", "observer.y"), ("source.u", "plant.u"), ("source.u", "observer.u")}
    assert {tuple(line.split(" -> ")) for line in done.stdout.splitlines() if " -> " in line} == expected
    assert not any(line.startswith("open: ") for line in done.stdout.splitlines())
    assert set(read_ssp(tmp_path / "x.ssp", tmp_path / "unpacked").connections) == expected
    result = run(tmp_path / "x.ssp", stop=2.0)
    assert result["source.u"][-1] == 0.5
    alone = command("system", *fmus, "--out", tmp_path / "y.ssp")
    assert "open: plant.u keeps its start value, for no other has an output 'u'" in alone.stdout


def test_an_input_with_two_possible_sources_stays_open() -> None:
    made = connect({"a": Ports([], ["y"]), "b": Ports([], ["y"]), "c": Ports(["y", "measurement_valid.y"], [])})
    assert made.connections == [] and made.open == {"c.y": "a and b have an output 'y'"}


def test_elements_are_called_by_their_roles_where_these_tell_them_apart() -> None:
    plant, observer = Ports(["u"], ["y", "x.level"]), Ports(["y", "u"], ["estimate.level"])
    names = element_names({"tank": plant, "tank_ukf": observer, "tank_mhe": observer, "drive": Ports([], ["u"])})
    assert names == {"tank": "plant", "tank_ukf": "tank_ukf", "tank_mhe": "tank_mhe", "drive": "source"}


def test_what_makes_no_system_is_one_line(built: Build, tmp_path: Path) -> None:
    assert "there is no such file" in refused(command("system", tmp_path / "no.fmu", "--out", tmp_path / "x.ssp"))
    twice = (built("duffing"), built("duffing"))
    assert "two FMUs are called 'duffing'" in refused(command("system", *twice, "--out", tmp_path / "x.ssp"))
    (tmp_path / "taken").write_text("")
    done = command("system", built("duffing"), "--out", tmp_path / "taken" / "x.ssp")
    assert "cannot write to" in refused(done)
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]
