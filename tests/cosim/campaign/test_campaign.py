"""Campaigns: the same table however they are run, interrupted or not; failures recorded; questions that make no sense refused."""

from __future__ import annotations

import csv
import io
import os
import signal
import subprocess
import sys
import time
import urllib.request
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import pytest
from elftools.elf.elffile import ELFFile
from typer.testing import CliRunner, Result

import browser
from commands.app import app
from cosim.campaign import campaign as module
from cosim.campaign import workers
from cosim.campaign.campaign import campaign
from cosim.campaign.picture import figure, svg
from cosim.campaign.report import course, summary, write_campaign_report
from cosim.campaign.run import ROWS
from cosim.campaign.variation import draw
from cosim.campaign.workers import connected
from cosim.errors import ExperimentError, SystemFileError
from cosim.master import run
from cosim.system import Element, System, read_ssp, write_ssp
from cosim.system.resolve import resolve
from fmu_src import export
from observers.status import CODE
from observers.ukf import ukf
from reference_models.duffing import DUFFING

Build = Callable[[str], Path]
JUMP = {"parameter.theta_jump_time[1]": 2.0, "parameter.theta_jump_value[1]": 0.1}
NOISE = {"sensor.noise_bound": 0.1, "sensor.sample_time": 0.1}
VARY = {"plant.start.x1": (-1.0, 1.0), "plant.start.x2": (-1.0, 1.0), "plant.sensor.seed": None}
ERROR = "(observer.estimate.theta - plant.x.theta)"


@pytest.fixture(scope="module")
def system(built: Build, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A noisy Duffing plant whose theta jumps at 2 s, and a filter, for 4 s."""
    folder = tmp_path_factory.mktemp("campaign")
    observer = export(ukf(DUFFING, sample_time=0.1), folder)
    elements = {"plant": Element(built("duffing"), JUMP | NOISE), "observer": Element(observer)}
    write_ssp(System("noisy", elements, [("plant.y", "observer.y")], stop=4.0, step=0.1), folder / "noisy.ssp")
    return folder / "noisy.ssp"


@pytest.fixture(scope="module")
def whole(system: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a campaign of 30 runs on one worker."""
    folder = tmp_path_factory.mktemp("whole")
    campaign(system, folder, runs=30, vary=VARY, settle=1.0, workers=1)
    return folder


def cosim(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments])


def refused(result: Result, code: int = 2) -> str:
    """The one line of an error."""
    assert result.exit_code == code, result.output
    assert "Traceback" not in result.output
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith("error: ")
    return line


def table(folder: Path) -> list[dict[str, str]]:
    with (folder / "runs.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_the_table_says_of_each_run_what_the_same_run_alone_gives(system: Path, whole: Path) -> None:
    row = table(whole)[7]
    values = {path: float(row[path]) for path in VARY}
    result = run(system, overrides=values)
    error = result["observer.estimate.theta"] - result["plant.x.theta"]
    assert float(row[f"rms{ERROR}"]) == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-15, abs=0)
    assert float(row[f"largest{ERROR}"]) == np.abs(error).max()
    # Settled, 1 s after the start and after the jump at 2 s: t in (1, 2] and (3, 4].
    settled = np.r_[11:21, 31:41]
    assert float(row[f"settled_rms{ERROR}"]) == pytest.approx(np.sqrt(np.mean(error[settled] ** 2)), rel=1e-15, abs=0)
    fitting = int(row["observer.diagnostics.status.estimating"])
    assert fitting == np.sum(result["observer.diagnostics.status"] == CODE.estimating) > 5
    assert row["failure"] == "" and row["non_finite"] == row["observer.diagnostics.solver_failures"] == "0"


