"""The command line of the check: one line for each finding, exit codes, what cannot be checked."""

from __future__ import annotations

import re
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from junitparser import JUnitXml

from broken_fmus import Make
from fmu_src.compliance.files.package import NotAnFmu, open_package
from tools import ROOT


def command(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "commands", "check", *map(str, arguments)], cwd=ROOT, capture_output=True, text=True
    )


def test_the_command_line_says_one_line_for_each_finding_and_writes_junit(make: Make, tmp_path: Path) -> None:
    path, out = make(defect="set-constant"), tmp_path / "out.xml"
    result = command(path, "--junit", out)
    assert result.returncode == 1
    lines = result.stdout.splitlines()
    assert [line for line in lines if line.startswith(f"{path}: set-constant [2.2.7] limit: expected fmi2Error")]
    assert len(lines) == 3 and lines[-1].endswith("rules, 2 findings")
    suites = list(JUnitXml.fromfile(str(out)))
    assert len(suites) == 1 and suites[0].tests > 50 and suites[0].failures == 2
    assert command(path, "--junit", tmp_path / "nowhere" / "out.xml").returncode == 2
    failed = [case for case in suites[0] if case.result]
    assert [case.name.split()[0] for case in failed] == ["set-constant"]


def other_version(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", '<fmiModelDescription fmiVersion="1.0"/>')


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (lambda path: None, "there is no such file"),
        (lambda path: path.mkdir(), "is a folder"),
        (lambda path: path.write_text("no zip"), "not an FMU: no sound zip file"),
        (lambda path: zipfile.ZipFile(path, "w").close(), "there is no modelDescription.xml in it"),
        (other_version, "is of FMI version 1.0; FMI 2.0 and 3.0 are checked here"),
    ],
)
def test_what_cannot_be_checked_is_refused_in_one_line(
    tmp_path: Path, write: Callable[[Path], object], words: str
) -> None:
    path = tmp_path / "x.fmu"
    write(path)
    with pytest.raises(NotAnFmu, match=re.escape(words)):
        open_package(path)
    result = command(path, "--junit", tmp_path / "out.xml")
    assert result.returncode == 2
    (line,) = result.stderr.strip().splitlines()
    assert words in line
    (suite,) = JUnitXml.fromfile(str(tmp_path / "out.xml"))
    assert suite.name == "x.fmu" and (suite.tests, suite.errors, suite.failures) == (1, 1, 0)
