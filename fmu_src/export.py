"""A component becomes an FMU: the one entry point."""

from __future__ import annotations

import hashlib
import tempfile
import uuid
from collections.abc import Sequence
from pathlib import Path

from fmu_src import documentation, native, platforms, sources
from fmu_src.archive import write_zip
from fmu_src.description import describe
from observers.component import Component


def export(component: Component, directory: str | Path, platforms_: Sequence[str] = ("host",), driven_by: Component | None = None) -> Path:
    """x"""
    folders = platforms.resolve(platforms_)
    fixed = sources.fixed_sources() | sources.functions(component)
    source_files = sorted(name for name in [*fixed, "component.c"] if name.endswith(".c"))
    guid = _guid([describe(component, "", source_files), *[fixed[name] for name in sorted(fixed)], sources.tables(component, "")["component.c"]])
    code = fixed | sources.tables(component, guid)
    contents = {"modelDescription.xml": describe(component, guid, source_files)}
    contents |= {f"sources/{name}": content for name, content in code.items()}
    contents |= documentation.pages(component, guid, driven_by)
    with tempfile.TemporaryDirectory() as scratch:
        for name, content in code.items():
            (Path(scratch) / name).write_bytes(content)
        for folder in folders:
            library = f"{component.name}{platforms.PLATFORMS[folder].suffix}"
            contents[f"binaries/{folder}/{library}"] = native.compile_library(component.name, Path(scratch), folder)
    path = Path(directory) / f"{component.name}.fmu"
    write_zip(path, contents)
    return path