@pytest.mark.long
def test_one_and_two_workers_and_a_dask_scheduler_give_the_same_table(
    system: Path, whole: Path, tmp_path: Path
) -> None:
    campaign(system, tmp_path / "two", runs=30, vary=VARY, settle=1.0, workers=2)
    assert (tmp_path / "two" / "runs.csv").read_bytes() == (whole / "runs.csv").read_bytes()
    # A worker with two threads in one process: fmpy changes the process's working directory while it loads an FMU.
    with workers.LocalCluster(n_workers=1, threads_per_worker=2, dashboard_address=":0") as cluster:
        campaign(system, tmp_path / "cluster", runs=30, vary=VARY, settle=1.0, scheduler=cluster.scheduler_address)
    assert (tmp_path / "cluster" / "runs.csv").read_bytes() == (whole / "runs.csv").read_bytes()


@pytest.mark.long
def test_a_killed_campaign_goes_on_where_it_was_and_leaves_no_process(
    system: Path, whole: Path, tmp_path: Path
) -> None:
    arguments = [sys.executable, "-m", "commands", "campaign", str(system), "--runs", "30", "--settle", "1"]
    for path, bounds in VARY.items():
        arguments += ["--vary", path if bounds is None else f"{path}={bounds[0]}:{bounds[1]}"]
    arguments += ["--out", str(tmp_path), "--workers", "1"]
    process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    runs = tmp_path / "runs"
    deadline = time.monotonic() + 60
    while len(list(runs.glob("*.npz"))) < 3:
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.005)
    children = psutil.Process(process.pid).children(recursive=True)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    before = {path.name: path.stat().st_mtime_ns for path in runs.glob("*.npz")}
    assert 3 <= len(before) < 30
    assert psutil.wait_procs(children, timeout=30)[1] == []
    result = subprocess.run(arguments, capture_output=True, text=True, check=True)
    assert "30 runs, 0 failed runs" in result.stdout
    assert {name: (runs / name).stat().st_mtime_ns for name in before} == before
    assert (tmp_path / "runs.csv").read_bytes() == (whole / "runs.csv").read_bytes()


@pytest.mark.long
def test_a_finished_campaign_does_not_run_again_and_more_runs_go_on_from_there(
    system: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign(system, tmp_path, runs=2, vary=VARY, workers=1)
    records = sorted((tmp_path / "runs").iterdir())
    times = [path.stat().st_mtime_ns for path in records]
    first = table(tmp_path)
    told: list[tuple[int, int]] = []
    campaign(system, tmp_path, runs=4, vary=VARY, workers=1, progress=lambda done, total: told.append((done, total)))
    assert told == [(2, 4), (3, 4), (4, 4)]  # those of before are done from the start
    assert [path.stat().st_mtime_ns for path in records] == times
    assert table(tmp_path)[:2] == first and len(table(tmp_path)) == 4
    monkeypatch.setattr(module, "connected", lambda *_: pytest.fail("it runs again"))
    campaign(system, tmp_path, runs=4, vary=VARY)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"seed": 1}, "seed was 0, now 1"),
        ({"vary": {"plant.sensor.seed": None}}, "vary was"),
        ({"overrides": {"plant.parameter.damping": 0.3}}, "overrides was {}, now {'plant.parameter.damping': 0.3}"),
        ({"stop": 2.0}, "stop was 4.0, now 2.0"),
        ({"settle": 2.0}, "settle was 1.0, now 2.0"),
    ],
)
def test_another_question_in_the_same_folder_is_refused_with_what_differs(
    system: Path, whole: Path, change: dict, reason: str
) -> None:
    before = (whole / "runs.csv").read_bytes()
    with pytest.raises(ExperimentError, match="holds another campaign") as caught:
        campaign(system, whole, **({"runs": 30, "vary": VARY, "settle": 1.0} | change))
    assert reason in str(caught.value)
    assert (whole / "runs.csv").read_bytes() == before


