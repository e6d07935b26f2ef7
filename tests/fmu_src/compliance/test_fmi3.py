"""FMUs of FMI 3.0: the rules of the file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from broken_fmus import BROKEN, HOST, SUFFIX, Contents, Make, compiled, found, maker
from fmu_src.compliance.check import check
from fmu_src.compliance.files.binaries import FOLDERS, functions_of_fmi3
from fmu_src.compliance.rules import RULES, STATIC

SYSTEM = {".so": "linux", ".dll": "windows", ".dylib": "darwin"}[SUFFIX]
BINARY = f"binaries/{FOLDERS[HOST][1]}-{SYSTEM}/broken{SUFFIX}"
BUILD = (
    '<fmiBuildDescription fmiVersion="3.0"><BuildConfiguration modelIdentifier="broken"><SourceFileSet>'
    '<SourceFile name="{}"/></SourceFileSet></BuildConfiguration></fmiBuildDescription>'
)
_STUB = '__attribute__((visibility("default"))) int {0}(void);\nint {0}(void) {{ return 0; }}\n'


@pytest.fixture(scope="session")
def contents(tmp_path_factory: pytest.TempPathFactory) -> Contents:
    source = "".join(_STUB.format(name) for name in sorted(functions_of_fmi3("CoSimulation")))
    return {
        "modelDescription.xml": (BROKEN / "fmi3.xml").read_bytes(),
        "sources/buildDescription.xml": BUILD.format("broken.c").encode(),
        "sources/broken.c": b"",
        BINARY: compiled(tmp_path_factory.mktemp("fmi3"), source=source),
    }


@pytest.fixture
def make(contents: Contents, tmp_path: Path) -> Make:
    return maker(contents, tmp_path / "broken.fmu")


def test_a_sound_file_has_no_finding_and_a_note(make: Make) -> None:
    report = check(make())
    assert report.findings == []
    assert report.notes == ["of FMI 3.0: the file was checked, the library was not driven"]
    assert set(report.checked) == {name for name, rule in STATIC.items() if rule.section3}


def test_functions_of_all_interfaces_are_known() -> None:
    exchange, stepping, scheduled = map(functions_of_fmi3, ("ModelExchange", "CoSimulation", "ScheduledExecution"))
    assert "fmi3DoStep" in stepping and "fmi3SetTime" in exchange and "fmi3ActivateModelPartition" in scheduled
    assert "fmi3GetFloat64" in exchange & stepping & scheduled and "fmi3SetTime" not in stepping


DEFECTS: dict[str, dict[str, str]] = {
    "xml-schema": {"<Int64 ": "<Int63 "},
    "fmpy-validation": {'declaredType="Length" start="0.5"': 'declaredType="Length"'},
    "variable-name": {'name="gain"': 'name="2gain"'},
    "name-branch": {'name="gain"': 'name="position"'},
    "guid": {'instantiationToken="{8c4e810f-3df3-4a00-8276-176fa3c9f000}"': 'instantiationToken=" "'},
    "model-identifier": {'modelIdentifier="broken"': 'modelIdentifier="../broken"'},
    "state-flags": {'canGetAndSetFMUState="true"': 'canGetAndSetFMUState="false"'},
    "default-experiment": {'stepSize="0.1"': 'stepSize="INF"'},
    "log-category": {'name="logEvents"': 'name="logStatusError"'},
    "unit-name": {"</UnitDefinitions>": '<Unit name="m"/></UnitDefinitions>'},
    "type-name": {"</TypeDefinitions>": '<Int8Type name="Length2"/><Int8Type name="Length2"/></TypeDefinitions>'},
    "declared-type": {'variability="tunable" start="3"': 'variability="tunable" start="3" declaredType="Mode"'},
    "enumeration-start": {'declaredType="Mode" start="1"': 'declaredType="Mode" start="3"'},
    "enumeration-items": {'name="Slow" value="2"': 'name="Slow" value="1"'},
    "min-max": {'variability="tunable" start="3"': 'variability="tunable" start="3" min="5" max="4"'},
    "start-range": {'start="1 2 3" min="0" max="5"': 'start="1 2 3" min="0" max="2.5"'},
    "structure-index": {'valueReference="4" dependencies="1"': 'valueReference="4" dependencies="77"'},
    "structure-duplicate": {'<Output valueReference="6"/>': '<Output valueReference="6"/><Output valueReference="6"/>'},
}


@pytest.mark.parametrize("rule", DEFECTS)
def test_a_defect_of_the_description_is_found_by_its_rule_alone(make: Make, rule: str) -> None:
    report = check(make({BINARY: None}, DEFECTS[rule]))
    assert {(finding.rule, finding.section) for finding in report.findings} == {(rule, RULES[rule].section3)}


FILES: dict[str, Callable[[bytes], dict[str, bytes | None]]] = {
    "platform-folder": lambda library: {BINARY: None, "binaries/linux64/broken.so": library},
    "binary-missing": lambda library: {BINARY: None, BINARY.replace("broken", "other"): library},
    "binary-format": lambda library: {BINARY: b"\x7fELF but no more"},
    "exports": lambda library: {BINARY: library.replace(b"fmi3DoStep\0", b"fmi3DoStop\0")},
    "source-files": lambda library: {"sources/broken.c": None},
    "xml-schema": lambda library: {"sources/buildDescription.xml": b"<fmiBuildDescription/>"},
    "implementation": lambda library: dict.fromkeys((BINARY, "sources/broken.c", "sources/buildDescription.xml")),
}


@pytest.mark.parametrize("rule", FILES)
def test_a_defect_of_the_files_is_found_by_its_rule_alone(make: Make, contents: Contents, rule: str) -> None:
    assert found(make(FILES[rule](contents[BINARY]))) == {rule}
