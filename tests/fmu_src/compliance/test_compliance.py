"""The compliance check finds what is wrong: each of its rules has an FMU with one defect, which only this rule reports."""

from __future__ import annotations

import hashlib
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from junitparser import JUnitXml

from fmu_src.compliance.check import check
from fmu_src.compliance.files.binaries import FOLDERS
from fmu_src.compliance.files.package import NotAnFmu, open_package
from fmu_src.compliance.library import process
from fmu_src.compliance.library.ls_ref import FOLDER, MANIFEST
from fmu_src.compliance.rules import DYNAMIC, RULES, STATIC
from fmu_src.native import compiler as native
from fmu_src.native.sources import FMI_HEADERS, fixed_sources
from fmu_src.platforms import resolve
from tools import ROOT

HERE = Path(__file__).parent
HOST = resolve(["host"])[0]
SUFFIX = FOLDERS[HOST][0]
BINARY = f"binaries/{HOST}/broken{SUFFIX}"
Contents = dict[str, bytes]
Make = Callable[..., Path]


def compiled(folder: Path, platform: str = HOST, source: str | None = None) -> bytes:
    """The library of broken.c, or of `source`."""
    folder.mkdir(exist_ok=True)
    (folder / "broken.c").write_text(source or (HERE / "broken" / "broken.c").read_text())
    for name in FMI_HEADERS:
        (folder / name).write_bytes(fixed_sources()[name])
    return native.compile_library("broken", folder, platform)


@pytest.fixture(scope="session")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Contents:
    """The contents of an FMU without fault, small, with every kind of variable and every capability."""
    return {
        "modelDescription.xml": (HERE / "broken" / "modelDescription.xml").read_bytes(),
        "sources/broken.c": (HERE / "broken" / "broken.c").read_bytes(),
        BINARY: compiled(tmp_path_factory.mktemp("sound")),
    }


@pytest.fixture
def make(sound: Contents, tmp_path: Path) -> Make:
    """Writes the sound FMU with changes: files (None: removed), edits of modelDescription.xml, the name of a defect."""

    def write(
        files: Mapping[str, bytes | None] | None = None, edits: Mapping[str, str] | None = None, defect: str = "none"
    ) -> Path:
        contents = {name: content for name, content in {**sound, **(files or {})}.items() if content is not None}
        document = contents["modelDescription.xml"].decode()
        for old, new in (edits or {}).items():
            assert old in document, old
            document = document.replace(old, new)
        contents["modelDescription.xml"] = document.encode()
        if BINARY in contents:
            mark = f"DEFECT:{defect}".encode()
            contents[BINARY] = re.sub(rb"DEFECT:none\.*", lambda old: mark.ljust(len(old[0]), b"\0"), contents[BINARY])
        path = tmp_path / "broken.fmu"
        with zipfile.ZipFile(path, "w") as archive:
            for name, content in contents.items():
                archive.writestr(name, content)
        return path

    return write


def found(path: Path) -> set[str]:
    """The rules that have findings."""
    return {finding.rule for finding in check(path).findings}


def test_the_fmu_that_is_broken_here_is_sound_before(make: Make) -> None:
    report = check(make())
    assert report.findings == [] and report.notes == []
    assert set(RULES) - set(report.checked) == {"ls-ref-manifest", "ls-ref-checksum", "ls-ref-replay"}


