"""The command line: the files it writes, and one line, never a traceback, for whatever a user does wrong."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from commands.app import app
from cosim.master import run
from cosim.report.estimates import paired, pairs
from cosim.report.figures import POINTS, figures
from cosim.report.page import Table, write_report
from cosim.results import read_csv
from cosim.system import Element, System, write_ssp
from fmu_src import export
from observers.pseudospectral import pseudospectral
from reference_models.duffing import DUFFING

Build = Callable[[str], Path]


@pytest.fixture(scope="module")
def example(built: Build, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plant and its observer, as a file."""
    folder = tmp_path_factory.mktemp("example")
    observer = export(pseudospectral(DUFFING, sample_time=0.1), folder)
    elements = {"plant": Element(built("duffing")), "observer": Element(observer, {"guess.x1": 0.5})}
    system = System("example", elements, [("plant.y", "observer.y")], stop=5.0, step=0.1)
    write_ssp(system, folder / "example.ssp")
    return folder / "example.ssp"


def cosim(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments])


def refused(result: Result, code: int) -> str:
    """The one line of an error."""
    assert result.exit_code == code, result.output
    assert "Traceback" not in result.output
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith("error: ")
    return line


def test_run_writes_all_outputs_and_a_report(example: Path, tmp_path: Path) -> None:
    result = cosim("run", example, "--out", tmp_path / "new" / "x")
    assert result.exit_code == 0, result.output
    assert "plant" in result.stdout and "observer" in result.stdout and "results.csv" in result.stdout
    expected = run(example)
    written = read_csv(tmp_path / "new" / "x" / "results.csv")
    assert list(written) == ["time", *expected.names]
    for name in expected.names:
        np.testing.assert_array_equal(written[name], expected[name])
    assert (tmp_path / "new" / "x" / "report.html").stat().st_size < 8e6


def test_set_stop_and_step_change_the_experiment(example: Path, tmp_path: Path) -> None:
    settings = ("--set", "plant.start.x1=0.25", "--set", "plant.sensor.seed=7", "--stop", 1, "--step", 0.05)
    assert cosim("run", example, "--out", tmp_path, *settings).exit_code == 0
    written = read_csv(tmp_path / "results.csv")
    assert written["time"].tolist() == [i * 0.05 for i in range(21)]
    assert written["plant.x.x1"][0] == 0.25


