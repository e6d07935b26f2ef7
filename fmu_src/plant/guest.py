"""A plant as it travels in an observer's FMU, and where it is found again by the functions that call it.

CasADi's external functions carry a name and nothing else, through every expression that is made of them: `plant_<digest>_rate`. The digest
is of the plant's files and of what is used of it, so that the same plant has the same name everywhere, and the same bytes.
"""

from __future__ import annotations

import atexit
import ctypes
import hashlib
import re
import shutil
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fmu_src.errors import ExportError, PlantError
from fmu_src.native.compiler import compile_library
from fmu_src.native.sources import fixed_sources
from fmu_src.plant.description import PlantDescription
from fmu_src.plant.examine import Behaviour, Selection
from fmu_src.plant.sources import interpreter, plant_sources, plant_tables
from fmu_src.platforms import PLATFORMS, resolve
from observers.component import Component

_NAME = re.compile(r"(plant_[0-9a-f]{16})_(?:rate|measure)")
_LICENSES = "documentation/licenses/"
PREFIX_H = """\
#ifndef PREFIX_H
#define PREFIX_H
#define PREFIX(name) own_##name
#define BEGIN_INTERNAL _Pragma("GCC visibility push(hidden)")
#define END_INTERNAL _Pragma("GCC visibility pop")
#endif
"""
_known: dict[str, Guest] = {}
_told: dict[str, bytes] = {}  # folders that libraries point to, by the name of their plant


@dataclass(frozen=True)
class Guest:
    """A plant that travels: `name`, of its functions; `library`, of the C `sources`, by which CasADi calls it here; `tables`, C for its
    FMU; `files` by path in its own.

    `redistribute`: its owner's leave to pass its files on was stated. `source`: the FMU that it came from.
    """

    name: str
    library: Path
    plant: PlantDescription
    tables: bytes
    sources: dict[str, bytes]
    files: dict[str, bytes]
    redistribute: bool
    source: Path

    def tell(self, library: Path) -> None:
        """A library made of `sources` learns where the plant lies; the text that it keeps a pointer to stays."""
        ctypes.CDLL(str(library)).plant_lies_in(_told.setdefault(self.name, str(self.library.parent).encode()))

    def platforms(self, names: Sequence[str]) -> list[str]:
        """The folders for `names` of platforms; of "all" those that the plant has a binary for.

        Raises:
            ExportError: one that is asked for by its name, or this machine's, and is not there.
        """
        asked = resolve(names)
        wanted = [p for p in asked if p in self.plant.platforms] if "all" in names else asked
        missing = [p for p in wanted if p not in self.plant.platforms]
        if missing or not wanted:
            there = ", ".join(self.plant.platforms) or "none that is known here"
            raise ExportError(
                f"plant '{self.plant.file}' has no binary for {', '.join(missing or asked)}; it has {there}"
            )
        return wanted

    def resources(self, folders: Sequence[str]) -> dict[str, bytes]:
        """Its files by path in the observer's FMU, with the binaries for `folders`.

        Raises:
            ExportError: they are somebody's, and his leave was not stated.
        """
        licensed = self.plant.license or any(name.startswith(_LICENSES) for name in self.files)
        if licensed and not self.redistribute:
            said = f" ({self.plant.license})" if self.plant.license else " (documentation/licenses)"
            raise ExportError(
                f"plant '{self.plant.file}' says whose it is{said}, and its files would travel in the FMU: if its owner allows that, say "
                "so by redistribute=True (--redistribute)"
            )
        binaries = tuple(f"binaries/{folder}/" for folder in folders)
        taken = {
            f"resources/plant/{name}": content
            for name, content in self.files.items()
            if not name.startswith("binaries/") or name.startswith(binaries)
        }
        licenses = {
            f"documentation/licenses/plant/{name.removeprefix(_LICENSES)}": content
            for name, content in self.files.items()
            if name.startswith(_LICENSES)
        }
        return taken | licenses


def unpacked(path: Path, file: str) -> Path:
    """The FMU's files in a folder `plant` of a folder that lives as long as this process; the latter's path.

    Raises:
        PlantError: the archive is damaged, or names a place outside.
    """
    folder = Path(tempfile.mkdtemp(prefix="plant-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    try:
        with zipfile.ZipFile(path) as archive:
            archive.extractall(folder / "plant")  # zipfile drops what would lead out of it
    except (OSError, zipfile.BadZipFile, RuntimeError, NotImplementedError, ValueError, EOFError) as error:
        raise PlantError(f"plant '{file}' cannot be unpacked: {error}") from None
    (folder / "plant" / "resources").mkdir(exist_ok=True)
    return folder


def invite(
    source: Path, folder: Path, plant: PlantDescription, chosen: Selection, behaviour: Behaviour, redistribute: bool
) -> Guest:
    """The guest that the plant of the FMU `source`, unpacked in `folder`, becomes, with the library by which CasADi calls it.

    Raises:
        ExportError: the compiler is missing.
    """
    files = _files(folder / "plant")
    tables = plant_tables(plant, chosen, behaviour)
    digest = hashlib.sha256(tables)
    for name in sorted(files):
        digest.update(f"{name}\0{len(files[name])}\0".encode() + files[name])
    name = f"plant_{digest.hexdigest()[:16]}"
    if name in _known and _known[name].redistribute == redistribute and _known[name].library.is_file():
        return _known[name]
    sources = plant_sources() | {n: c for n, c in fixed_sources().items() if n.startswith("fmi2")}
    sources |= {
        "prefix.h": PREFIX_H.encode(),
        "plant_tables.c": tables,
        "interpreter.c": interpreter(name, plant, chosen, behaviour),
    }
    scratch = folder / "interpreter"
    scratch.mkdir(exist_ok=True)
    for file, content in sources.items():
        (scratch / file).write_bytes(content)
    host = resolve(["host"])[0]
    library = folder / f"{name}{PLATFORMS[host].suffix}"
    library.write_bytes(compile_library(name, scratch, host, libraries(host)))
    _known[name] = Guest(name, library, plant, tables, sources, files, redistribute, source.resolve())
    _known[name].tell(library)
    return _known[name]


def libraries(platform: str) -> tuple[str, ...]:
    """What the C of a component with a plant is linked with."""
    return ("-lm", "-ldl") if PLATFORMS[platform].suffix == ".so" else ("-lm",)


def guest_of(component: Component) -> Guest | None:
    """The plant that the component's functions call; None where they call none.

    Raises:
        ExportError: they call several.
    """
    called = {inner.name() for function in component.functions.values() for inner in function.find_functions()}
    names = {match[1] for match in map(_NAME.fullmatch, called) if match}
    if len(names) > 1:
        files = ", ".join(sorted(_known[name].plant.file for name in names))
        raise ExportError(f"component '{component.name}' asks several plants ({files}): take one")
    return _known[names.pop()] if names else None


def _files(folder: Path) -> dict[str, bytes]:
    """What travels: the description, binaries, resources, licences."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and (
            name == "modelDescription.xml" or name.startswith(("binaries/", "resources/", _LICENSES))
        ):
            found[name] = path.read_bytes()
    return found