X = '<ScalarVariable name="x" valueReference="3" causality="output"'
ALIAS = '<ScalarVariable name="other" valueReference="{}" {}><Real {}/></ScalarVariable>\n  </ModelVariables>'
DEFECTS_OF_THE_DESCRIPTION: dict[str, dict[str, str]] = {
    "xml-schema": {"<Integer/>": "<Integer size='3'/>"},
    "fmpy-validation": {'name="limit"': 'name="2limit"'},
    "guid": {'guid="{8c4e810f-3df3-4a00-8276-176fa3c9f000}"': 'guid=""'},
    "model-identifier": {'modelIdentifier="broken"': 'modelIdentifier="bro-ken"'},
    "state-flags": {'canGetAndSetFMUstate="true"': 'canGetAndSetFMUstate="false"'},
    "default-experiment": {'stopTime="1"': 'stopTime="-1"'},
    "log-category": {'<Category name="logEvents"/>': '<Category name="logEvents"/><Category name="logEvents"/>'},
    "unit-name": {'<Unit name="mm">': '<Unit name="m"/><Unit name="mm">'},
    "type-name": {
        '<SimpleType name="Length">': '<SimpleType name="gain"><Real/></SimpleType><SimpleType name="Length">'
    },
    "declared-type": {'declaredType="Length"': 'declaredType="Mode"'},
    "enumeration-items": {'name="Slow" value="2"': 'name="Slow" value="1"'},
    "enumeration-start": {'declaredType="Mode" start="1"': 'declaredType="Mode" start="3"'},
    "min-max": {'<Real start="3"/>': '<Real start="3" min="5" max="4"/>'},
    "start-range": {'min="-10" max="10"': 'min="-10" max="0.4"'},
    "alias-settable": {
        "</ModelVariables>": ALIAS.format(1, 'causality="parameter" variability="tunable"', 'start="3"')
    },
    "alias-constant": {"</ModelVariables>": ALIAS.format(4, 'variability="constant"', 'start="99"')},
    "alias-unit": {"</ModelVariables>": ALIAS.format(3, "", 'unit="mm"')},
    "independent": {
        "</ModelVariables>": "".join(
            f'<ScalarVariable name="{name}" valueReference="3" causality="independent" variability="continuous">'
            '<Real unit="m"/></ScalarVariable>'
            for name in ("time", "clock")
        )
        + "</ModelVariables>"
    },
    "structure-index": {'index="4" dependencies="1"': 'index="4" dependencies="1 77"'},
    "structure-duplicate": {'<Unknown index="6"/></Outputs>': '<Unknown index="6"/><Unknown index="6"/></Outputs>'},
    "dependency-known": {'index="4" dependencies="1"': 'index="4" dependencies="1 6"'},
}


@pytest.mark.parametrize("rule", DEFECTS_OF_THE_DESCRIPTION)
def test_a_defect_of_the_description_is_found_by_its_rule_alone(make: Make, rule: str) -> None:
    # Without a binary: what the library then does differently is another rule's subject.
    path = make({BINARY: None}, DEFECTS_OF_THE_DESCRIPTION[rule])
    assert found(path) == {rule}


def elf_of(machine: int, library: bytes) -> bytes:
    """The library with another machine in its header."""
    return library[:18] + machine.to_bytes(2, "little") + library[20:]


DEFECTS_OF_THE_FILES: dict[str, Callable[[bytes], dict[str, bytes | None]]] = {
    "zip-path": lambda library: {"resources\\table.txt": b"", "./model.png": b"", "../escaped.txt": b""},
    "implementation": lambda library: {BINARY: None, "sources/broken.c": None},
    "platform-folder": lambda library: {"binaries/x86_64-linux/broken.so": library},
    "binary-missing": lambda library: {BINARY: None, f"binaries/{HOST}/other{SUFFIX}": library},
    "binary-format": lambda library: {BINARY: elf_of(40, library)},
    "exports": lambda library: {BINARY: library.replace(b"fmi2CancelStep\0", b"fmi2CancelStop\0")},
    "source-files": lambda library: {"sources/broken.c": None, "sources/Broken.c": b""},
}


@pytest.mark.parametrize("rule", DEFECTS_OF_THE_FILES)
def test_a_defect_of_the_files_is_found_by_its_rule_alone(make: Make, sound: Contents, rule: str) -> None:
    files = DEFECTS_OF_THE_FILES[rule](sound[BINARY])
    edits = {'<SourceFiles><File name="broken.c"/></SourceFiles>': ""} if rule == "implementation" else {}
    assert found(make(files, edits)) == {rule}


@pytest.mark.parametrize("content", [b"", b"no library", b"\x7fELF but no more"])
def test_a_file_that_is_no_library_at_all_is_found(make: Make, content: bytes) -> None:
    assert found(make({BINARY: content})) == {"binary-format"}


def test_a_damaged_file_in_the_archive_is_found(make: Make) -> None:
    path = make()
    content = path.read_bytes()
    middle = content.index(b"A small co-simulation FMU")
    path.write_bytes(content[:middle] + b"?" + content[middle + 1 :])
    assert [str(finding) for finding in check(path).findings] == [
        "zip-sound [2.3] sources/broken.c: expected an intact file; found a damaged one"
    ]


def test_another_compression_than_deflate_is_found(make: Make) -> None:
    path = make()
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("resources/table.txt", "1", compress_type=zipfile.ZIP_BZIP2)
    assert found(path) == {"zip-method"}


DEFECTS_OF_THE_LIBRARY = {rule: rule for rule in DYNAMIC if rule not in ("load", "ls-ref-replay")} | {
    "call-order-crash": "call-order",
    "hang": "nan-input",
    "log-messages-name": "log-messages",
}


@pytest.mark.parametrize("defect", DEFECTS_OF_THE_LIBRARY)
def test_a_defect_of_the_library_is_found_by_its_rule_alone(
    make: Make, defect: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "TIMEOUT", 3.0)
    assert found(make(defect=defect)) == {DEFECTS_OF_THE_LIBRARY[defect]}


