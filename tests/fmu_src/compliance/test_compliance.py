"""The compliance check finds what is wrong: each of its rules has an FMU with one defect, which only this rule reports."""

from __future__ import annotations

import re
import stat
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from broken_fmus import BINARY, EXCHANGE, HOST, SUFFIX, Contents, Make, compiled, edited, found, told
from fmu_src.compliance.check import _subject, check
from fmu_src.compliance.files.binaries import FOLDERS
from fmu_src.compliance.files.description import read
from fmu_src.compliance.library import process
from fmu_src.compliance.rules import DYNAMIC, RULES, STATIC
from fmu_src.native import compiler as native
from test_ls_ref import DEFECTS_OF_THE_REFERENCES
from test_model_exchange import DEFECTS_OF_MODEL_EXCHANGE
from tools import ROOT


def test_the_fmu_that_is_broken_here_is_sound_before(make: Make) -> None:
    report = check(make())
    assert report.findings == [] and report.notes == []
    assert set(RULES) - set(report.checked) == {"ls-ref-manifest", "ls-ref-checksum", "ls-ref-replay"} | EXCHANGE


X = '<ScalarVariable name="x" valueReference="3" causality="output"'
ALIAS = '<ScalarVariable name="other" valueReference="{}" {}><Real {}/></ScalarVariable>\n  </ModelVariables>'
DEFECTS_OF_THE_DESCRIPTION: dict[str, dict[str, str]] = {
    "xml-schema": {"<Integer/>": "<Integer size='3'/>"},
    "fmpy-validation": {'unit="m"/></ScalarVariable>': 'unit="km"/></ScalarVariable>'},
    "variable-name": {'name="limit"': 'name="2limit"'},
    "name-branch": {'name="limit"': 'name="gain.limit"'},
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
    "structure-index": {'index="4" dependencies=""': 'index="4" dependencies="77"'},
    "structure-duplicate": {'<Unknown index="6"/></Outputs>': '<Unknown index="6"/><Unknown index="6"/></Outputs>'},
    "dependency-known": {'index="4" dependencies=""': 'index="4" dependencies="6"'},
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


@pytest.mark.long
def test_an_fmu_of_20000_variables_is_driven_without_a_finding(make: Make) -> None:
    more = "".join(
        f'<ScalarVariable name="block{i // 100}.part[{i % 100},{i}].length" valueReference="3" causality="local" '
        'variability="continuous"><Real unit="m"/></ScalarVariable>'
        for i in range(20_000)
    )
    report = check(make(edits={"  </ModelVariables>": f"{more}</ModelVariables>"}))
    assert report.findings == [] and report.notes == [] and "state-serialize" in report.checked


def test_another_compression_than_deflate_is_found(make: Make) -> None:
    path = make()
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("resources/table.txt", "1", compress_type=zipfile.ZIP_BZIP2)
    assert found(path) == {"zip-method"}


def test_a_link_in_the_archive_is_found(make: Make) -> None:
    path = make()
    link = zipfile.ZipInfo("resources/table.txt")
    link.create_system, link.external_attr = 3, (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(link, "/etc/hostname")
    assert found(path) == {"zip-link"}


DEFECTS_OF_THE_LIBRARY = {rule: rule for rule in DYNAMIC if rule not in {"load", "ls-ref-replay"} | EXCHANGE} | {
    "directional-derivative-refused": "directional-derivative",
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
            "fmi2Terminate when instantiated, fmi2Terminate when set up, fmi2Terminate when in initialization mode "
            "and 1 more: expected fmi2Error; found a crash (SIGABRT) in fmi2Terminate",
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


DEFAULT = '<DefaultExperiment startTime="0" stopTime="1" tolerance="1e-4" stepSize="0.1"/>'


@pytest.mark.parametrize(
    ("said", "start", "stop", "step"),
    [
        (DEFAULT, 0.0, 1.0, 0.1),
        ("", 0.0, None, 0.01),
        ('<DefaultExperiment stopTime="3"/>', 0.0, 3.0, 0.03),
        ('<DefaultExperiment startTime="2" stopTime="3"/>', 2.0, 3.0, 0.01),
        ('<DefaultExperiment startTime="2" stopTime="2"/>', 2.0, 2.0, 0.01),
        ('<DefaultExperiment startTime="-2" stopTime="-1.5"/>', -2.0, -1.5, 0.005),
        ('<DefaultExperiment startTime="2"/>', 2.0, None, 0.01),
        ('<DefaultExperiment startTime="2" stopTime="4" stepSize="0"/>', 2.0, 4.0, 0.02),
        ('<DefaultExperiment startTime="2" stopTime="INF" stepSize="NaN"/>', 2.0, None, 0.01),
        ('<DefaultExperiment stepSize="0.5"/>', 0.0, None, 0.5),
    ],
)
def test_what_is_driven_is_the_default_experiment_in_steps_of_a_hundredth_where_it_says_none(
    tmp_path: Path, said: str, start: float, stop: float | None, step: float
) -> None:
    description = read(edited("modelDescription.xml", {DEFAULT: said}))
    subject = _subject(tmp_path / "fmu", description, "CoSimulation", BINARY)
    assert (subject.start, subject.stop) == (start, stop) and subject.step == pytest.approx(step, rel=1e-14, abs=0)
    assert [variable.name for variable in subject.watched] == ["x", "count", "y", "limit"]  # outputs, then locals
    assert (tmp_path / "working directory for CoSimulation").is_dir()


def test_at_most_a_thousand_variables_are_compared_outputs_first(tmp_path: Path) -> None:
    local = '<ScalarVariable name="l{}" valueReference="3" causality="{}"><Real unit="m"/></ScalarVariable>'
    kinds = ["local", "calculatedParameter", "output"]
    more = "".join(local.format(i, kinds[i % 3]) for i in range(1500))
    description = read(edited("modelDescription.xml", {"<ModelVariables>": f"<ModelVariables>{more}"}))
    watched = _subject(tmp_path / "fmu", description, "CoSimulation", BINARY).watched
    order = [variable.causality for variable in watched]
    assert len(order) == 1000 and order[:503] == ["output"] * 503 and order[503:] == ["local"] * 497
    assert [variable.name for variable in watched[:2]] == ["l2", "l5"]


def test_a_note_says_why_rules_were_not_applied(make: Make, sound: Contents) -> None:
    archive = ["zip-sound", "zip-method", "zip-path", "zip-link", "xml-schema"]
    report = check(make({BINARY: None}, {"<Integer/>": "<Integer size='3'/>"}))
    assert report.notes == ["modelDescription.xml is not valid, so no further rule was applied"]
    assert report.checked == archive
    report = check(make({"../a": b""}))
    assert report.notes == ["the archive is not sound, so the FMU was not unpacked"]
    layered = {"ls-ref-manifest", "ls-ref-checksum"}
    assert report.checked == [*archive, *(rule for rule in STATIC if rule not in {*archive, *layered})]
    report = check(make({BINARY: sound[BINARY].replace(b"fmi2CancelStep\0", b"fmi2CancelStop\0")}))
    assert report.notes == [f"{BINARY} is not sound: co-simulation was not driven"]
    report = check(make({BINARY: sound[BINARY].replace(b"GLIBC_2.2.5\0", b"GLIBC_9.2.5\0")}))
    assert report.notes == ["the library does not load, so no further rule was applied"]
    assert report.checked[-1] == "load"


def test_an_unsound_library_for_another_machine_keeps_none_from_being_driven(make: Make) -> None:
    heard: list[str] = []
    report = check(make({"binaries/win64/broken.dll": b"none"}), heard.append)
    assert [(found.rule, found.subject) for found in report.findings] == [
        ("binary-format", "binaries/win64/broken.dll")
    ]
    assert report.notes == [] and "state-serialize" in report.checked
    assert heard[:2] == ["static", "load"] and heard[-1] == "state-serialize" and set(heard[1:]) <= set(report.checked)


def test_after_three_hangs_no_more_are_waited_for(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "TIMEOUT", 1.0)
    report = check(make(defect="hangs-when-it-refuses"))
    assert report.notes == ["3 calls did not come back, so no further rule was applied"]
    names = ("fmi2ExitInitializationMode", "fmi2EnterInitializationMode", "fmi2DoStep")
    assert told(report.findings) == [
        ("call-order", f"{name} when instantiated", f"no answer from {name} within 1 s") for name in names
    ]


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
    library = compiled(folder)
    report = check(make({BINARY: library}))
    assert [(finding.rule, finding.found) for finding in report.findings] == [("needed-libraries", name)]
    assert report.notes == []
    declaration = {"documentation/externalDependencies.txt": b"GCC's run-time library, libgcc_s.so.1"}
    assert found(make({BINARY: library, **declaration})) == set()
    assert found(make({BINARY: library, "documentation/externalDependencies.txt": b"none"})) == {"needed-libraries"}


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


def test_every_rule_has_an_fmu_that_only_it_catches() -> None:
    covered = {"zip-sound", "zip-method", "zip-link", "load", "undefined-symbols", "needed-libraries"}
    covered |= set(DEFECTS_OF_THE_DESCRIPTION) | set(DEFECTS_OF_THE_FILES) | set(DEFECTS_OF_THE_REFERENCES)
    covered |= set(DEFECTS_OF_MODEL_EXCHANGE.values())
    assert covered | set(DEFECTS_OF_THE_LIBRARY.values()) == set(RULES) == set(STATIC) | set(DYNAMIC)


def test_model_exchange_alone_gets_the_static_checks_and_a_note(make: Make, sound: Contents) -> None:
    document = sound["modelDescription.xml"].decode()
    start, end = document.index("<CoSimulation"), document.index("</CoSimulation>") + len("</CoSimulation>")
    report = check(make({BINARY: None}, {document[start:end]: '<ModelExchange modelIdentifier="broken"/>'}))
    assert report.findings == [] and report.notes == [
        f"no binary for this machine ({BINARY}): model exchange was not driven"
    ]


def test_an_fmu_that_also_offers_model_exchange_must_export_its_functions(make: Make) -> None:
    report = check(make(edits={"<CoSimulation ": '<ModelExchange modelIdentifier="broken"/><CoSimulation '}))
    assert [finding.rule for finding in report.findings] == ["exports"]
    assert "fmi2SetTime" in report.findings[0].found and "fmi2DoStep" not in report.findings[0].found


def test_the_documentation_has_the_rules_as_they_are() -> None:
    rows = re.findall(
        r"^\| `([\w-]+)` \| ([^|]+) \| ([^|]+) \|(?: (?P<three>[\d.]*) \|)?$",
        (ROOT / "docs" / "compliance.md").read_text(),
        flags=re.M,
    )
    assert {name: (section.strip(), demand.strip(), three) for name, section, demand, three in rows} == {
        name: (rule.section, rule.demand, rule.section3) for name, rule in RULES.items()
    }