def test_another_ssp_file_of_the_same_name_in_the_same_folder_is_refused(
    system: Path, whole: Path, tmp_path: Path
) -> None:
    elements = read_ssp(system, tmp_path).elements
    elements["plant"].parameters["parameter.damping"] = 0.3  # type: ignore[index]
    write_ssp(System("noisy", elements, [("plant.y", "observer.y")], stop=4.0, step=0.1), tmp_path / system.name)
    with pytest.raises(ExperimentError, match=r"the contents of the \.ssp file"):
        campaign(tmp_path / system.name, whole, runs=30, vary=VARY, settle=1.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--vary", "plant.start.x9=-1:1"), "has no variable 'start.x9'; did you mean 'start.x2' or 'start.x1'?"),
        (("--vary", "plant.y=-1:1"), "'y' is an output that is calculated or constant: it cannot be set"),
        (("--vary", "observer.y=-1:1"), "'observer.y' cannot be set: it is connected to 'plant.y'"),
        (("--vary", "plant.start.x1"), "'plant.start.x1' is a Real: it varies in a range, plant.start.x1=LOW:HIGH"),
        (("--vary", "plant.start.x1=1:-1"), "the range 1:-1 must be finite and ascend"),
        (("--vary", "plant.start.x1=0:nan"), "the range 0:nan must be finite and ascend"),
        (("--vary", "plant.start.x1=a:b"), "'a' and 'b' must be numbers"),
        (("--vary", "plant.start.x1=1"), "not of the form ELEMENT.VARIABLE=LOW:HIGH"),
        (("--vary", "plant.parameter.damping=-1:1"), "'parameter.damping' = -1.0 lies outside [0, 100]"),
        (("--vary", "plant.sensor.seed=0:9999999"), "'sensor.seed' = 9999999 lies outside [0, 1048576]"),
        (("--vary", "plant.sensor.seed=0.5:3"), "'sensor.seed' is an Integer: 0.5 is not a whole number"),
        (("--vary", "plant.sensor.seed", "--runs", 2000000), "has 1048577 values: too few for 2000000 runs"),
        (("--vary", "plant.sensor.seed", "--set", "plant.sensor.seed=3"), "is varied and set to 3: only one"),
        (("--vary", "plant.sensor.seed", "--vary", "plant.sensor.seed"), "'plant.sensor.seed' is varied twice"),
        (("--vary", "plant.sensor.seed", "--set", "plant.sensor.sede=3"), "did you mean 'sensor.seed'"),
        (("--vary", "plant.sensor.seed", "--runs", 0), "runs = 0 must be at least 1"),
        (("--vary", "plant.sensor.seed", "--workers", 0), "workers = 0 must be at least 1"),
        (("--vary", "plant.sensor.seed", "--seed", -1), "seed = -1 must be at least 0"),
        (("--vary", "plant.sensor.seed", "--stop", 0.25), "stop time 0.25 is not a multiple of the step size 0.1"),
        (("--vary", "plant.sensor.seed", "--settle", -1), "settle = -1 s must not be negative"),
        (("--vary", "plant.sensor.seed", "--scheduler", "tcp://127.0.0.1:1"), "no Dask workers behind the scheduler"),
        (("--vary", "plant.sensor.seed", "--scheduler", "nonsense://x"), "no Dask workers behind the scheduler"),
    ],
)
def test_a_users_mistake_is_one_line_and_status_2_before_anything_runs(
    system: Path, tmp_path: Path, arguments: tuple[object, ...], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers, "CONNECT_TIMEOUT", 0.5)
    line = refused(cosim("campaign", system, "--runs", 3, "--out", tmp_path / "out", *arguments))
    assert message in line
    assert not list(tmp_path.rglob("*.npz"))


def test_a_system_without_an_estimate_is_refused(built: Build, tmp_path: Path) -> None:
    write_ssp(System("alone", {"plant": Element(built("duffing"))}, stop=1.0, step=0.1), tmp_path / "alone.ssp")
    with pytest.raises(ExperimentError, match="has no estimate beside its truth"):
        campaign(tmp_path / "alone.ssp", tmp_path / "out", runs=2, vary={"plant.start.x1": (0.0, 1.0)})


