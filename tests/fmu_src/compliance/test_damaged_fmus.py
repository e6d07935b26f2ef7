"""Whatever the bytes of an FMU: a report or one line; never another exception, never a file left, at most 1 GB of memory."""

from __future__ import annotations

import io
import re
import resource
import tempfile
import zipfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from broken_fmus import BINARY, Contents
from fmu_src.compliance.check import check
from fmu_src.compliance.finding import CannotCheck, Report
from tools import examples

MOST_MEMORY = 1 << 30
VALUES = [
    "",
    " ",
    "-1",
    "0",
    "77",
    "1e999",
    "INF",
    "NaN",
    "9" * 400,
    "true",
    "../../x",
    "a&#10;b",
    "&#8238;",
    "'",
    "x.y",
    "u",
]
QUICK = settings(deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))


def zipped(contents: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, content in contents.items():
            archive.writestr(zipfile.ZipInfo(name), content, method)
    return file.getvalue()


def survives(content: bytes, folder: Path) -> Report | None:
    """The report; None where the file cannot be checked. Both are lines that can be printed."""
    path = folder / "damaged.fmu"
    path.write_bytes(content)
    before, peaks = {file for file in folder.rglob("*")}, memory_peaks()
    try:
        report = check(path)
        lines = [*map(str, report.findings), *report.notes]
    except CannotCheck as error:
        report, lines = None, [str(error)]
    assert all(line.isprintable() and len(line) < 2000 for line in lines), lines
    assert {file for file in folder.rglob("*")} == before
    # What this process and others that it started, such as a compiler, took before is not the check's.
    assert all(now < MOST_MEMORY or now == peak for now, peak in zip(memory_peaks(), peaks, strict=True))
    return report


def memory_peaks() -> list[int]:
    """Of this process and of its children that have ended, the largest, so far [B]."""
    return [resource.getrusage(who).ru_maxrss * 1024 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the check works: its temporary files are seen there."""
    return tmp_path_factory.mktemp("damaged")


@pytest.fixture(autouse=True)
def work_there(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "temporary").mkdir(exist_ok=True)
    monkeypatch.setattr(tempfile, "tempdir", str(folder / "temporary"))
    monkeypatch.chdir(folder)


@st.composite
def damage(draw: st.DrawFn, size: int) -> list[tuple[int, int, bytes]]:
    """Up to four places, what is cut out there and what is put in."""
    places = st.tuples(st.integers(0, size - 1), st.integers(0, 8), st.binary(max_size=8))
    return draw(st.lists(places, min_size=1, max_size=4))


def damaged(content: bytes, changes: list[tuple[int, int, bytes]]) -> bytes:
    for place, cut, put in changes:
        content = content[:place] + put + content[place + cut :]
    return content


@given(data=st.data())
@settings(QUICK, max_examples=examples(50, 150))
def test_damaged_archives(sound: Contents, folder: Path, data: st.DataObject) -> None:
    whole = zipped({name: content for name, content in sound.items() if name != BINARY})
    content = damaged(whole, data.draw(damage(len(whole))))
    survives(content[: data.draw(st.integers(0, len(content)) | st.just(len(content)))], folder)


@given(data=st.data())
@settings(QUICK, max_examples=examples(50, 200))
def test_descriptions_with_other_values(
    sound: Contents, sound_exchange: Contents, folder: Path, data: st.DataObject
) -> None:
    document = data.draw(st.sampled_from([sound, sound_exchange]))["modelDescription.xml"].decode()
    for _ in range(data.draw(st.integers(1, 3))):
        attribute = data.draw(st.sampled_from(list(re.finditer(r'(?<==")[^"]*(?=")', document))))
        document = document[: attribute.start()] + data.draw(st.sampled_from(VALUES)) + document[attribute.end() :]
    survives(zipped({"modelDescription.xml": document.encode(), "sources/broken.c": b""}), folder)


@pytest.mark.long
@given(data=st.data())
@settings(QUICK, max_examples=40)
def test_descriptions_that_do_not_fit_the_library_that_is_driven(
    sound: Contents, sound_exchange: Contents, folder: Path, data: st.DataObject
) -> None:
    contents = data.draw(st.sampled_from([sound, sound_exchange]))
    document = contents["modelDescription.xml"].decode()
    elements = list(re.finditer(r"<ScalarVariable.*?</ScalarVariable>|<Unknown[^>]*/>", document))
    element = data.draw(st.sampled_from(elements))
    instead = data.draw(st.sampled_from(["", element[0] * 2, data.draw(st.sampled_from(elements))[0]]))
    document = document[: element.start()] + instead + document[element.end() :]
    survives(zipped({**contents, "modelDescription.xml": document.encode()}, zipfile.ZIP_STORED), folder)


@given(data=st.data())
@settings(QUICK, max_examples=100)
def test_damaged_descriptions(sound: Contents, folder: Path, data: st.DataObject) -> None:
    document = sound["modelDescription.xml"]
    survives(zipped({"modelDescription.xml": damaged(document, data.draw(damage(len(document))))}), folder)


@pytest.mark.long
@given(data=st.data())
@settings(QUICK, max_examples=40)
def test_damaged_libraries(sound: Contents, folder: Path, data: st.DataObject) -> None:
    library = sound[BINARY]
    header = st.tuples(st.integers(0, 2000), st.integers(0, 8), st.binary(min_size=1, max_size=8))
    changes = data.draw(st.lists(header, min_size=1, max_size=3)) + data.draw(damage(len(library)))
    survives(zipped({**sound, BINARY: damaged(library, changes)}, zipfile.ZIP_STORED), folder)


@pytest.mark.parametrize("suffix", [".so", ".dll", ".dylib"])
@given(content=st.binary(max_size=400))
@settings(QUICK, max_examples=examples(10, 20))
def test_bytes_that_begin_like_a_library(folder: Path, suffix: str, content: bytes) -> None:
    from fmu_src.compliance.files.libraries import read_library

    begin = {
        ".so": b"\x7fELF\x02\x01\x01",
        ".dll": b"MZ" + bytes(58) + b"\x40\0\0\0PE\0\0",
        ".dylib": b"\xcf\xfa\xed\xfe",
    }
    path = folder / f"library{suffix}"
    path.write_bytes(begin[suffix] + content)
    try:
        read_library(path)
    except ValueError as error:
        assert str(error)
    path.unlink()


def test_an_xml_document_that_grows_by_its_entities_is_one_line(folder: Path) -> None:
    entities = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 12))
    document = (
        f'<!DOCTYPE f [<!ENTITY e0 "x">{entities}]><fmiModelDescription fmiVersion="2.0">&e11;</fmiModelDescription>'
    )
    assert survives(zipped({"modelDescription.xml": document.encode()}), folder) is None
