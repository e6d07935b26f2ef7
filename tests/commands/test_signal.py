"""observer-fmus signal: a recorded file becomes an FMU that plays it, the same in every run and from the same file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from commands.app import app
from cosim.fmu import read_description, unit_of
from cosim.master import run
from cosim.system import Element, System
from fmu_src.compliance.check import check

TIME = np.array([0.0, 0.1, 0.25, 0.3, 0.7, 1.2])
U, FLOW = np.array([1.0, -2.0, 4.0, 3.5, 0.0, 7.0]), np.array([36.0, 72.0, 36.0, 0.0, 18.0, 54.0])


def command(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["signal", *(str(a) for a in arguments)])


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    lines = [f"{t!r},{u!r},{f!r}" for t, u, f in zip(TIME.tolist(), U.tolist(), FLOW.tolist(), strict=True)]
    (tmp_path / "drive.csv").write_text("\n".join(["time [s],u [N·m],flow [km/h]", *lines]) + "\n")
    return tmp_path / "drive.csv"


def played(fmu: Path, step: float, start: float = 0.0, stop: float = 2.0, **parameters: float) -> dict[str, np.ndarray]:
    made = run(System("alone", {"source": Element(fmu, parameters)}, start=start, stop=stop, step=step))
    return {"time": made.time, **{name.removeprefix("source."): made[name] for name in made.names}}


def test_linear_is_the_straight_line_between_the_rows(drive: Path, tmp_path: Path) -> None:
    done = command(drive, "--between", "linear", "--out", tmp_path)
    assert done.exit_code == 0, done.output
    found = played(tmp_path / "drive.fmu", 0.01)
    np.testing.assert_allclose(found["u"], np.interp(found["time"], TIME, U), rtol=0, atol=3e-14)
    np.testing.assert_allclose(found["flow"], np.interp(found["time"], TIME, FLOW), rtol=0, atol=1e-13)


@pytest.mark.parametrize("step", [0.05, 0.01, 0.1, 1 / 60])
def test_held_is_the_value_of_the_row_before_whatever_the_times_round_to(
    step: float, drive: Path, tmp_path: Path
) -> None:
    command(drive, "--out", tmp_path)
    found = played(tmp_path / "drive.fmu", step)
    # Times in whole nanoseconds, which do not round apart: 3 * 0.1 is 0.3 there.
    nanoseconds = np.rint(found["time"] * 1e9)
    row = np.searchsorted(np.rint(TIME * 1e9), nanoseconds, side="right") - 1
    np.testing.assert_array_equal(found["u"], U[row])


@pytest.mark.parametrize("between", ["held", "linear"])
def test_before_the_first_row_is_the_start_value_and_after_the_last_its_own(
    between: str, drive: Path, tmp_path: Path
) -> None:
    command(drive, "--between", between, "--out", tmp_path)
    found = played(tmp_path / "drive.fmu", 0.1, start=-0.5)
    assert set(found["u"][:5]) == {U[0]} and set(found["u"][-8:]) == {U[-1]}
    found = played(tmp_path / "drive.fmu", 0.1, start=-0.5, **{"start.u": -9.0})
    assert set(found["u"][:5]) == {-9.0} and found["u"][5] == U[0] and set(found["flow"][:5]) == {FLOW[0]}


def test_the_units_are_those_of_the_head_and_the_fmu_keeps_the_standard(drive: Path, tmp_path: Path) -> None:
    command(drive, "--out", tmp_path)
    variables = {v.name: v for v in read_description(tmp_path / "drive.fmu").modelVariables}
    assert unit_of(variables["u"]) == unit_of(variables["start.u"]) == "N.m" and unit_of(variables["flow"]) == "km/h"
    assert not check(tmp_path / "drive.fmu").findings


def test_the_same_file_gives_the_same_bytes_wherever_it_lies(drive: Path, tmp_path: Path) -> None:
    command(drive, "--out", tmp_path / "a")
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "drive.csv").write_bytes(drive.read_bytes())
    command(tmp_path / "b" / "drive.csv", "--out", tmp_path / "b")
    assert (tmp_path / "a" / "drive.fmu").read_bytes() == (tmp_path / "b" / "drive.fmu").read_bytes()


def test_columns_are_chosen_and_named_and_empty_cells_bridged(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t [ms];torque;note\n0;1,5;on\n100;;-\n200;2,5;off\n")
    done = command(tmp_path / "log.csv", "--map", "u=torque", "--map", "time=t", "--out", tmp_path, "--name", "source")
    assert done.exit_code == 0 and "Output u: 1 of 3 cells are empty." in done.stdout, done.output
    found = played(tmp_path / "source.fmu", 0.1, stop=0.3)
    np.testing.assert_array_equal(found["u"], [1.5, 1.5, 2.5, 2.5])
    assert list(found) == ["time", "u"]


@pytest.mark.parametrize(
    ("text", "arguments", "message"),
    [
        ("time,u\n0,1\n1,x\n", (), "line 3: 'x' in column 'u' is not a number"),
        ("time,u v\n0,1\n", (), "'u v' cannot be the name of an output"),
        ("time,u [psi]\n0,1\n", (), "the unit 'psi' of the column 'u [psi]' is none that an FMU can declare"),
        ("time,u\n0,1\n", ("--between", "spline"), "--between spline: must be held or linear"),
        ("time,u\n0,1\n", ("--name", "a-b"), "--name a-b"),
        ("time,u\n0,\n", (), "column 'u': no row has a value"),
        ("time,u\n0,inf\n", (), "column 'u': a value is not finite, in row 1"),
        ("t,u\n0,1\n", (), "name it by --map time=COLUMN"),
        ("time\n0\n", (), "has no columns"),
        ("time,u\n1,1\n0,1\n", (), "line 3: time 0 does not come after 1"),
        ("time,start\n0,1\n", (), "the port 'start' has the name of the branch"),
        ("time,u\n0,1\n", ("--platforms", "amiga"), "amiga"),
    ],
)
def test_what_cannot_be_played_is_one_line_and_writes_nothing(
    text: str, arguments: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    (tmp_path / "log.csv").write_text(text)
    done = command(tmp_path / "log.csv", "--out", tmp_path / "out", *arguments)
    (line,) = done.stderr.strip().splitlines()
    assert done.exit_code == 2 and line.startswith("error: ") and message in line, line
    assert not (tmp_path / "out").exists()


def test_more_rows_than_a_compiler_takes_are_refused_before_it_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("reference_models.recorded.MOST_NUMBERS", 10)
    (tmp_path / "log.csv").write_text("time,u\n" + "".join(f"{k},1\n" for k in range(6)))
    done = command(tmp_path / "log.csv", "--out", tmp_path / "out")
    assert done.exit_code == 2 and "12 times and values are more than 10" in done.stderr
