"""Rules of what the FMU carries to be run: its platforms' libraries and its sources."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path, PurePosixPath

import fmpy

from fmu_src.compliance.files.description import Description, is_identifier
from fmu_src.compliance.files.libraries import Library, read_library
from fmu_src.compliance.files.systems import is_named, is_part_of, names_in
from fmu_src.compliance.finding import Finding
from fmu_src.compliance.rules import finding
from fmu_src.errors import ExportError
from fmu_src.platforms import resolve

# By folder in binaries/: the libraries' suffix and machine. FMI 2.0 names those for x86; for other machines 2.0.4 points to
# the <machine>-<system> tuples of FMI 3.0.
FOLDERS = {
    "linux32": (".so", "x86"),
    "linux64": (".so", "x86_64"),
    "win32": (".dll", "x86"),
    "win64": (".dll", "x86_64"),
    "darwin32": (".dylib", "x86"),
    "darwin64": (".dylib", "x86_64"),
    "aarch32-linux": (".so", "aarch32"),
    "aarch64-linux": (".so", "aarch64"),
    "aarch64-windows": (".dll", "aarch64"),
    "aarch64-darwin": (".dylib", "aarch64"),
}
_SUFFIXES = {"linux": ".so", "windows": ".dll", "darwin": ".dylib"}
_MACHINES = ("aarch32", "aarch64", "ppc32", "ppc64", "riscv32", "riscv64", "x86", "x86_64")
_KNOWN_MACHINES = frozenset(machine for _, machine in FOLDERS.values())  # that are read from a library

# Where an FMU may say which further libraries it needs.
_DECLARATIONS = ("documentation/externalDependencies.txt", "documentation/externalDependencies.html")


def check_binaries(directory: Path, description: Description) -> Iterator[Finding]:
    """The rules from `implementation` to `source-files`, of the FMU unpacked in `directory`."""
    files = {PurePosixPath(path.relative_to(directory).as_posix()) for path in directory.rglob("*") if path.is_file()}
    binaries = {path for path in files if path.parts[0] == "binaries" and len(path.parts) > 2}
    sources = {str(PurePosixPath(*path.parts[1:])) for path in files if path.parts[0] == "sources"}
    if not binaries and not sources:
        yield finding("implementation", "binaries/, sources/", "a binary or sources", "neither")
    for name in description.source_files:
        if name not in sources:
            yield finding("source-files", f"sources/{name}", "the listed file", "none")
    declared = names_in("".join(_text(directory / name) for name in _DECLARATIONS))
    for folder in sorted({path.parts[1] for path in binaries}):
        platform = _platform(description, folder)
        if platform is not None:
            beside = {path.name for path in binaries if path.parts[1] == folder and len(path.parts) == 3}
            yield from _check_platform(directory, description, folder, platform, beside, declared)
        else:
            names = ", ".join(FOLDERS) if description.version == "2.0" else "<machine>-<system>, such as x86_64-linux"
            yield finding("platform-folder", f"binaries/{folder}", f"one of {names}", f"'{folder}'")


def _platform(description: Description, folder: str) -> tuple[str, str] | None:
    """Suffix and machine of the libraries in this folder of binaries/; None where FMI has no such folder."""
    if description.version == "2.0":
        return FOLDERS.get(folder)
    machine, _, rest = folder.partition("-")
    system, _, _ = rest.partition("-")  # after it may come the ABI
    return (_SUFFIXES[system], machine) if machine in _MACHINES and system in _SUFFIXES else None


def host_library(identifier: str) -> str | None:
    """The path in the FMU of the library for this machine; None where FMI has no name for the machine.

    None too where the identifier is none: as a file's name it might lead out of the FMU.
    """
    try:
        folder = resolve(["host"])[0]
    except ExportError:
        return None
    return f"binaries/{folder}/{identifier}{FOLDERS[folder][0]}" if is_identifier(identifier) else None


def _text(path: Path) -> str:
    """The beginning of a text; none where there is no such file."""
    if not path.is_file():
        return ""
    with path.open(encoding="utf-8", errors="replace") as file:
        return file.read(1 << 20)


def _check_platform(
    directory: Path,
    description: Description,
    folder: str,
    platform: tuple[str, str],
    beside: set[str],
    declared: frozenset[str],
) -> Iterator[Finding]:
    suffix, machine = platform
    for interface, identifier in description.identifiers.items():
        path = f"binaries/{folder}/{identifier}{suffix}"
        if f"{identifier}{suffix}" not in beside:
            yield finding("binary-missing", f"binaries/{folder}", f"{identifier}{suffix}", ", ".join(sorted(beside)))
            continue
        try:
            library = read_library(directory / path)
        except ValueError as error:
            yield finding("binary-format", path, f"a library for {folder}", str(error))
            continue
        if machine in _KNOWN_MACHINES and machine not in library.machines:
            found = f"code for {', '.join(sorted(library.machines))}"
            yield finding("binary-format", path, f"code for {machine}", found)
        wanted = functions(interface) if description.version == "2.0" else functions_of_fmi3(interface)
        missing = sorted(wanted - library.exports)
        if missing:
            yield finding("exports", path, f"all functions of {interface} exported", f"{', '.join(missing)} missing")
        if not description.says("needsExecutionTool", interface):  # else the FMU says itself that it is not complete
            yield from _check_dependencies(path, library, suffix, beside, declared)


def _check_dependencies(
    path: str, library: Library, suffix: str, beside: set[str], declared: frozenset[str]
) -> Iterator[Finding]:
    own = {PurePosixPath(path).name} | beside
    others = {name for name in library.needed if not is_part_of(suffix, name) and PurePosixPath(name).name not in own}
    strangers = sorted(name for name in others if not is_named(name, declared))
    if strangers:
        expected = "what the system has, what lies beside it, or what externalDependencies.txt names"
        yield finding("needed-libraries", path, expected, ", ".join(strangers))
    open_symbols = sorted(
        name
        for name, provider in library.undefined.items()
        if not (provider in library.needed if provider else _is_in_libc(name))
    )
    if open_symbols and not others and not library.needed & own:
        yield finding("undefined-symbols", path, "symbols of libc and libm", ", ".join(open_symbols))


@cache
def _is_in_libc(name: str) -> bool:
    """Has this machine's C library or libm the symbol? Asked for symbols whose library the file does not say."""
    for library in ("libc.so.6", "libm.so.6"):
        try:
            if hasattr(ctypes.CDLL(library), name):
                return True
        except OSError:  # another system than Linux with glibc: it cannot be known here
            return True
    return False