def test_results_go_to_a_folder_of_the_systems_name(
    example: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cosim("run", example, "--stop", 1).exit_code == 0
    assert (tmp_path / "results" / "example" / "results.csv").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--set", "plant.sensor.seed"), "--set plant.sensor.seed: not of the form ELEMENT.VARIABLE=VALUE"),
        (("--set", "=7"), "--set =7: not of the form"),
        (("--set", "plant.sensor.seed="), "not of the form"),
        (("--set", "plant.sensor.sede=7"), "has no variable 'sensor.sede'; did you mean 'sensor.seed'"),
        (("--set", "plant.sensor.seed=1.5"), "'sensor.seed' is an Integer: 1.5 is not a whole number"),
        (("--set", "plant.parameter.damping=[bold]"), "'[bold]' is not a number"),
        (("--stop", "0.25"), "stop time 0.25 is not a multiple of the step size 0.1"),
        (("--step", "-1"), "step size -1 must be positive"),
        (("--step", "1e-12"), "5e+12 steps of 1e-12 s up to 5 s are more than 100000000"),
        (("--set", "plant.sensor.seed=2000000"), "'sensor.seed' = 2000000 lies outside [0, 1048576]"),
    ],
)
def test_a_users_mistake_is_one_line_and_status_2(
    example: Path, tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    assert message in refused(cosim("run", example, "--out", tmp_path / "out", *arguments), 2)
    assert not (tmp_path / "out").exists()


def test_a_file_that_is_no_system_is_one_line_and_status_2(tmp_path: Path) -> None:
    assert "there is no such file" in refused(cosim("run", tmp_path / "nowhere.ssp"), 2)
    (tmp_path / "text.ssp").write_text("hello")
    assert "not an SSP file" in refused(cosim("run", tmp_path / "text.ssp"), 2)


def test_an_output_folder_that_cannot_be_made_is_one_line_and_status_2(example: Path, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file")
    assert "cannot write to" in refused(cosim("run", example, "--out", tmp_path / "taken"), 2)


def test_a_failed_run_is_one_line_and_status_1_and_keeps_the_record(built: Build, tmp_path: Path) -> None:
    write_ssp(System("doomed", {"growing": Element(built("growing_toy"))}, stop=5.0, step=0.1), tmp_path / "doomed.ssp")
    line = refused(cosim("run", tmp_path / "doomed.ssp", "--out", tmp_path / "out"), 1)
    assert "element 'growing' at t =" in line and "results.csv" in line
    assert 2 < len(read_csv(tmp_path / "out" / "results.csv")["time"]) < 51


def test_warnings_are_counted_and_the_first_is_shown(built: Build, tmp_path: Path) -> None:
    system = System("blind", {"observer": Element(built("sampled_toy"), {"y": float("nan")})}, stop=1.0, step=0.1)
    write_ssp(system, tmp_path / "blind.ssp")
    result = cosim("run", tmp_path / "blind.ssp", "--out", tmp_path)
    assert result.exit_code == 0
    assert re.search(r"10 warnings, the first by observer: .*rejected_samples", result.stdout)


def test_help_names_the_command_and_its_options() -> None:
    shown = subprocess.run(
        [sys.executable, "-m", "commands", "--help"], capture_output=True, text=True, check=True
    ).stdout
    assert "observer-fmus" in shown and "run" in shown
    options = cosim("run", "--help").stdout
    assert all(option in options for option in ("--out", "--set", "--stop", "--step"))


def test_estimates_are_paired_with_truths_by_name(example: Path) -> None:
    result = run(example)
    assert [(p.variable, p.estimate, p.truth) for p in pairs(result)] == [
        (v, f"observer.estimate.{v}", f"plant.x.{v}") for v in ("x1", "x2", "theta")
    ]
    np.testing.assert_array_equal(
        pairs(result)[0].error(result), np.abs(result["observer.estimate.x1"] - result["plant.x.x1"])
    )


def test_an_estimate_is_paired_with_the_plant_that_it_observes_only_and_algebraic_variables_too() -> None:
    names = [
        "a.x.v",
        "a.z.w",
        "b.x.v",
        "b.z.w",
        "one.estimate.v",
        "one.estimate.w",
        "two.estimate.v",
        "alone.estimate.v",
    ]
    upstream = {"a": {"one"}, "b": set(), "one": {"a", "one"}, "two": {"filter", "b"}, "alone": set()}
    found = paired(names, {element: frozenset(sources) for element, sources in upstream.items()})
    assert [(pair.estimate, pair.truth) for pair in found] == [
        ("one.estimate.v", "a.x.v"),
        ("one.estimate.w", "a.z.w"),
        ("two.estimate.v", "b.x.v"),
    ]


def test_the_figures_show_states_errors_status_and_times(example: Path) -> None:
    titles = [figure.layout.title.text for figure in figures(run(example))]
    assert titles == [
        "True and estimated values",
        "Errors of the estimates",
        "Status (observer.diagnostics.status)",
        "Cost of the estimate",
        "Iterations of the solver",
        "Computing time per communication step",
    ]


def test_a_system_without_an_observer_has_figures_too(built: Build) -> None:
    result = run(System("alone", {"plant": Element(built("duffing"))}, stop=1.0, step=0.1))
    titles = [figure.layout.title.text for figure in figures(result)]
    assert titles == ["Outputs of plant", "Computing time per communication step"]


def test_long_curves_are_thinned_without_losing_a_peak(built: Build) -> None:
    result = run(System("long", {"plant": Element(built("duffing"))}, stop=100.0, step=0.01))
    curve = figures(result)[0].data[1]
    assert curve.name == "x.x1 [m]" and len(curve.y) <= POINTS
    assert max(curve.y) == np.float32(result["plant.x.x1"].max())
    assert min(curve.y) == np.float32(result["plant.x.x1"].min())


def test_the_report_is_one_file_that_needs_nothing_else(example: Path, tmp_path: Path) -> None:
    result = run(example)
    table = Table(("claim", "measured"), [("error < 1e-8", "2e-9")])
    sections = [("First <run>", "As in the paper.", result), ("Second run", "", result)]
    write_report(tmp_path / "report.html", "A & B", "<p>Two runs.</p>", table, sections)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<title>A &amp; B</title>" in page and "First &lt;run&gt;" in page and "<td>error &lt; 1e-8</td>" in page
    assert not re.search(r"<(script|link|img)[^>]*(src|href)=", page)
    assert page.count("plotly.js v") == 1 and len(page) < 8e6
    identifiers = re.findall(r'id="(run-\d+-figure-\d+)"', page)
    assert len(identifiers) == len(set(identifiers)) == 12
