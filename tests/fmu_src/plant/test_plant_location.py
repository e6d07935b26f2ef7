"""Where an importer says that the resources lie, in whichever of the ways that are seen, and what the plant is told."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path

import pytest

import plant_fmu
from fmu_src.native.compiler import compile_library
from fmu_src.native.sources import fixed_sources
from fmu_src.plant.sources import plant_sources
from once import LIBRARIES, once
from strict_fmu import HOST

SHOW = """
#include <stdlib.h>
#include "plant.h"
__attribute__((visibility("default"))) const char *folder(const char *uri) { return plant_folder(uri, calloc); }
__attribute__((visibility("default"))) const char *location(const char *path)
{
    return plant_location(path, "/resources", calloc);
}
"""
PREFIX = "#define PREFIX(name) own_##name\n#define BEGIN_INTERNAL\n#define END_INTERNAL\n"


@pytest.fixture(scope="module")
def asked() -> Callable[[str, str], str]:
    """asked("folder", uri), asked("location", path)."""
    sources = {
        name: content for name, content in (plant_sources() | fixed_sources()).items() if name.startswith("fmi2")
    }
    sources |= {name: plant_sources()[name] for name in ("plant.h", "plant_location.c")}
    sources |= {"prefix.h": PREFIX.encode(), "show.c": SHOW.encode()}
    made_of = plant_fmu.digest(repr(sorted(sources.items())).encode())

    def fill(folder: Path) -> None:
        for name, content in sources.items():
            (folder / name).write_bytes(content)
        (folder / "library").write_bytes(compile_library("show", folder, HOST))

    library = ctypes.CDLL(str(once(LIBRARIES / f"location-{made_of}", fill) / "library"))

    def call(function: str, text: str) -> str:
        found = getattr(library, function)
        found.restype = ctypes.c_char_p
        return str(found(text.encode()).decode())

    return call


@pytest.mark.parametrize(
    ("said", "folder"),
    [
        ("file:///home/a/resources", "/home/a/resources/plant"),
        ("file:///home/a/resources/", "/home/a/resources/plant"),
        ("file:/home/a/resources", "/home/a/resources/plant"),
        ("file:////home/a/resources", "/home/a/resources/plant"),
        ("file://localhost/home/a/resources", "/home/a/resources/plant"),
        ("file:///home/Pr%C3%BCf%20stand/25%25/resources", "/home/Prüf stand/25%/resources/plant"),
        ("file:///home/25% of it/resources", "/home/25% of it/resources/plant"),
        ("file:///home/a%00b/resources", "/home/a%00b/resources/plant"),
        ("/home/25%20/resources", "/home/25%20/resources/plant"),
        ("file:///C:/a%20b/resources", "C:/a b/resources/plant"),
        ("file://C:/a/resources", "C:/a/resources/plant"),
        ("file:/C:/a/resources", "C:/a/resources/plant"),
        ("C:\\a b\\resources", "C:\\a b\\resources/plant"),
        ("C:\\a b\\resources\\", "C:\\a b\\resources/plant"),
        ("/home/a/resources///", "/home/a/resources/plant"),
        ("/", "/plant"),
        ("file:///home/%c3%bC/%41%5A%61%7a%30%39%2d", "/home/ü/AZaz09-/plant"),
        ("file:///%a", "/%a/plant"),
        ("file:///%", "/%/plant"),
        ("file:///%g0%0g%G0%:0%/0%@0%`0%0:%0G", "/%g0%0g%G0%:0%/0%@0%`0%0:%0G/plant"),
        ("file:///%09%1F", "/\t\x1f/plant"),
        ("file:////server/share", "/server/share/plant"),
        ("file:///c:/a", "c:/a/plant"),
        ("file:///z:/a", "z:/a/plant"),
        ("file:///A:/a", "A:/a/plant"),
        ("file:///Z:/a", "Z:/a/plant"),
        ("file:///@:/a", "/@:/a/plant"),
        ("file:///[:/a", "/[:/a/plant"),
        ("file:///`:/a", "/`:/a/plant"),
        ("file:///{:/a", "/{:/a/plant"),
        ("file:///a/b", "/a/b/plant"),
        ("files/resources", "files/resources/plant"),
    ],
)
def test_the_folder_is_where_the_importer_says_however_it_says_it(
    asked: Callable[[str, str], str], said: str, folder: str
) -> None:
    assert asked("folder", said) == folder


@pytest.mark.parametrize(
    ("folder", "uri"),
    [
        ("/home/Prüf stand/25%/plant", "file:///home/Pr%C3%BCf%20stand/25%25/plant/resources"),
        ("C:/a b/plant", "file:///C:/a%20b/plant/resources"),
        ("C:\\a b/plant", "file:///C:/a%20b/plant/resources"),
        ("\\\\server\\share/plant", "file://server/share/plant/resources"),
        ("/a#b?c/plant", "file:///a%23b%3Fc/plant/resources"),
        ("/AZaz09-._~:/plant", "file:///AZaz09-._~:/plant/resources"),
        ("/@[`{;", "file:///%40%5B%60%7B%3B/resources"),
        ("//server/share/plant", "file://server/share/plant/resources"),
        ("\\a\\b", "file:///a/b/resources"),
        ("a", "file:///a/resources"),
    ],
)
def test_the_plant_is_told_a_uri(asked: Callable[[str, str], str], folder: str, uri: str) -> None:
    assert asked("location", folder) == uri