@cache
def functions(interface: str) -> frozenset[str]:
    """The functions of CoSimulation or ModelExchange, from FMI's own header in the fmpy package."""
    header = (Path(fmpy.__file__).parent / "c-code" / "fmi2Functions.h").read_text()
    declarations = header[header.index("Inquire version numbers of header files") :]
    common, rest = declarations.split("Functions for FMI2 for Model Exchange")
    exchange, cosimulation = rest.split("Functions for FMI2 for Co-Simulation")
    own = cosimulation if interface == "CoSimulation" else exchange
    return frozenset(re.findall(r"FMI2_Export \w+TYPE\s+(\w+);", common + own))


@cache
def functions_of_fmi3(interface: str) -> frozenset[str]:
    """The same for FMI 3.0."""
    header = (Path(fmpy.__file__).parent / "c-code" / "fmi3Functions.h").read_text()
    parts = re.split(r"(?:Functions for|Common) ([\w -]+)\n\*+/", header)  # heading, text, heading, ...
    sections: dict[str, str] = {}
    for heading, text in zip(parts[1::2], parts[2::2], strict=True):
        sections[heading] = sections.get(heading, "") + text
    own = {
        "CoSimulation": "Co-Simulation",
        "ModelExchange": "Model Exchange",
        "ScheduledExecution": "Scheduled Execution",
    }
    declarations = sections["Functions"] + sections[own[interface]]
    return frozenset(re.findall(r"FMI3_Export \w+TYPE\s+(\w+);", declarations))
