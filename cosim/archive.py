"""Zip files from anywhere (FMUs, systems): opened, read and unpacked, or refused in one line; nothing is inflated beyond a limit."""

from __future__ import annotations

import lzma
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from lxml import etree

from cosim.errors import SystemFileError, not_a_file

LARGEST = 4 * 2**30  # bytes of all members of a file, inflated
LARGEST_XML = 2**27  # bytes; a description of 100,000 variables takes 50 MB
MOST_MARKS = (
    3_000_000  # tags and attributes of an XML file: each takes up to 220 bytes of memory, and a few of the file's
)

# What zipfile raises at damaged files, besides BadZipFile: by compression, encryption, names, and numbers that lie.
_DAMAGES = (
    zipfile.BadZipFile,
    zipfile.LargeZipFile,
    zlib.error,
    lzma.LZMAError,
    struct.error,
    EOFError,
    NotImplementedError,
    RuntimeError,
    ValueError,
    IndexError,
    OverflowError,
)


@contextmanager
def opened(path: Path, kind: str) -> Iterator[zipfile.ZipFile]:
    """The zip file at `path`, `kind` being what it should be, such as "an FMU"; errors of the block are explained too.

    Raises:
        SystemFileError: no such file, damaged, cannot be read or written, or larger than LARGEST when inflated.
    """
    try:
        if not path.is_file():
            raise SystemFileError(not_a_file(path))
        try:
            archive = zipfile.ZipFile(path)
        except _DAMAGES:
            raise SystemFileError(f"{path}: not {kind} (not a sound zip file)") from None
        with archive:
            size = sum(member.file_size for member in archive.infolist())
            if size > LARGEST:
                raise SystemFileError(
                    f"{path}: {size / 2**30:.3g} GiB when inflated, more than {LARGEST / 2**30:g} GiB, the most that is unpacked"
                )
            yield archive
    except SystemFileError:
        raise
    except OSError as error:
        raise SystemFileError(f"{path}: cannot be read and unpacked: {error.strerror or error}") from None
    except _DAMAGES as error:
        raise SystemFileError(f"{path}: the file is damaged ({error or type(error).__name__})") from None


def parsed(
    archive: zipfile.ZipFile, member: str, label: str, declared: Callable[[bytes], bytes] = bytes
) -> etree._Element:
    """The root of an XML file in `archive`, which messages call `label`; `declared` may complete its text before.

    Raises:
        SystemFileError: it is missing, too large, not well-formed (with its line), or defines entities.
    """
    try:
        size = archive.getinfo(member).file_size
    except KeyError:
        raise SystemFileError(f"{label}: there is no {member} in it") from None
    return _root(size, lambda: archive.read(member), f"{label}: {member}", declared)


def parsed_file(path: Path) -> etree._Element:
    """The root of the XML file at `path`.

    Raises:
        SystemFileError: no such file, it cannot be read, or as `parsed`.
    """
    if not path.is_file():
        raise SystemFileError(not_a_file(path))
    try:
        return _root(path.stat().st_size, path.read_bytes, str(path), bytes)
    except OSError as error:
        raise SystemFileError(f"{path}: cannot be read: {error.strerror or error}") from None


def _root(size: int, read: Callable[[], bytes], where: str, declared: Callable[[bytes], bytes]) -> etree._Element:
    if size > LARGEST_XML:
        raise SystemFileError(f"{where} has {size / 2**20:.0f} MiB, more than {LARGEST_XML / 2**20:.0f} MiB")
    content = read()
    marks = content.count(b"<") + content.count(b"=")
    if marks > MOST_MARKS:
        raise SystemFileError(f"{where} has {marks} tags and attributes, more than {MOST_MARKS}")
    try:
        # No entities, no network: the file may come from anywhere.
        parser = etree.XMLParser(resolve_entities=False, no_network=True)
        root = etree.fromstring(declared(content), parser)
    except etree.XMLSyntaxError as error:
        said = str(error.msg).partition("\n")[0]  # the parser repeats the place on a line of its own
        raise SystemFileError(f"{where}, line {error.lineno}: {said}") from None
    if root.getroottree().docinfo.doctype:
        raise SystemFileError(f"{where} has a document type, which neither FMI nor SSP knows")
    return root
