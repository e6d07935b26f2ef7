"""Replay: an observer over a log is what it would have been in the loop; what a log can lack is handled or refused, and said."""

from __future__ import annotations

import gzip
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from commands.app import app
from cosim.master import run
from cosim.replay.log import read_log
from cosim.replay.replay import replay
from cosim.replay.sampling import sampling
from cosim.results import Result as Record
from cosim.results import read_csv, write_csv
from cosim.system import Element, System
from fmu_src import export
from observers.component import Component, Port
from observers.pseudospectral import pseudospectral
from reference_models.duffing import DUFFING
from strict_fmu import FAILURES
from toys import sampled_toy

Build = Callable[[str], Path]
TOY = ("estimate.level", "filtered.level", "diagnostics.rejected_samples")


@pytest.fixture(scope="module")
def observer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The observer of the paper's Examples 1 and 2."""
    return export(
        pseudospectral(DUFFING, sample_time=0.1, N=15, guess={"x1": 0.0, "x2": 0.0, "theta": 0.1}),
        tmp_path_factory.mktemp("fmu"),
    )


@pytest.fixture(scope="module")
def coupled(observer: Path, built: Build) -> Record:
    """A run of Example 2: theta jumps at 10 s and 20 s."""
    jumps = {
        "parameter.theta_jump_time[1]": 10.0,
        "parameter.theta_jump_value[1]": 0.1,
        "parameter.theta_jump_time[2]": 20.0,
    }
    plant = Element(built("duffing"), {**jumps, "parameter.theta_jump_value[2]": 0.3})
    elements = {"plant": plant, "observer": Element(observer, {"tuning.residual_limit": 1e-6})}
    return run(System("example", elements, [("plant.y", "observer.y")], stop=30.0, step=0.1))


def cosim(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments])


def refused(result: Result) -> str:
    """The one line of an error."""
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.output
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith("error: ")
    return line


def written(path: Path, time: np.ndarray, **columns: np.ndarray) -> Path:
    """A log at `path`; NaN becomes an empty cell."""
    rows = [
        ",".join("" if np.isnan(v) else repr(float(v)) for v in row)
        for row in zip(time, *columns.values(), strict=True)
    ]
    path.write_text("\n".join([",".join(["time", *columns]), *rows]) + "\n")
    return path


@pytest.mark.skipif(os.name != "posix", reason="Windows has other words for it")
@pytest.mark.parametrize(
    ("failure", "reason"),
    [("crash", "fmi2DoStep ended the process by SIGSEGV"), ("endless", "fmi2DoStep has not returned for 1 s")],
)
def test_an_fmu_that_goes_down_or_hangs_is_one_line_and_the_rows_up_to_there(
    strict: Callable[..., Path], failure: str, reason: str, tmp_path: Path
) -> None:
    log = written(tmp_path / "log.csv", 0.1 * np.arange(10), u=np.arange(10.0), **dict.fromkeys("neb", np.ones(10)))
    asked = ("--call-limit", 1, "--set", f"failure={FAILURES.index(failure)}", "--set", "fail_time=0.45")
    result = cosim("replay", strict(), log, "--out", tmp_path / "out", *asked)
    (line,) = result.stderr.splitlines()
    assert (result.exit_code, line.startswith(f"error: element 'observer' at t = 0.5: {reason}")) == (1, True), line
    assert (read_csv(tmp_path / "out" / "estimates.csv")["observer.y"] == [0, 0, 1, 2, 3, 4]).all()
    assert not Path("eventlog.txt").exists()


def test_the_replay_of_a_recorded_run_equals_the_coupled_run_exactly(
    observer: Path, coupled: Record, tmp_path: Path
) -> None:
    write_csv(coupled, tmp_path / "log.csv")
    settings = ("--map", "y=plant.y", "--set", "u=0", "--set", "tuning.residual_limit=1e-6")
    result = cosim("replay", observer, tmp_path / "log.csv", "--out", tmp_path / "out", *settings)
    assert result.exit_code == 0, result.output
    assert "301 samples of 0.1 s" in result.stdout and "ignored: plant.x.x1, " in result.stdout
    assert "Inputs without a column kept their value: u" in result.stdout
    estimates = read_csv(tmp_path / "out" / "estimates.csv")
    for name in ("time", *(name for name in coupled.names if name.startswith("observer."))):
        expected = coupled.time if name == "time" else coupled[name]
        np.testing.assert_array_equal(estimates[name][:-1], expected)
    assert estimates["time"][-1] == pytest.approx(30.1, rel=1e-14, abs=0)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<td>estimating</td>" in page and "<td>plant.y</td>" in page