@pytest.mark.parametrize(
    ("defect", "words"),
    [
        (
            "call-order-crash",
            "fmi2Terminate when instantiated: expected fmi2Error; found a crash (SIGABRT) in fmi2Terminate",
        ),
        ("hang", "no answer from fmi2DoStep within 1 s"),
        ("start-value", "start-value [2.2.7] gain: expected 3.0 as start value; found 2.5"),
        ("legal-call", "legal-call [4.2.4] fmi2EnterInitializationMode: expected fmi2OK; found fmi2Error"),
    ],
)
def test_a_finding_says_where_what_was_expected_and_what_came(
    make: Make, defect: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "TIMEOUT", 1.0)
    assert any(words in str(finding) for finding in check(make(defect=defect)).findings)


def test_an_fmu_that_differs_from_run_to_run_is_not_compared(make: Make) -> None:
    report = check(make(defect="noise"))
    assert "reset" not in report.checked
    assert report.findings == [] and "two runs in fresh processes differ" in report.notes[0]


def test_a_library_that_does_not_load_is_found(make: Make, sound: Contents) -> None:
    # It needs a C library of the future.
    library = sound[BINARY].replace(b"GLIBC_2.2.5\0", b"GLIBC_9.2.5\0")
    assert library != sound[BINARY]
    assert found(make({BINARY: library})) == {"load"}


