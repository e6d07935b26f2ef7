"""An FMU that does not behave is a finding, or one line and exit code 2; never the end of the check."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import psutil
import pytest
from lxml import etree

from broken_fmus import BINARY, Contents, Make, compiled
from fmu_src.compliance.check import check
from fmu_src.compliance.files import package
from fmu_src.compliance.files.description import read
from fmu_src.compliance.files.package import NotAnFmu
from fmu_src.compliance.files.systems import is_named, is_part_of, names_in
from fmu_src.compliance.finding import CannotCheck
from fmu_src.compliance.library import lifecycle, process
from fmu_src.compliance.library.calls import Subject
from tools import ROOT


def lines(path: Path, **environment: str) -> tuple[int, list[str]]:
    """Exit code and output of the command."""
    command = [sys.executable, "-m", "commands", "check", str(path)]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=os.environ | environment)
    return result.returncode, (result.stdout + result.stderr).splitlines()


@pytest.mark.parametrize(
    ("defect", "words"),
    [
        ("kills-its-parent", "was ended by the FMU"),
        ("garbage", "the FMU wrote into the pipe of the process that drives it"),
    ],
)
def test_an_fmu_that_breaks_the_checks_own_processes_is_one_line(make: Make, defect: str, words: str) -> None:
    path = make(defect=defect)
    with pytest.raises(CannotCheck, match=words):
        check(path)
    code, (line,) = lines(path)
    assert code == 2 and words in line and str(path) in line
    assert check(make()).findings == []  # and the next one is checked


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_nothing_runs_on_after_a_check_that_was_ended(make: Make, tmp_path: Path, how: signal.Signals) -> None:
    command = [sys.executable, "-m", "commands", "check", str(make(defect="hang-at-once"))]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    checking = subprocess.Popen(command, cwd=ROOT, env=os.environ | {"TMPDIR": str(tmp_path)}, **quiet)
    this, end = psutil.Process(checking.pid), time.monotonic() + 60
    while (
        not (started := this.children(recursive=True)) or max(p.cpu_times().user for p in started[1:] or started) < 0.5
    ):
        assert checking.poll() is None and time.monotonic() < end
        time.sleep(0.1)
    checking.send_signal(how)
    checking.wait(30)
    assert psutil.wait_procs(started, timeout=30)[1] == []


def test_a_step_that_stays_pending_is_waited_for_once(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "TIMEOUT", 1.0)
    report = check(make(defect="pending"))
    assert [(finding.rule, finding.found) for finding in report.findings] == [("legal-call", "fmi2Pending for 1 s")]
    assert report.notes == ["the FMU cannot be run, so no further rule was applied"]


def test_an_fmu_that_ends_its_process_is_found(make: Make) -> None:
    (finding,) = check(make(defect="exits")).findings
    assert finding.found == "the end of the process (exit code 0) in fmi2DoStep"


def test_what_is_printed_is_counted_and_not_repeated(make: Make) -> None:
    (finding,) = check(make(defect="prints-much")).findings
    assert finding.rule == "prints" and "104857600 bytes" in finding.found and len(finding.found) < 200


def test_a_refused_reset_does_not_end_the_check(make: Make) -> None:
    report = check(make(defect="reset-refused"))
    (finding,) = report.findings
    assert finding.rule == "legal-call" and "fmi2Reset" in finding.subject and len(finding.subjects) == 5
    assert "state-serialize" in report.checked


def test_messages_are_read_with_their_arguments(make: Make) -> None:
    (finding,) = check(make(defect="log-messages")).findings
    assert finding.subject == "initialized after 0 steps"


def test_a_library_outside_of_the_fmu_is_never_loaded(make: Make, tmp_path: Path) -> None:
    outside, mark = tmp_path / "outside.so", tmp_path / "loaded"
    source = f'__attribute__((constructor)) static void mark(void) {{ (void)!creat("{mark}", 0600); }}'
    outside.write_bytes(compiled(tmp_path / "code", source=f"#include <fcntl.h>\n{source}\n"))
    ctypes.CDLL(str(outside))
    assert mark.exists()
    mark.unlink()
    for identifier in ("/".join([".."] * 12) + str(outside.with_suffix("")), str(outside.with_suffix(""))):
        report = check(make(edits={'modelIdentifier="broken"': f'modelIdentifier="{identifier}"'}))
        assert {finding.rule for finding in report.findings} == {"model-identifier", "binary-missing"}
        assert report.notes == ["no binary for this machine (no name for it): co-simulation was not driven"]
    assert not mark.exists()


def test_a_files_name_forges_no_line(make: Make, tmp_path: Path) -> None:
    for content in (make().read_bytes(), b"no zip"):
        path = tmp_path / "a\nb\x1b[2J.fmu"
        path.write_bytes(content)
        _, (line,) = lines(path)
        assert "a\\nb\\x1b[2J.fmu" in line


def test_a_path_that_is_too_long_is_one_line(tmp_path: Path) -> None:
    code, (line,) = lines(tmp_path / ("n" * 300))
    assert code == 2 and "File name too long" in line


def test_any_signal_is_a_crash(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    (finding,) = check(make(defect="signal")).findings
    assert finding.found == "a crash (signal 40) in fmi2DoStep"


def test_an_fmu_that_closes_files_of_the_process_is_found(make: Make) -> None:
    (finding,) = check(make(defect="closes")).findings
    assert finding.found.endswith("in fmi2DoStep")


def test_a_name_forges_no_line(make: Make) -> None:
    code, printed = lines(make(edits={'name="limit"': "name=\"'a&#10;x.fmu: 70 rules, no finding'\""}))
    assert code == 1 and len(printed) == 2
    assert "variable-name [2.2.9] 'a\\nx.fmu: 70 rules, no finding'" in printed[0]


def test_files_that_no_file_system_takes_are_one_line(make: Make) -> None:
    for path in (
        make({f"resources/{'n' * 300}": b""}),
        make({"resources": b"", "resources/table.txt": b""}),
        make(edits={'modelIdentifier="broken"': f'modelIdentifier="{"n" * 300}"'}),
    ):
        code, (line,) = lines(path)
        assert code == 2 and str(path) in line


@pytest.mark.parametrize(
    ("limit", "value", "words"),
    [
        ("MOST_BYTES", 1 << 10, "GiB are checked here"),
        ("MOST_BYTES_OF_DESCRIPTION", 1 << 10, "MiB are checked here"),
        ("MOST_BYTES_OF_XML", 10, "extra/x.xml inflates to 0 MiB; at most 0 MiB are checked here"),
        ("MOST_FOLDERS", 1, r"binaries/linux64/broken\.so lies 2 folders deep; at most 1 are unpacked here"),
        ("MOST_FILES", 2, "holds 3 files; at most 2 are checked here"),
    ],
)
def test_what_inflates_beyond_a_limit_is_refused_before_it_is_inflated(
    make: Make, monkeypatch: pytest.MonkeyPatch, limit: str, value: int, words: str
) -> None:
    path = make({"extra/x.xml": b"<longer than="} if limit == "MOST_BYTES_OF_XML" else {})
    monkeypatch.setattr(package, limit, value)
    monkeypatch.setattr("zipfile.ZipFile.open", lambda *_: pytest.fail("it was inflated"))
    with pytest.raises(NotAnFmu, match=words):
        check(path)


def test_a_description_of_too_many_tags_is_refused_before_it_is_read(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(package, "MOST_MARKS", 50)
    with pytest.raises(NotAnFmu, match="tags and attributes; at most 50 are checked here"):
        check(make())


def test_what_is_as_large_as_the_limits_allow_is_checked_and_nothing_that_is_larger(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = make({BINARY: None, "extra/x.xml": b"<x/>", "extra/a/b/c.txt": b""})
    with zipfile.ZipFile(path) as archive:
        document, entries = archive.read("modelDescription.xml"), archive.infolist()
    sizes = {
        "MOST_BYTES": sum(entry.file_size for entry in entries),
        "MOST_BYTES_OF_DESCRIPTION": len(document),
        "MOST_BYTES_OF_XML": len(b"<x/>"),
        "MOST_FILES": len(entries),
        "MOST_FOLDERS": 3,
        "MOST_MARKS": document.count(b"<") + document.count(b"="),
    }
    for limit, size in sizes.items():
        monkeypatch.setattr(package, limit, size)
    check(path)
    for limit, size in sizes.items():
        monkeypatch.setattr(package, limit, size - 1)
        with pytest.raises(NotAnFmu, match=r"at most .* are (checked|unpacked) here"):
            check(path)
        monkeypatch.setattr(package, limit, size)


def test_where_processes_cannot_fork_each_case_has_a_server_of_its_own(
    make: Make, sound: Contents, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "FORKS", False)
    monkeypatch.setattr(process, "TIMEOUT", 2.0)
    monkeypatch.setattr(process, "_server", None)
    check(make({BINARY: None}))  # a static check alone has one case
    library = make(defect="exits")
    with zipfile.ZipFile(library) as archive:
        archive.extractall(tmp_path / "fmu")
    (tmp_path / "scratch").mkdir()
    description = read(etree.fromstring(sound["modelDescription.xml"]))
    subject = Subject(
        description, "CoSimulation", str(tmp_path / "fmu" / BINARY), "", 0.0, 1.0, 0.1, (), tmp_path / "scratch"
    )
    for probe, found in (
        (lifecycle.load, []),
        (lifecycle.life, ["the end of the process (exit code 0) in fmi2DoStep"]),
    ):
        outcome = process.run(process.Case("legal-call", "a legal life", probe), subject)
        assert [finding.found for finding in outcome.findings] == found


def test_a_long_temporary_folder_is_no_matter(make: Make, tmp_path: Path) -> None:
    folder = tmp_path / ("x" * 120)
    folder.mkdir()
    code, printed = lines(make(), TMPDIR=str(folder))
    assert code == 0 and printed[-1].endswith("rules, no finding")
    assert list(folder.iterdir()) == []


def test_a_full_disk_is_one_line(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("zipfile.ZipFile.extract", full)
    with pytest.raises(CannotCheck, match=r"cannot be unpacked: modelDescription\.xml: No space left on device"):
        check(make())


def test_libraries_of_the_system_and_declared_ones_are_no_findings() -> None:
    for name in (
        "COMCTL32",
        "COMDLG32",
        "NETAPI32",
        "WINTRUST",
        "WSOCK32",
        "DHCPCSVC",
        "OPENGL32",
        "api-ms-win-crt-heap-l1-1-0",
    ):
        assert is_part_of(".dll", f"{name}.dll")
    for name in ("VCRUNTIME140", "MSVCP140", "libgcc_s_seh-1", "python311"):
        assert not is_part_of(".dll", f"{name}.dll")
    declared = names_in("Needs the Visual C++ runtime (VCRUNTIME140.dll, MSVCP140.dll) and libgfortran.so.5.")
    for name in ("vcruntime140.dll", "MSVCP140.dll", "libgfortran.so.5", "/opt/lib/libgfortran.dylib"):
        assert is_named(name, declared)
    assert not is_named("libquadmath.so.0", declared)
