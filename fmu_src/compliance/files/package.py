"""The FMU as a file: what can be checked at all, and the rules of the archive itself."""

from __future__ import annotations

import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from lxml import etree

from fmu_src.compliance.finding import Finding
from fmu_src.compliance.rules import finding

_METHODS = (zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED)


class NotAnFmu(ValueError):
    """The file cannot be checked; the message names it and says why."""


@dataclass(frozen=True)
class Package:
    """An FMU 2.0: its file, the names in it, the document modelDescription.xml."""

    path: Path
    names: tuple[str, ...]
    root: etree._Element

    def read(self, name: str) -> bytes:
        with zipfile.ZipFile(self.path) as archive:
            return archive.read(name)


def open_package(path: Path) -> Package:
    """The FMU at `path`.

    Raises:
        NotAnFmu: no such file, a folder, no zip file, no readable modelDescription.xml, another FMI version than 2.0.
    """
    if path.is_dir():
        raise NotAnFmu(f"{path}: is a folder: an FMU is checked as it is handed on, as one file")
    if not path.is_file():
        raise NotAnFmu(f"{path}: there is no such file")
    try:
        with zipfile.ZipFile(path) as archive:
            names = tuple(archive.namelist())
            root = etree.fromstring(archive.read("modelDescription.xml"))
    except OSError as error:
        raise NotAnFmu(f"{path}: cannot be read: {error.strerror or error}") from None
    except (zipfile.BadZipFile, zlib.error, RuntimeError) as error:  # the last: encrypted, or an unknown method
        raise NotAnFmu(f"{path}: not an FMU: no sound zip file ({error})") from None
    except KeyError:
        raise NotAnFmu(f"{path}: not an FMU: there is no modelDescription.xml in it") from None
    except etree.XMLSyntaxError as error:
        raise NotAnFmu(f"{path}: modelDescription.xml, line {error.lineno}: {error.msg}") from None
    version = root.get("fmiVersion")
    if root.tag != "fmiModelDescription" or version != "2.0":
        raise NotAnFmu(f"{path}: is of FMI version {version or 'unknown'}; FMI 2.0 is checked here")
    return Package(path, names, root)


def check_archive(package: Package) -> Iterator[Finding]:
    """The rules zip-sound, zip-method and zip-path."""
    with zipfile.ZipFile(package.path) as archive:
        for entry in archive.infolist():
            if entry.compress_type not in _METHODS:
                yield finding("zip-method", entry.filename, "deflate (or stored)", f"method {entry.compress_type}")
            elif not _is_intact(archive, entry):
                yield finding("zip-sound", entry.filename, "an intact file", "a damaged one")
            written = entry.orig_filename
            parts = PurePosixPath(written).parts
            if "\\" in written or written.startswith(("/", "./")) or ".." in parts or ":" in written.split("/")[0]:
                yield finding("zip-path", written, "a relative path with forward slashes", f"'{written}'")
    for name, count in Counter(package.names).items():
        if count > 1:
            yield finding("zip-path", name, "each path once", f"it {count} times")


def _is_intact(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> bool:
    try:
        with archive.open(entry) as file:
            while file.read(1 << 20):
                pass
    except (zipfile.BadZipFile, zlib.error):
        return False
    return True
