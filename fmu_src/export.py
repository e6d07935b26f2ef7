"""A component becomes an FMU: the one entry point."""

from __future__ import annotations

import hashlib
import tempfile
import uuid
from collections.abc import Sequence
from pathlib import Path

from fmu_src import documentation
from fmu_src.archive import write_zip
from fmu_src.description import describe
from fmu_src.native import compile_library
from fmu_src.platforms import PLATFORMS, resolve
from fmu_src.reference import reference_files
from fmu_src.sources import fixed_sources, functions, tables
from observers.component import Component


def export(
    component: Component,
    directory: str | Path,
    platforms: Sequence[str] = ("host",),
    driven_by: Component | None = None,
) -> Path:
    """Write `<directory>/<component.name>.fmu`, an FMI 2.0 co-simulation FMU in native code, and return its path.

    The same arguments give the same bytes. The file appears under its name only when it is complete.

    Args:
        platforms: names of PLATFORMS, "host" for this machine's, "all" for each of them.
        driven_by: a plant; the documentation's plot and the reference experiment then have the two
            coupled, outputs to inputs of equal names.

    Raises:
        ExportError: the component cannot be exported; the message says what is in the way.
        OSError: the file cannot be written.
    """
    folders = resolve(platforms)
    constant = fixed_sources() | functions(component)
    source_files = sorted(name for name in [*constant, "component.c"] if name.endswith(".c"))
    without_guid = {
        **constant,
        **tables(component, guid=""),
        "modelDescription.xml": describe(component, guid="", source_files=source_files),
    }
    guid = _content_guid(without_guid)
    code = constant | tables(component, guid)
    contents = {
        "modelDescription.xml": describe(component, guid, source_files),
        **{f"sources/{name}": content for name, content in code.items()},
        **documentation.pages(component, guid, driven_by),
        **reference_files(component, driven_by),
    }
    with tempfile.TemporaryDirectory() as scratch:
        for name, content in code.items():
            (Path(scratch) / name).write_bytes(content)
        for folder in folders:
            library = f"{component.name}{PLATFORMS[folder].suffix}"
            contents[f"binaries/{folder}/{library}"] = compile_library(component.name, Path(scratch), folder)
    path = Path(directory) / f"{component.name}.fmu"
    write_zip(path, contents)
    return path


def _content_guid(contents: dict[str, bytes]) -> str:
    """A GUID that changes when anything changes that the FMU computes or declares: its description and its sources."""
    digest = hashlib.sha256()
    for name in sorted(contents):
        digest.update(f"{name}\0{len(contents[name])}\0".encode())
        digest.update(contents[name])
    return f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}"
