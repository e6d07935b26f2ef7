"""The FMU as a file: what can be checked at all, and the rules of the archive itself."""

from __future__ import annotations

import re
import stat
import struct
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from lxml import etree

from fmu_src.compliance.finding import CannotCheck, Finding, one_line
from fmu_src.compliance.rules import finding

DESCRIPTION = "modelDescription.xml"
# What an FMU may inflate to. Its archive says so beforehand, and no more than that is ever read from it.
MOST_BYTES = 2 << 30
MOST_BYTES_OF_DESCRIPTION = 128 << 20
MOST_BYTES_OF_XML = 8 << 20  # of another document that is read here; what is in resources/ is not
MOST_FILES = 100_000
MOST_FOLDERS = 100  # one in the other
MOST_MARKS = 5_000_000  # tags and attributes of the description: each takes a hundred bytes or two of memory

_VERSIONS = re.compile(r"2\.0\Z|3\.0(\.\d+)?\Z")
_METHODS = (zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED)
# What zipfile raises at damaged archives: besides its own error those of what it stumbles over, and RuntimeError for encrypted files.
_DAMAGE = (zipfile.BadZipFile, zlib.error, struct.error, RuntimeError, EOFError, ValueError, LookupError, OverflowError)


class NotAnFmu(CannotCheck, ValueError):
    """The file cannot be checked; the message names it and says why."""


@dataclass(frozen=True)
class Package:
    """An FMU: its file, the names in it, the document modelDescription.xml, the version of FMI."""

    path: Path
    names: tuple[str, ...]
    root: etree._Element
    version: str

    def read(self, name: str) -> bytes:
        with zipfile.ZipFile(self.path) as archive:
            return archive.read(name)


def open_package(path: Path) -> Package:
    """The FMU at `path`.

    Raises:
        NotAnFmu: no such file, a folder, no zip file, no readable modelDescription.xml, larger than what is checked here,
            another FMI version than 2.0 and 3.0.
    """
    try:
        if path.is_dir():
            raise NotAnFmu(f"{path}: is a folder: an FMU is checked as it is handed on, as one file")
        if not path.is_file():
            raise NotAnFmu(f"{path}: there is no such file")
        with zipfile.ZipFile(path) as archive:
            _check_size(path, archive)
            names = tuple(archive.namelist())
            document = archive.read(DESCRIPTION)
    except OSError as error:
        raise NotAnFmu(f"{path}: cannot be read: {error.strerror or error}") from None
    except KeyError:
        raise NotAnFmu(f"{path}: not an FMU: there is no {DESCRIPTION} in it") from None
    except NotAnFmu:
        raise
    except _DAMAGE as error:
        raise NotAnFmu(f"{path}: not an FMU: no sound zip file ({error})") from None
    root = _parsed(path, document)
    version = root.get("fmiVersion") or ""
    if root.tag != "fmiModelDescription" or not _VERSIONS.match(version):
        raise NotAnFmu(f"{path}: is of FMI version {one_line(version) or 'unknown'}; FMI 2.0 and 3.0 are checked here")
    return Package(path, names, root, version[:3])


def _check_size(path: Path, archive: zipfile.ZipFile) -> None:
    """Before anything is inflated."""
    entries = archive.infolist()
    if len(entries) > MOST_FILES:
        raise NotAnFmu(f"{path}: holds {len(entries)} files; at most {MOST_FILES} are checked here")
    inflated = sum(entry.file_size for entry in entries)
    if inflated > MOST_BYTES:
        raise NotAnFmu(
            f"{path}: inflates to {inflated / 2**30:.1f} GiB; at most {MOST_BYTES >> 30} GiB are checked here"
        )
    for entry in entries:
        name, size = entry.filename, entry.file_size
        if name.count("/") > MOST_FOLDERS:
            text = f"lies {name.count('/')} folders deep; at most {MOST_FOLDERS} are unpacked here"
            raise NotAnFmu(f"{path}: {one_line(name)} {text}")
        limit = MOST_BYTES_OF_DESCRIPTION if name == DESCRIPTION else MOST_BYTES_OF_XML
        if name.endswith(".xml") and not name.startswith("resources/") and size > limit:
            text = f"inflates to {size / 2**20:.0f} MiB; at most {limit >> 20} MiB are checked here"
            raise NotAnFmu(f"{path}: {one_line(name)} {text}")


def _parsed(path: Path, document: bytes) -> etree._Element:
    marks = document.count(b"<") + document.count(b"=")
    if marks > MOST_MARKS:
        raise NotAnFmu(f"{path}: {DESCRIPTION} has {marks} tags and attributes; at most {MOST_MARKS} are checked here")
    try:
        return etree.fromstring(document)
    except etree.XMLSyntaxError as error:
        raise NotAnFmu(f"{path}: {DESCRIPTION}, line {error.lineno}: {one_line(str(error.msg))}") from None
    except (ValueError, LookupError) as error:  # an encoding that does not exist
        raise NotAnFmu(f"{path}: {DESCRIPTION} is no XML ({error})") from None


def check_archive(package: Package) -> Iterator[Finding]:
    """The rules zip-sound, zip-method, zip-path and zip-link."""
    with zipfile.ZipFile(package.path) as archive:
        for entry in archive.infolist():
            if entry.compress_type not in _METHODS:
                yield finding("zip-method", entry.filename, "deflate (or stored)", f"method {entry.compress_type}")
            elif (damage := _damage(archive, entry)) is not None:
                yield finding("zip-sound", entry.filename, "an intact file", damage)
            written = entry.orig_filename
            parts = written.split("/")
            if "\\" in written or written.startswith("/") or not {".", ".."}.isdisjoint(parts) or ":" in parts[0]:
                yield finding("zip-path", written, "a relative path with forward slashes", f"'{written}'")
            if stat.S_ISLNK(entry.external_attr >> 16):
                yield finding("zip-link", entry.filename, "a file", "a link")
    for name, count in Counter(package.names).items():
        if count > 1:
            yield finding("zip-path", name, "each path once", f"it {count} times")


def unpack(package: Package, directory: Path) -> None:
    """Into `directory`.

    Raises:
        NotAnFmu: there is no room for it, or the file system does not take a name.
    """
    with zipfile.ZipFile(package.path) as archive:
        for entry in archive.infolist():
            try:
                archive.extract(entry, directory)
            except OSError as error:
                reason = f"{entry.filename[:60]}: {error.strerror or error}"
                raise NotAnFmu(f"{package.path}: cannot be unpacked: {reason}") from None


def _damage(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> str | None:
    if entry.flag_bits & 1:
        return "an encrypted one"
    try:
        with archive.open(entry) as file:
            while file.read(1 << 20):
                pass
    except _DAMAGE:
        return "a damaged one"
    return None