def test_a_compressed_log_without_times_gives_the_same(observer: Path, coupled: Record, tmp_path: Path) -> None:
    lines = ["y", *(repr(v) for v in coupled["plant.y"].tolist())]
    with gzip.open(tmp_path / "log.csv.gz", "wt") as file:
        file.write("\r\n".join(lines) + "\r\n")
    made = replay(
        observer, tmp_path / "log.csv.gz", sample_time=0.1, overrides={"u": 0.0, "tuning.residual_limit": 1e-6}
    )
    np.testing.assert_array_equal(made.result["observer.estimate.x2"][:-1], coupled["observer.estimate.x2"])


def toy(built: Build, log: Path, **options: object) -> dict[str, np.ndarray]:
    made = replay(built("sampled_toy"), log, **options)  # type: ignore[arg-type]
    return {name: made.result[f"observer.{name}"] for name in TOY}


def test_empty_and_nan_cells_reach_the_fmu_as_nan(built: Build, tmp_path: Path) -> None:
    time, y = np.arange(5) * 0.1, np.array([1.0, np.nan, 3.0, 4.0, 5.0])
    log = written(tmp_path / "log.csv", time, y=y, rate=np.zeros(5))
    log.write_text(log.read_text().replace("4.0,0.0", "NaN,0.0"))
    # With a gain of 1/2 from level 1: 1, rejected, 2, rejected, 3.5.
    found = toy(built, log)
    np.testing.assert_array_equal(found["filtered.level"], [1, 1, 1, 2, 2, 3.5])
    assert found["diagnostics.rejected_samples"][-1] == 2


def test_an_instant_without_a_row_is_a_missing_measurement(built: Build, tmp_path: Path) -> None:
    time = np.array([0.0, 0.1, 0.3, 0.4])  # none at 0.2
    log = written(tmp_path / "log.csv", time, y=np.array([1.0, 3.0, 5.0, 7.0]))
    made = replay(built("sampled_toy"), log, overrides={"rate": 0.0})
    np.testing.assert_array_equal(made.result["observer.filtered.level"], [1, 1, 2, 2, 3.5, 5.25])
    assert made.empty == {"y": 1} and made.kept == ["rate"]
    assert made.sampling.rows.tolist() == [0, 1, -1, 2, 3]


def valid_toy() -> Component:
    """The toy with an input that says whether its measurement counts."""
    base = sampled_toy()
    z, u, p, t, h = ca.SX.sym("z", 4), ca.SX.sym("u", 3), ca.SX.sym("p", 6), ca.SX.sym("t"), ca.SX.sym("h")
    own = ca.vertcat(ca.if_else(u[2] > 0.5, u[0], ca.inf), u[1])
    return replace(
        base,
        name="valid_toy",
        flow=ca.Function("flow", [z, u, p, t, h], [base.flow(z, own, p, t, h)]),
        jump=ca.Function("jump", [z, u, p, t], [base.jump(z, own, p, t)]),
        output=ca.Function("output", [z, u, p, t], [base.output(z, own, p, t)]),
        inputs=(*base.inputs, Port("measurement_valid.y", "does y count?", start=1.0)),
    )


def test_with_validity_inputs_a_known_input_is_held_where_a_row_is_missing(tmp_path: Path) -> None:
    fmu = export(valid_toy(), tmp_path)
    time, y, rate = np.array([0.0, 0.1, 0.3, 0.4]), np.ones(4), np.array([0.0, 2.0, 0.0, 0.0])
    made = replay(fmu, written(tmp_path / "log.csv", time, y=y, rate=rate), overrides={"kick_time": 1e9})
    assert made.kept == ["measurement_valid.y"] and made.empty == {"y": 1, "rate": 0}
    # Level 1 grows by 0.2 from 0.1 s on, held over the instant without a row, and goes half the way to 1 at 0.3 s and 0.4 s.
    np.testing.assert_allclose(made.result["observer.estimate.level"], [1, 1, 1.2, 1.4, 1.2, 1.1], rtol=3e-15)
    valid = np.array([1.0, 0.0, 1.0, 1.0])
    columns = {"y": y, "rate": rate, "measurement_valid.y": valid}
    made = replay(fmu, written(tmp_path / "log.csv", time, **columns), overrides={"kick_time": 1e9})
    assert made.result["observer.diagnostics.rejected_samples"][-1] == 2


