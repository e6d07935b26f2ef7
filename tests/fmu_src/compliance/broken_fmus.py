"""FMUs to be checked: small ones without fault, into which a test brings one."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

from fmu_src.compliance.check import check
from fmu_src.compliance.files.binaries import FOLDERS
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
