"""observer-fmus tune, and what takes the file that it writes: replay, run, campaign, build; a line for each mistake."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import browser
from cosim.fmu import read_description
from cosim.results import read_csv
from cosim.system import Element, System, write_ssp
from cosim.system.parameter_set import parameters_of
from cosim.tuning import search
from simulated import TS, swing, write_log
from verbs import observer_fmus, refused

Build = Callable[[str], Path]
QUICK = ("--set", "tuning.process_noise.s=1e-9", "--set", "tuning.initial_std.s=1", "--set", "tuning.initial_std.v=1")
SET = """<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="1.0" name="x">
<ssv:Parameters>{}</ssv:Parameters></ssv:ParameterSet>"""
REAL = '<ssv:Parameter name="{}"><ssv:Real value="{}"/></ssv:Parameter>'


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("logs") / "swing.csv", TS, y=swing(160, 1, 0.4, 0.1))


def parameter_set(path: Path, *values: tuple[str, object]) -> Path:
    path.write_text(SET.format("".join(REAL.format(name, value) for name, value in values)))
    return path


def test_tune_shows_what_it_found_and_replay_takes_it(built: Build, log: Path, tmp_path: Path) -> None:
    fmu, out = built("moved_riccati"), tmp_path / "new" / "tuned.ssv"
    result = observer_fmus("tune", fmu, log, *QUICK, "--out", out)
    assert result.exit_code == 0, result.output
    for word in (
        "tuning.process_noise.v",
        "known to",
        "log-likelihood",
        "NIS",
        "whiteness",
        "120 measurements",
        "tuned.ssv",
    ):
        assert word in result.output
    values = parameters_of(out, read_description(fmu))
    assert values["tuning.process_noise.s"] == 1e-9 and "tuning.gate" not in values
    page = (tmp_path / "new" / "tuned.html").read_text(encoding="utf-8")
    for words in ("tuning.process_noise.v", "mean of NIS", "whiteness", "120 measurements", "Innovations"):
        assert words in page
    assert observer_fmus("replay", fmu, log, "--parameters", out, "--out", tmp_path / "a").exit_code == 0
    settings = [word for name, value in values.items() for word in ("--set", f"{name}={value!r}")]
    assert observer_fmus("replay", fmu, log, *settings, "--out", tmp_path / "b").exit_code == 0
    assert (tmp_path / "a" / "estimates.csv").read_bytes() == (tmp_path / "b" / "estimates.csv").read_bytes()


@pytest.mark.long
def test_a_browser_draws_the_innovations_before_and_after(built: Build, log: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    arguments = (built("moved_riccati"), log, log, *QUICK, "--out", tmp_path / "x.ssv", "--report", page)
    assert observer_fmus("tune", *arguments).exit_code == 0
    browser.check(page, 3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("{fmu}", "nowhere.csv"), "nowhere.csv: there is no such file"),
        (("{fmu}", "{other}"), "there is no column for the input 'y' among time, z"),
        (("{fmu}", "{log}", "{other}"), "other.csv: there is no column for the input 'y' among time, z"),
        (
            ("{fmu}", "{short}"),
            "short.csv: 16 samples, of which 4 are held back, are too few: to tune 5 numbers takes 50 besides",
        ),
        (("{fmu}", "{log}", "--ahead", "20"), "to tune 2 numbers by the error 20 samples ahead takes 400 besides"),
        (
            ("{fmu}", "{log}", "--set", "tuning.process_noise.w=1"),
            "has no variable 'tuning.process_noise.w'; did you mean",
        ),
        (("{plant}", "{log}"), "duffing is no observer that can be tuned: it shows no diagnostics.innovation"),
        (("{unknown}", "{log}", "--set", "u=0"), "duffing_segments: has no noise to tune (tuning.process_noise.*"),
        (("{fmu}", "{log}", "--parameters", "{log}"), "swing.csv, line 1: Start tag expected"),
        (("{fmu}", "{log}", "--parameters", "nowhere.ssv"), "nowhere.ssv: there is no such file"),
    ],
)
def test_a_mistake_is_one_line(built: Build, log: Path, tmp_path: Path, arguments, message: str) -> None:
    files = {
        "fmu": built("moved_riccati"),
        "plant": built("duffing"),
        "unknown": built("duffing_segments"),
        "log": log,
        "other": write_log(tmp_path / "other.csv", TS, z=np.zeros(50)),
        "short": write_log(tmp_path / "short.csv", TS, y=np.zeros(16)),
    }
    given = [word.format(**files) for word in arguments]
    assert message in refused(observer_fmus("tune", *given, "--out", tmp_path / "x.ssv"))
    assert not (tmp_path / "x.ssv").exists()


def test_a_log_that_explains_nothing_and_a_file_that_cannot_be_written_are_one_line(
    built: Build, log: Path, tmp_path: Path
) -> None:
    empty = tmp_path / "empty.csv"
    empty.write_text("time,y\n" + "".join(f"{k * TS!r},\n" for k in range(100)))
    fmu = built("moved_riccati")
    assert "its own noises explain nothing" in refused(observer_fmus("tune", fmu, empty, *QUICK))
    (tmp_path / "file").write_text("")
    line = refused(observer_fmus("tune", fmu, log, *QUICK, "--out", tmp_path / "file" / "x.ssv"))
    assert line.startswith("error: cannot write to ")


def test_ctrl_c_is_one_line_and_nothing_is_written(
    built: Build, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(search, "minimize", interrupted)
    out = tmp_path / "x.ssv"
    line = refused(observer_fmus("tune", built("moved_riccati"), log, *QUICK, "--out", out), 130)
    assert line == "error: stopped; nothing was written" and not out.exists()


@pytest.mark.long
def test_run_and_campaign_give_the_values_to_the_element_that_has_them(built: Build, tmp_path: Path) -> None:
    observer = built("duffing_missing_ukf")
    elements = {"plant": Element(built("duffing")), "observer": Element(observer)}
    system = tmp_path / "duffing.ssp"
    write_ssp(System("duffing", elements, [("plant.y", "observer.y")], stop=2.0, step=0.1), system)
    values = parameter_set(
        tmp_path / "x.ssv", ("tuning.process_noise.theta", 0.25), ("tuning.measurement_noise.y", 0.5)
    )
    settings = ("--set", "observer.tuning.process_noise.theta=0.25", "--set", "observer.tuning.measurement_noise.y=0.5")
    for folder, given in (("a", ("--parameters", values)), ("b", settings)):
        assert observer_fmus("run", system, "--out", tmp_path / folder, *given).exit_code == 0
    a, b = (read_csv(tmp_path / folder / "results.csv") for folder in "ab")
    assert all(np.array_equal(a[name], b[name]) for name in a)
    # What is set goes first.
    first = (*settings[:2], "--parameters", parameter_set(tmp_path / "y.ssv", ("tuning.process_noise.theta", 9.0)))
    assert observer_fmus("run", system, "--out", tmp_path / "c", *first, *settings[2:]).exit_code == 0
    assert np.array_equal(
        read_csv(tmp_path / "c" / "results.csv")["observer.estimate.theta"], a["observer.estimate.theta"]
    )
    for verb in (("run", system), ("campaign", system, "--runs", "1", "--vary", "plant.sensor.seed")):
        wrong = parameter_set(tmp_path / "wrong.ssv", ("tuning.process_noise.theta", 1.0), ("tuning.nothing", 1.0))
        message = refused(observer_fmus(*verb, "--parameters", wrong, "--out", tmp_path / "d"))
        assert "nothing has all of its variables; 'observer' has no 'tuning.nothing'" in message


def test_two_elements_that_have_all_names_are_told_apart_by_set(built: Build, tmp_path: Path) -> None:
    observer = built("moved_riccati")
    write_ssp(System("two", {"a": Element(observer), "b": Element(observer)}, stop=1.0, step=0.1), tmp_path / "two.ssp")
    values = parameter_set(tmp_path / "x.ssv", ("tuning.process_noise.v", 0.25))
    message = refused(observer_fmus("run", tmp_path / "two.ssp", "--parameters", values))
    assert message.endswith("x.ssv: fits a and b alike: name the variables by --set instead")