@pytest.mark.parametrize(("yes", "no"), [("true", "false"), ("True", "FALSE"), ("1", "0"), ("1.0", "0.0")])
def test_a_measurement_that_a_boolean_column_calls_invalid_is_as_good_as_missing(
    yes: str, no: str, observer: Path, coupled: Record, tmp_path: Path
) -> None:
    y, found = coupled["plant.y"][:60], {}
    for name, invalid, cells in (("flagged", no, "1e6"), ("missing", yes, "")):
        rows = [
            f"{k * 0.1},{cells},{invalid}" if 40 <= k < 45 else f"{k * 0.1},{float(y[k])!r},{yes}" for k in range(60)
        ]
        (tmp_path / f"{name}.csv").write_text("\n".join(["time,y,measurement_valid.y", *rows]) + "\n")
        found[name] = replay(observer, tmp_path / f"{name}.csv", overrides={"u": 0.0}).result
    for variable in ("x1", "x2", "theta"):
        column = f"observer.estimate.{variable}"
        np.testing.assert_array_equal(found["flagged"][column], found["missing"][column])
    assert np.abs(found["flagged"]["observer.estimate.x1"][:60] - coupled["plant.x.x1"][:60])[20:].max() < 2e-10


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        ("", "'' in column 'measurement_valid.y' is neither true nor false"),
        ("2", "'2' in column"),
        ("nan", "'nan' in column"),
        ("yes", "'yes' in column 'measurement_valid.y' is neither true nor false"),
    ],
)
def test_what_is_neither_true_nor_false_in_a_boolean_column_is_refused(
    cell: str, message: str, observer: Path, tmp_path: Path
) -> None:
    (tmp_path / "log.csv").write_text(f"time,y,measurement_valid.y\n0,1,true\n0.1,1,{cell}\n")
    line = refused(cosim("replay", observer, tmp_path / "log.csv", "--set", "u=0", "--out", tmp_path / "out"))
    assert "line 3" in line and message in line


def test_irregular_times_take_the_nearest_row_of_each_instant(tmp_path: Path) -> None:
    time = np.array([5.0, 5.13, 5.185, 5.22, 5.31, 5.52])
    log = written(tmp_path / "log.csv", time, y=time)
    taken = sampling(log, read_log(log).numbers("time"), 0.1)
    assert taken.start == 5.0 and taken.rows.tolist() == [0, 1, 2, 4, -1, 5]
    np.testing.assert_allclose(taken.offsets, [0, 0.03, -0.015, 0.01, 0, 0.02], rtol=0, atol=5e-15)


def test_a_finer_log_is_thinned_to_the_sample_instants_and_the_report_says_so(
    observer: Path, built: Build, tmp_path: Path
) -> None:
    fine = run(System("alone", {"plant": Element(built("duffing"))}, stop=5.0, step=0.02))
    log = written(tmp_path / "log.csv", fine.time, y=fine["plant.y"])
    coarse = written(tmp_path / "coarse.csv", fine.time[::5], y=fine["plant.y"][::5])
    result = cosim("replay", observer, log, "--set", "u=0", "--out", tmp_path / "fine")
    assert result.exit_code == 0 and "200 of 251 rows lie farther" in result.stdout
    cosim("replay", observer, coarse, "--set", "u=0", "--out", tmp_path / "coarse")
    assert (tmp_path / "fine" / "estimates.csv").read_bytes() == (tmp_path / "coarse" / "estimates.csv").read_bytes()


def test_the_sample_time_is_the_fmus_parameter_where_it_has_one(tmp_path: Path, built: Build) -> None:
    log = written(tmp_path / "log.csv", np.arange(8) * 0.25, y=np.ones(8), rate=np.zeros(8))
    assert "recorded every 0.25 s (median), but the FMU samples every 0.1 s" in refused(
        cosim("replay", built("sampled_toy"), log)
    )
    made = replay(built("sampled_toy"), log, overrides={"sample_time": "0.25"})
    assert made.result.step == 0.25 and len(made.result.time) == 9


