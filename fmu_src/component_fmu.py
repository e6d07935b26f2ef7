"""A component becomes an FMU: the one entry point."""

from __future__ import annotations

import hashlib
import tempfile
import uuid
import warnings
from collections.abc import Sequence
from pathlib import Path

from fmu_src.archive import check_writable, write_zip
from fmu_src.description.model_description import describe
from fmu_src.documentation import pages as documentation
from fmu_src.documentation.reference import reference_files
from fmu_src.errors import ExperimentFailed, ExportError, ExportWarning
from fmu_src.native.compiler import check_compiler, compile_library
from fmu_src.native.embedded import embedded
from fmu_src.native.sources import fixed_sources, functions, prefix, tables
from fmu_src.plant.guest import Guest, guest_of, libraries
from fmu_src.plant.sources import plant_sources
from fmu_src.platforms import PLATFORMS, resolve
from fmu_src.python import target as python_target
from observers.component import Component


def export(
    component: Component,
    directory: str | Path,
    platforms: Sequence[str] = ("host",),
    driven_by: Component | None = None,
    target: str = "native",
) -> Path:
    """Write `<directory>/<component.name>.fmu`, an FMI 2.0 co-simulation FMU, and return its path.

    The same arguments give the same bytes. A default experiment that fails is an ExportWarning, and the FMU then has no plot and no
    reference results. The file appears under its name only when it is complete.

    Args:
        platforms: names of PLATFORMS, "host" for this machine's, "all" for each of them that the target knows.
        driven_by: a plant; the documentation's plot and the reference experiment then have the two
            coupled, outputs to inputs of equal names.
        target: "native" (C, no dependency) or "python" (PythonFMU, for functions that cannot be compiled).

    Raises:
        ExportError: the component cannot be exported; the message says what is in the way.
        OSError: the file cannot be written.
    """
    if target not in TARGETS:
        raise ExportError(f"target '{target}' is unknown; known: {', '.join(TARGETS)}")
    check_writable(Path(directory))
    path = Path(directory) / f"{component.name}.fmu"
    guest = guest_of(component)
    if guest and guest.source == path.resolve():
        raise ExportError(
            f"component '{component.name}' would be written over its plant {path}: take another folder or name"
        )
    guid, contents = TARGETS[target](component, platforms, guest)
    try:
        references, failure = reference_files(component, driven_by), ""
    except ExperimentFailed as error:
        references, failure = {}, str(error)
    contents |= references | documentation.pages(component, guid, driven_by, target, bool(references))
    write_zip(path, contents)
    if failure:
        warnings.warn(f"{path.name} is built, but {failure}", ExportWarning, stacklevel=2)
    return path


def _native(component: Component, platforms: Sequence[str], guest: Guest | None) -> tuple[str, dict[str, bytes]]:
    """GUID and contents by path."""
    folders = guest.platforms(platforms) if guest else resolve(platforms)
    check_compiler()
    constant = fixed_sources() | prefix(component) | functions(component, guest.name if guest else "")
    inside: dict[str, bytes] = {}
    if guest:
        constant |= plant_sources() | {"plant_tables.c": guest.tables}
        inside = guest.resources(folders)
    capabilities = guest.plant.capabilities if guest else {}
    source_files = sorted(name for name in [*constant, "component.c"] if name.endswith(".c"))
    without_guid = {
        **constant,
        **inside,
        **tables(component, guid="", plant=guest is not None),
        "modelDescription.xml": describe(component, "", source_files, capabilities),
    }
    guid = _content_guid(without_guid)
    code = constant | tables(component, guid, plant=guest is not None)
    extra = {} if guest else embedded(component)  # without FMI there is no plant
    contents = {
        "modelDescription.xml": describe(component, guid, source_files, capabilities),
        **inside,
        **{f"sources/{name}": content for name, content in (code | extra).items()},
    }
    with tempfile.TemporaryDirectory() as scratch:
        for name, content in code.items():
            (Path(scratch) / name).write_bytes(content)
        for folder in folders:
            library = f"{component.name}{PLATFORMS[folder].suffix}"
            linked = libraries(folder) if guest else ("-lm",)
            contents[f"binaries/{folder}/{library}"] = compile_library(component.name, Path(scratch), folder, linked)
    return guid, contents


def _python(component: Component, platforms: Sequence[str], guest: Guest | None) -> tuple[str, dict[str, bytes]]:
    """GUID and contents by path."""
    if guest:
        raise ExportError(
            f"component '{component.name}' asks the FMU {guest.plant.file}, which the target 'python' cannot: take 'native'"
        )
    folders = [name for name in resolve(platforms) if name in python_target.LIBRARIES or "all" not in platforms]
    resources = python_target.resources(component)
    without_guid = {
        **resources,
        **python_target.relay(component, guid=""),
        "modelDescription.xml": describe(component, guid="", capabilities=python_target.CAPABILITIES),
    }
    guid = _content_guid(without_guid)
    return guid, {
        "modelDescription.xml": describe(component, guid, capabilities=python_target.CAPABILITIES),
        **resources,
        **python_target.binaries(component, guid, folders),
        "documentation/licenses/pythonfmu.txt": python_target.license_text(),
    }


TARGETS = {"native": _native, "python": _python}


def _content_guid(contents: dict[str, bytes]) -> str:
    """A GUID that changes when anything changes that the FMU computes or declares: its description and its sources."""
    digest = hashlib.sha256()
    for name in sorted(contents):
        digest.update(f"{name}\0{len(contents[name])}\0".encode())
        digest.update(contents[name])
    return f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}"