def test_a_damaged_record_of_a_run_is_named(system: Path, tmp_path: Path) -> None:
    campaign(system, tmp_path, runs=1, vary=VARY, workers=1)
    record = tmp_path / "runs" / "000000.npz"
    whole = record.read_bytes()
    middle = len(whole) // 4
    flipped = whole[:middle] + bytes(byte ^ 255 for byte in whole[middle : middle + 40]) + whole[middle + 40 :]
    for damaged in (b"PK damaged", b"", whole[: len(whole) // 2], flipped):
        record.write_bytes(damaged)
        with pytest.raises(SystemFileError, match=r"000000\.npz: not the record of this run"):
            campaign(system, tmp_path, runs=1, vary=VARY, workers=1)


def test_draws_depend_on_seed_and_run_only_and_fill_their_range(system: Path, tmp_path: Path) -> None:
    resolved = resolve(read_ssp(system, tmp_path))
    values = [draw(VARY, resolved, 0, k) for k in range(2000)]
    assert [draw(VARY, resolved, 0, k) for k in reversed(range(2000))] == values[::-1]
    assert draw({"plant.start.x2": (-1.0, 1.0)}, resolved, 0, 5)["plant.start.x2"] == values[5]["plant.start.x2"]
    assert len({v["plant.sensor.seed"] for v in values}) == 2000
    x1, x2 = (np.array([v[f"plant.start.{x}"] for v in values]) for x in ("x1", "x2"))
    for x in (x1, x2):
        # Of 2000 uniform draws in [-1, 1]: mean 0 within 4 standard errors, variance 1/3, nothing outside.
        assert abs(x.mean()) < 4 * np.sqrt(1 / 3 / 2000) and abs(x.var() - 1 / 3) < 0.03 and np.abs(x).max() <= 1
    assert abs(np.corrcoef(x1, x2)[0, 1]) < 4 / np.sqrt(2000)
    assert draw(VARY, resolved, 1, 0) != values[0]
    whole = [draw({"plant.sensor.seed": (3.0, 5.0)}, resolved, 0, k)["plant.sensor.seed"] for k in range(100)]
    assert set(whole) == {3, 4, 5} and all(isinstance(v, int) for v in whole)


def test_a_run_that_fails_is_recorded_with_its_reason_and_the_others_go_on(
    system: Path, built: Build, tmp_path: Path
) -> None:
    # z' = z^2 leaves the doubles before 4 s where it starts above 1/4.
    elements = {**read_ssp(system, tmp_path).elements, "growing": Element(built("growing_toy"))}
    doomed = System("doomed", elements, [("plant.y", "observer.y")], stop=4.0, step=0.1)
    write_ssp(doomed, tmp_path / "doomed.ssp")
    vary = ("--vary", "growing.start.z=-1:1", "--workers", 1)
    result = cosim("campaign", tmp_path / "doomed.ssp", "--runs", 12, *vary, "--out", tmp_path / "out")
    rows = table(tmp_path / "out")
    failed = [row for row in rows if row["failure"]]
    assert {row["run"] for row in failed} == {row["run"] for row in rows if float(row["growing.start.z"]) > 0.25}
    assert 0 < len(failed) < 12
    assert all("element 'growing' at t =" in row["failure"] and row[f"rms{ERROR}"] == "" for row in failed)
    assert f"{len(failed)} of 12 runs failed, the first, run {failed[0]['run']}: element 'growing'" in refused(
        result, 1
    )
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("element &#x27;growing&#x27;") == len(failed) and "Runs that failed" in page
    assert "<svg" in (tmp_path / "out" / "figure.svg").read_text()


@pytest.mark.long
def test_an_fmu_that_crashes_its_process_is_a_failed_run(system: Path, built: Build, tmp_path: Path) -> None:
    crashing = read_ssp(system, tmp_path)
    crashing.elements["crashing"] = Element(_crashing(built("growing_toy"), tmp_path / "crashing.fmu"))  # type: ignore[index]
    write_ssp(crashing, tmp_path / "crashing.ssp")
    made = campaign(tmp_path / "crashing.ssp", tmp_path / "out", runs=1, vary=VARY, workers=1)
    assert made.outcomes[0].failure == "element 'crashing' at t = 0: fmi2DoStep ended the process by SIGILL"
    with pytest.raises(ValueError, match="all runs failed"):
        figure(made)
    write_campaign_report(made, tmp_path / "out" / "report.html")
    assert "ended the process by SIGILL" in (tmp_path / "out" / "report.html").read_text()


def test_the_workers_listen_on_this_machine_only_and_without_a_dashboard() -> None:
    with connected(None, 1, False) as client:
        processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
        listening = [c for p in processes for c in p.net_connections("tcp") if c.status == psutil.CONN_LISTEN]
        assert {c.laddr.ip for c in listening} == {"127.0.0.1"}
        for page in ("", "status", "info/main/workers.html", "health", "json/counts.json"):
            with pytest.raises(OSError, match=r"404|refused"):
                urllib.request.urlopen(client.dashboard_link.replace("status", page), timeout=10)


def _crashing(fmu: Path, out: Path) -> Path:
    """A copy of `fmu` whose fmi2DoStep is an illegal instruction."""
    with zipfile.ZipFile(fmu) as archive, zipfile.ZipFile(out, "w") as copy:
        for name in archive.namelist():
            content = bytearray(archive.read(name))
            if name.endswith(".so"):
                elf = ELFFile(io.BytesIO(bytes(content)))
                (symbol,) = elf.get_section_by_name(".dynsym").get_symbol_by_name("fmi2DoStep")
                (offset,) = elf.address_offsets(symbol["st_value"])
                content[offset : offset + 4] = b"\x0f\x0b\x00\x00"  # ud2; on ARM these four bytes are undefined too
            copy.writestr(name, bytes(content))
    return out


def test_the_figure_has_the_averages_over_the_runs(system: Path, whole: Path) -> None:
    made = campaign(system, whole, runs=30, vary=VARY, settle=1.0)
    x1, x2, theta = figure(made).axes
    records = [np.load(path) for path in sorted((whole / "runs").iterdir())]
    estimates, truths = (np.array([record[name] for record in records]) for name in ("estimates", "truths"))
    curves = {line.get_label(): line.get_ydata() for line in theta.lines}
    np.testing.assert_array_equal(curves["average of the estimates"], estimates[:, :, 2].mean(axis=0))
    np.testing.assert_allclose(curves["true"], np.where(np.arange(41) <= 20, 0.4, 0.1), rtol=5e-15)
    errors = {line.get_label(): line.get_ydata() for line in x1.lines}
    np.testing.assert_allclose(
        errors["rms error over the runs"], np.sqrt(np.mean((estimates - truths)[:, :, 0] ** 2, axis=0)), rtol=1e-15
    )
    found = course(made, made.pairs[0])
    below = np.abs(estimates - truths)[:, :, 0]
    assert ((below < found.half).mean(axis=0) == 0.5).all() and ((below < found.most).sum(axis=0) == 28).all()
    assert [axis.get_ylabel() for axis in (x1, x2, theta)] == ["error of x1 [m]", "error of x2 [m/s]", "theta [m/s2]"]
    assert svg(figure(made)) == svg(figure(made))
    assert [row[0] for row in summary(made).rows] == [f"observer.estimate.{v}" for v in ("x1", "x2", "theta")]


@pytest.mark.long
def test_a_browser_draws_the_report_of_a_campaign(system: Path, whole: Path, tmp_path: Path) -> None:
    made = campaign(system, whole, runs=30, vary=VARY, settle=1.0)
    write_campaign_report(made, tmp_path / "report.html", "<p>observer-fmus campaign</p>")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert (
        page.index("<h1>") < page.index("observer-fmus campaign") < page.index("<table>") < page.index("Over all runs")
    )
    assert "<td>estimating</td>" in page
    browser.check(tmp_path / "report.html", 3)


def test_long_runs_keep_a_bounded_number_of_rows_and_rate_all(system: Path, tmp_path: Path) -> None:
    made = campaign(system, tmp_path, runs=1, vary=VARY, step=0.001, workers=1)
    assert ROWS / 2 < len(made.outcomes[0].time) == len(made.outcomes[0].truths) <= ROWS
    assert sum(n for name, n in made.outcomes[0].numbers.items() if ".status." in name) == 4001