@pytest.mark.parametrize(
    ("text", "arguments", "message"),
    [
        (
            "time,y\n0,1\n",
            (),
            "no column for the input 'rate' among time, y; name one by --map rate=COLUMN, or give",
        ),
        ("time,y,rate\n0,1,0\n", ("--set", "rate=1"), "input 'rate' is set and has the column 'rate'"),
        ("time,y,rate\n0,1,0\n", ("--map", "y=V2"), "there is no column 'V2'"),
        ("time,y,rate\n0,1,0\n", ("--map", "Y=y"), "there is no input 'Y' to map; did you mean 'y'"),
        ("time,y,rate\n0,1,0\n", ("--map", "y"), "--map y: not of the form INPUT=COLUMN"),
        (
            "time,y,rate\n0,1,0\n",
            ("--set", "tuning.gian=1"),
            "has no variable 'tuning.gian'; did you mean 'tuning.gain'",
        ),
        ("time,y,rate\n0,1,0\n", ("--sample-time", 0.1), "has a column 'time' of times: leave --sample-time out"),
        ("y,rate\n1,0\n", (), "has no column 'time' among y, rate: name it by --map time=COLUMN, or give the time"),
        ("y,rate\n1,0\n", ("--sample-time", -1), "--sample-time -1 must be positive"),
        ("time,y,rate\n0,1,0\n0.2,1,0\n0.1,1,0\n", (), "line 4: time 0.1 does not come after 0.2, the one before"),
        ("time,y,rate\n0,1,0\n0,1,0\n", (), "line 3: time 0 does not come after 0"),
        ("time,y,rate\n0,1,0\n,1,0\n", (), "line 3: the time is missing or not finite"),
        ("time,y,rate\n0,1,0\n0.1,one,0\n", (), "line 3: 'one' in column 'y' is not a number"),
        ("time,y,rate\n0,1,0\n0.1,1\n", (), "line 3: 2 cells under 3 names"),
        ("time,y,y\n0,1,0\n", (), "two columns are called 'y'"),
        ("time,y,rate\n", (), "at least one line of values"),
        ("", (), "at least one line of values"),
        ("time,y,rate\n1.7e9,1,0\n1700000000.1,1,0\n", (), "too coarse in double precision for a sample time of 0.1 s"),
        ("time,y,rate\n0,1,0\n0.1,1,0\n0.2,1,0\n2e7,1,0\n", (), "more than 100000000 samples of 0.1 s"),
        ("time,y,rate\n0,1,0\n1,1,0\n", (), "recorded every 1 s (median), but the FMU samples every 0.1 s"),
    ],
)
def test_a_log_that_does_not_suit_is_one_line_and_status_2(
    built: Build, tmp_path: Path, text: str, arguments: tuple[object, ...], message: str
) -> None:
    (tmp_path / "log.csv").write_text(text)
    line = refused(cosim("replay", built("sampled_toy"), tmp_path / "log.csv", "--out", tmp_path / "out", *arguments))
    assert message in line
    assert not (tmp_path / "out").exists()


def test_a_missing_or_damaged_log_is_one_line_and_status_2(built: Build, tmp_path: Path) -> None:
    assert "there is no such file" in refused(cosim("replay", built("sampled_toy"), tmp_path / "nowhere.csv"))
    (tmp_path / "log.csv.gz").write_text("time,y\n")
    assert "cannot be read as CSV text" in refused(cosim("replay", built("sampled_toy"), tmp_path / "log.csv.gz"))
    (tmp_path / "log.csv").write_bytes(b"time,y\n\xff\xfe,1\n")
    assert "cannot be read as CSV text" in refused(cosim("replay", built("sampled_toy"), tmp_path / "log.csv"))


def test_an_fmu_without_inputs_or_without_a_file_is_refused(built: Build, tmp_path: Path) -> None:
    log = written(tmp_path / "log.csv", np.arange(3) * 0.1, y=np.ones(3))
    assert "no column feeds an input" in refused(cosim("replay", built("growing_toy"), log))
    assert "there is no such file" in refused(cosim("replay", tmp_path / "nowhere.fmu", log))


def test_outputs_that_depend_on_an_input_directly_are_of_the_same_instant(built: Build, tmp_path: Path) -> None:
    log = written(tmp_path / "log.csv", np.arange(4) * 0.01, position=np.array([1.0, 2.0, 3.0, 4.0]))
    made = replay(built("feedthrough_toy"), log)
    np.testing.assert_array_equal(made.result["observer.force"][:-1], [-2, -4, -6, -8])


def test_an_fmu_that_fails_is_one_line_and_status_1_and_keeps_the_record(built: Build, tmp_path: Path) -> None:
    log = written(tmp_path / "log.csv", np.arange(4) * 0.1, y=np.ones(4), rate=np.array([0.0, 0.0, np.inf, 0.0]))
    result = cosim("replay", built("sampled_toy"), log, "--out", tmp_path / "out")
    assert result.exit_code == 1 and "Traceback" not in result.output
    assert "element 'observer' at t = 0.2" in result.stderr and "estimates.csv" in result.stderr
    assert len(read_csv(tmp_path / "out" / "estimates.csv")["time"]) == 3
