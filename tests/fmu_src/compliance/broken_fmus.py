"""FMUs to be checked: small ones without fault, into which a test brings one."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from lxml import etree

from fmu_src.compliance.check import check
from fmu_src.compliance.files.binaries import FOLDERS
from fmu_src.compliance.files.description import read
from fmu_src.compliance.files.package import open_package, unpack
from fmu_src.compliance.finding import Finding
from fmu_src.compliance.library.calls import Subject
from fmu_src.compliance.library.fmu import Fmu
from fmu_src.native import compiler as native
from fmu_src.native.sources import FMI_HEADERS, fixed_sources
from fmu_src.platforms import resolve

BROKEN = Path(__file__).parent / "broken"
HOST = resolve(["host"])[0]
SUFFIX = FOLDERS[HOST][0]
BINARY = f"binaries/{HOST}/broken{SUFFIX}"
Contents = dict[str, bytes]
Make = Callable[..., Path]
EXCHANGE = {"continuous-states", "state-derivatives", "event-mode"}  # rules of model exchange alone


def compiled(folder: Path, platform: str = HOST, source: str | None = None) -> bytes:
    """The library of broken.c, or of `source`."""
    folder.mkdir(exist_ok=True)
    (folder / "broken.c").write_text(source or (BROKEN / "broken.c").read_text())
    for name in FMI_HEADERS:
        (folder / name).write_bytes(fixed_sources()[name])
    return native.compile_library("broken", folder, platform)


def contents(folder: Path, description: str, source: str) -> Contents:
    """The files of an FMU without fault, by path in it."""
    return {
        "modelDescription.xml": (BROKEN / description).read_bytes(),
        f"sources/{source}": (BROKEN / source).read_bytes(),
        BINARY: compiled(folder, source=(BROKEN / source).read_text()),
    }


def maker(sound: Contents, path: Path) -> Make:
    """Writes the FMU `sound` to `path` with changes: files (None: removed), edits of modelDescription.xml, the name of a defect."""

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
        with zipfile.ZipFile(path, "w") as archive:
            for name, content in contents.items():
                archive.writestr(name, content)
        return path

    return write


def found(path: Path) -> set[str]:
    """The rules that have findings."""
    return {finding.rule for finding in check(path).findings}


def edited(name: str, edits: Mapping[str, str]) -> etree._Element:
    """The document `name` of the folder `broken` with other text in it."""
    document = (BROKEN / name).read_text()
    for old, new in edits.items():
        assert old in document, old
        document = document.replace(old, new)
    return etree.fromstring(document.encode())


def told(findings: Iterable[Finding]) -> list[tuple[str, str, str]]:
    """Rule, subject and what was found."""
    return [(finding.rule, finding.subject, finding.found) for finding in findings]


def loaded(path: Path, folder: Path, interface: str = "CoSimulation", **changes: Any) -> Fmu:
    """The FMU unpacked in `folder` and loaded in this process, for probes that leave it alive; `changes` of how it is driven."""
    unpack(open_package(path), folder / "fmu")
    description = read(etree.parse(str(folder / "fmu" / "modelDescription.xml")).getroot())
    subject = Subject(
        description,
        interface,
        str(folder / "fmu" / BINARY),
        (folder / "fmu" / "resources").as_uri(),
        0.0,
        1.0,
        float(description.experiment["stepSize"]),
        tuple(v for v in description.variables if v.causality in ("output", "local") and v.variability != "constant"),
        folder,
    )
    return Fmu(replace(subject, **changes), lambda call: None, None, 0.05)
