"""observer-fmus run: the files it writes, and one line, never a traceback, for whatever a user does wrong."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet
from typer.testing import Result

from cosim.master import run
from cosim.results import read_csv
from cosim.system import Element, System, write_ssp
from verbs import observer_fmus, refused

Build = Callable[[str], Path]


def run_verb(*arguments: object) -> Result:
    return observer_fmus("run", *arguments)


def test_run_writes_all_outputs_and_a_report(duffing_system: Path, tmp_path: Path) -> None:
    result = run_verb(duffing_system, "--out", tmp_path / "new" / "x")
    assert result.exit_code == 0, result.output
    assert "plant" in result.stdout and "observer" in result.stdout and "results.csv" in result.stdout
    expected = run(duffing_system)
    written = read_csv(tmp_path / "new" / "x" / "results.csv")
    assert list(written) == ["time", *expected.names]
    for name in expected.names:
        np.testing.assert_array_equal(written[name], expected[name])
    assert (tmp_path / "new" / "x" / "report.html").stat().st_size < 1.5e6


def test_set_stop_and_step_change_the_experiment(duffing_system: Path, tmp_path: Path) -> None:
    settings = ("--set", "plant.start.x1=0.25", "--set", "plant.sensor.seed=7", "--stop", 1, "--step", 0.05)
    assert run_verb(duffing_system, "--out", tmp_path, *settings).exit_code == 0
    written = read_csv(tmp_path / "results.csv")
    assert written["time"].tolist() == [i * 0.05 for i in range(21)]
    assert written["plant.x.x1"][0] == 0.25


def test_results_go_to_a_folder_of_the_systems_name(
    duffing_system: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_verb(duffing_system, "--stop", 1).exit_code == 0
    assert (tmp_path / "results" / "duffing_system" / "results.csv").is_file()


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
    duffing_system: Path, tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    assert message in refused(run_verb(duffing_system, "--out", tmp_path / "out", *arguments), 2)
    assert not (tmp_path / "out").exists()


def test_a_file_that_is_no_system_is_one_line_and_status_2(tmp_path: Path) -> None:
    assert "there is no such file" in refused(run_verb(tmp_path / "nowhere.ssp"), 2)
    (tmp_path / "text.ssp").write_text("hello")
    assert "not an SSP file" in refused(run_verb(tmp_path / "text.ssp"), 2)


def test_an_output_folder_that_cannot_be_made_is_one_line_and_status_2(duffing_system: Path, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file")
    assert "cannot write to" in refused(run_verb(duffing_system, "--out", tmp_path / "taken"), 2)


def test_a_failed_run_is_one_line_and_status_1_and_keeps_the_record(built: Build, tmp_path: Path) -> None:
    write_ssp(System("doomed", {"growing": Element(built("growing_toy"))}, stop=5.0, step=0.1), tmp_path / "doomed.ssp")
    line = refused(run_verb(tmp_path / "doomed.ssp", "--out", tmp_path / "out"), 1)
    assert "element 'growing' at t =" in line and "results.csv" in line
    assert 2 < len(read_csv(tmp_path / "out" / "results.csv")["time"]) < 51


def test_warnings_are_counted_and_the_first_is_shown(built: Build, tmp_path: Path) -> None:
    system = System("blind", {"observer": Element(built("sampled_toy"), {"y": float("nan")})}, stop=1.0, step=0.1)
    write_ssp(system, tmp_path / "blind.ssp")
    result = run_verb(tmp_path / "blind.ssp", "--out", tmp_path)
    assert result.exit_code == 0
    assert re.search(r"10 warnings, the first by observer: .*rejected_samples", result.stdout)


def test_what_the_codes_of_the_table_mean_is_beside_it(duffing_system: Path, tmp_path: Path) -> None:
    assert observer_fmus("run", duffing_system, "--stop", 1, "--out", tmp_path).exit_code == 0
    rows = (tmp_path / "results.legend.csv").read_text(encoding="utf-8").splitlines()
    assert rows[0] == "column,code,word" and "observer.diagnostics.status,14,propagated_guess" in rows


def test_parquet_holds_the_numbers_to_the_bit_and_the_words_of_codes(duffing_system: Path, tmp_path: Path) -> None:
    for form in ("csv", "parquet"):
        assert observer_fmus("run", duffing_system, "--stop", 1, "--out", tmp_path, "--format", form).exit_code == 0
    table, expected = parquet.read_table(tmp_path / "results.parquet"), read_csv(tmp_path / "results.csv")
    assert table.column_names == list(expected)
    with (tmp_path / "results.legend.csv").open(newline="", encoding="utf-8") as file:
        words = {(name, int(code)): word for name, code, word in list(csv.reader(file))[1:]}
    for name, values in expected.items():
        coded = any(name == column for column, _ in words)
        assert table[name].to_pylist() == ([words[name, int(v)] for v in values] if coded else values.tolist())


def test_a_form_of_the_table_that_nobody_knows_is_one_line(tmp_path: Path) -> None:
    line = refused(observer_fmus("run", "x.ssp", "--format", "xls", "--out", tmp_path))
    assert "'xls' is none of csv, parquet" in line