def test_undefined_symbols_are_found(
    make: Make, sound: Contents, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = (
        sound["sources/broken.c"]
        .decode()
        .replace(
            "    self->logging = logging;", "    extern void elsewhere(void); elsewhere(); self->logging = logging;"
        )
    )
    monkeypatch.setattr(native, "LINK", (*native.LINK, "-Wl,-z,undefs"))
    library = compiled(tmp_path / "code", source=source)
    report = check(make({BINARY: library}))
    assert [(finding.rule, finding.found) for finding in report.findings] == [("undefined-symbols", "elsewhere")]


def test_needed_libraries_that_no_machine_need_have_are_found(
    make: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The run-time library of GCC: most machines have it, so the FMU loads here and nothing else is wrong with it.
    folder = tmp_path / "code"
    name, link = "libgcc_s.so.1", native.LINK
    monkeypatch.setattr(native, "LINK", (*link, f"-Wl,-soname,{name}"))
    stub = compiled(folder, source="int nothing(void); int nothing(void) { return 0; }")
    (folder / name).write_bytes(stub)
    monkeypatch.setattr(native, "LINK", (*link, "-Wl,--no-as-needed", name))
    report = check(make({BINARY: compiled(folder)}))
    assert [(finding.rule, finding.found) for finding in report.findings] == [("needed-libraries", name)]
    assert report.notes == []


@pytest.mark.long
@pytest.mark.parametrize("platform", ["win64", "darwin64", "aarch64-linux", "aarch64-darwin"])
def test_libraries_of_other_platforms_are_read_too(make: Make, sound: Contents, tmp_path: Path, platform: str) -> None:
    suffix, name = FOLDERS[platform][0], f"binaries/{platform}/broken{FOLDERS[platform][0]}"
    library = compiled(tmp_path / "code", platform)
    assert found(make({BINARY: None, name: library})) == set()
    other = next(folder for folder, (ending, _) in FOLDERS.items() if ending == suffix and folder != platform)
    assert found(make({BINARY: None, f"binaries/{other}/broken{suffix}": library})) == {"binary-format"}
    hidden = compiled(
        tmp_path / "code", platform, sound["sources/broken.c"].decode().replace("fmi2CancelStep", "cancel")
    )
    assert found(make({BINARY: None, name: hidden})) == {"exports"}


def ls_ref(reference: str, changes: Mapping[str, str] | None = None, step: str = "0.1") -> dict[str, bytes | None]:
    """Files of the layered standard: one experiment, whose reference results are the rows of `reference`."""
    experiment = (
        '<Experiments name="smoke"><Experiment name="ramp" tolerance="1e-6"><TransientSimulation startTime="0" stopTime="0.2" '
        f'stepSize="{step}"/><Stimuli source="in.csv"/><References source="out.csv"/></Experiment></Experiments>'
    )
    files = {"smoke.exp": experiment, "in.csv": "time,u\n0,0\n0.2,1\n", "out.csv": reference}
    roles = {"smoke.exp": "experiment/smoke-test", "in.csv": "other", "out.csv": "result"}
    types = {"smoke.exp": "application/x-ma-hs-experiments", "in.csv": "text/csv", "out.csv": "text/csv"}
    related = "".join(
        f'<Related source="{name}" role="{roles[name]}" type="{types[name]}" '
        f'checksum="{hashlib.sha3_256(text.encode()).hexdigest()}"/>'
        for name, text in files.items()
    )
    manifest = (
        '<fmiReferences xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest" fmi-ls:fmi-ls-name='
        f'"org.fmi-standard.fmi-ls-ref" fmi-ls:fmi-ls-version="1.0.0-alpha.1" fmi-ls:fmi-ls-description="">{related}'
        "</fmiReferences>"
    )
    for old, new in (changes or {}).items():
        assert old in manifest
        manifest = manifest.replace(old, new)
    return {MANIFEST: manifest.encode()} | {f"{FOLDER}/{name}": text.encode() for name, text in files.items()}


# By hand: x(0) = 1, x(0.1) = 1 + 0.1 (3 * 0 - 1), x(0.2) = 0.9 + 0.1 (3 * 0.5 - 0.9).
RIGHT = "time,x\n0,1\n0.1,0.9\n0.2,0.96\n"


def test_reference_results_are_replayed(make: Make) -> None:
    report = check(make(ls_ref(RIGHT)))
    assert report.findings == []
    assert set(report.checked) == set(RULES)


DEFECTS_OF_THE_REFERENCES: dict[str, tuple[str, dict[str, str]]] = {
    "ls-ref-replay": (RIGHT.replace("0.96", "0.97"), {}),
    "ls-ref-checksum": (RIGHT, {hashlib.sha3_256(RIGHT.encode()).hexdigest(): "00"}),
    "ls-ref-manifest": (RIGHT, {'role="other"': 'role="stimulus"'}),
}


@pytest.mark.parametrize("rule", DEFECTS_OF_THE_REFERENCES)
def test_a_defect_of_the_references_is_found_by_its_rule_alone(make: Make, rule: str) -> None:
    assert found(make(ls_ref(*DEFECTS_OF_THE_REFERENCES[rule]))) == {rule}


def test_files_that_are_not_there_and_experiments_that_cannot_be_run_are_found(make: Make) -> None:
    assert found(make({**ls_ref(RIGHT), f"{FOLDER}/in.csv": None})) == {"ls-ref-manifest"}
    assert found(make(ls_ref("time,x\n0,one\n"))) == {"ls-ref-manifest"}
    assert found(make(ls_ref(RIGHT, step="0"))) == {"ls-ref-manifest"}


def test_every_rule_has_an_fmu_that_only_it_catches() -> None:
    covered = {"zip-sound", "zip-method", "load", "undefined-symbols", "needed-libraries"}
    covered |= set(DEFECTS_OF_THE_DESCRIPTION) | set(DEFECTS_OF_THE_FILES) | set(DEFECTS_OF_THE_REFERENCES)
    assert covered | set(DEFECTS_OF_THE_LIBRARY.values()) == set(RULES) == set(STATIC) | set(DYNAMIC)


def test_model_exchange_alone_gets_the_static_checks_and_a_note(make: Make, sound: Contents) -> None:
    document = sound["modelDescription.xml"].decode()
    start, end = document.index("<CoSimulation"), document.index("</CoSimulation>") + len("</CoSimulation>")
    report = check(make({BINARY: None}, {document[start:end]: '<ModelExchange modelIdentifier="broken"/>'}))
    assert report.findings == [] and report.notes == ["no co-simulation: the FMU was not driven"]


def test_an_fmu_that_also_offers_model_exchange_must_export_its_functions(make: Make) -> None:
    report = check(make(edits={"<CoSimulation ": '<ModelExchange modelIdentifier="broken"/><CoSimulation '}))
    assert [finding.rule for finding in report.findings] == ["exports"]
    assert "fmi2SetTime" in report.findings[0].found and "fmi2DoStep" not in report.findings[0].found


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
        archive.writestr("modelDescription.xml", '<fmiModelDescription fmiVersion="3.0"/>')


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (lambda path: None, "there is no such file"),
        (lambda path: path.mkdir(), "is a folder"),
        (lambda path: path.write_text("no zip"), "not an FMU: no sound zip file"),
        (lambda path: zipfile.ZipFile(path, "w").close(), "there is no modelDescription.xml in it"),
        (other_version, "is of FMI version 3.0; FMI 2.0 is checked here"),
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


def test_the_documentation_has_the_rules_as_they_are() -> None:
    rows = re.findall(
        r"^\| `([\w-]+)` \| ([^|]+) \| ([^|]+) \|", (ROOT / "docs" / "compliance.md").read_text(), flags=re.M
    )
    assert {name: (section.strip(), demand.strip()) for name, section, demand in rows} == {
        name: (rule.section, rule.demand) for name, rule in RULES.items()
    }
