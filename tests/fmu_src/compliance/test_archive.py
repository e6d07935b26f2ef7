"""The rules of the archive: paths, links, methods, damage, each file by its name."""

from __future__ import annotations

import stat
import zipfile
from pathlib import Path

import pytest

from broken_fmus import told
from fmu_src.compliance.files.package import NotAnFmu, Package, check_archive, open_package

DOCUMENT = '<fmiModelDescription fmiVersion="{}"/>'


def packed(path: Path, *entries: zipfile.ZipInfo | str | tuple[str, bytes], version: str = "2.0") -> Package:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", DOCUMENT.format(version))
        for entry in entries:
            name, content = entry if isinstance(entry, tuple) else (entry, b"content")
            archive.writestr(name, content)
    return open_package(path)


@pytest.mark.parametrize("name", ["/a", "./a", "../a", "a/../b", "a/./b", "a/..", "..", "a\\b", "C:/a", "C:a", "a:b/c"])
def test_a_path_that_leads_elsewhere_is_found(tmp_path: Path, name: str) -> None:
    assert told(check_archive(packed(tmp_path / "x.fmu", name))) == [("zip-path", name, f"'{name}'")]


@pytest.mark.parametrize("name", ["a", "a/b.c", ".hidden/a", "a/..b", "a..b/c", "a/b:c", "resources/", "ä b/c"])
def test_a_path_within_is_not(tmp_path: Path, name: str) -> None:
    assert told(check_archive(packed(tmp_path / "x.fmu", name))) == []


@pytest.mark.parametrize("size", [(1 << 20) + 1, 1 << 20, 1, 0])
def test_a_file_of_any_size_is_intact_until_a_byte_changes(tmp_path: Path, size: int) -> None:
    package = packed(tmp_path / "x.fmu", ("file", b"\xf7" * size))
    assert told(check_archive(package)) == []
    content = package.path.read_bytes()
    if size:
        package.path.write_bytes(content.replace(b"\xf7" * size, b"\xf7" * (size - 1) + b"\xf8", 1))
        assert told(check_archive(package)) == [("zip-sound", "file", "a damaged one")]


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_a_path_that_is_there_thrice_is_found_once(tmp_path: Path) -> None:
    package = packed(tmp_path / "x.fmu", "a", "a", "b", "a")
    assert told(check_archive(package)) == [("zip-path", "a", "it 3 times")]


def test_links_methods_and_encrypted_files_are_found_by_name(tmp_path: Path) -> None:
    link, bzip2, lzma = (zipfile.ZipInfo(name) for name in ("link", "bzip2", "lzma"))
    link.create_system, link.external_attr = 3, (stat.S_IFLNK | 0o777) << 16
    bzip2.compress_type, lzma.compress_type = zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA
    file = zipfile.ZipInfo("file")
    file.create_system, file.external_attr = 3, (stat.S_IFREG | 0o644) << 16
    package = packed(tmp_path / "x.fmu", link, bzip2, lzma, file, "secret")
    content = bytearray(package.path.read_bytes())
    content[content.rindex(b"PK\x01\x02") + 8] |= 1  # general purpose bit 0 of the last entry
    package.path.write_bytes(content)
    assert told(check_archive(package)) == [
        ("zip-link", "link", "a link"),
        ("zip-method", "bzip2", "method 12"),
        ("zip-method", "lzma", "method 14"),
        ("zip-sound", "secret", "an encrypted one"),
    ]


@pytest.mark.parametrize(("version", "kept"), [("2.0", "2.0"), ("3.0", "3.0"), ("3.0.2", "3.0")])
def test_versions_that_are_checked(tmp_path: Path, version: str, kept: str) -> None:
    assert packed(tmp_path / "x.fmu", version=version).version == kept


@pytest.mark.parametrize("version", ["1.0", "2.0.1", "2.1", "3.1", "3.0.x", "", "12.0"])
def test_versions_that_are_not(tmp_path: Path, version: str) -> None:
    said = version or "unknown"
    with pytest.raises(ValueError, match=rf"x\.fmu: is of FMI version {said}; FMI 2\.0 and 3\.0 are checked here"):
        packed(tmp_path / "x.fmu", version=version)


@pytest.mark.parametrize(
    ("document", "words"),
    [
        (b"<a>\n<b></a>", "modelDescription.xml, line 2: "),
        (b'<?xml version="1.0" encoding="none-such"?><a/>', "modelDescription.xml"),
        (b'<other fmiVersion="2.0"/>', "is of FMI version 2.0; FMI 2.0 and 3.0 are checked here"),
    ],
)
def test_a_document_that_is_none_is_refused(tmp_path: Path, document: bytes, words: str) -> None:
    path = tmp_path / "x.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", document)
    with pytest.raises(ValueError) as refused:
        open_package(path)
    assert str(refused.value).startswith(f"{path}: ") and words in str(refused.value)


def test_what_the_system_does_not_read_is_refused_with_its_words(tmp_path: Path) -> None:
    path = tmp_path / ("n" * 300)
    with pytest.raises(NotAnFmu, match=f"^{path}: cannot be read: File name too long$"):
        open_package(path)
