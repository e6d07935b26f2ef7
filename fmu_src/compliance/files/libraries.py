"""Shared libraries of any platform, read without loading them: machine, exports, what they need from others."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import pefile
from elftools.common.exceptions import ELFError
from elftools.elf.elffile import ELFFile

_ELF_MACHINES = {"EM_386": "x86", "EM_X86_64": "x86_64", "EM_AARCH64": "aarch64", "EM_ARM": "aarch32"}
_PE_MACHINES = {0x14C: "x86", 0x8664: "x86_64", 0xAA64: "aarch64"}
_MACHO_MACHINES = {7: "x86", 0x01000007: "x86_64", 0x0100000C: "aarch64"}
_N_EXT, _N_TYPE, _N_STAB = 0x01, 0x0E, 0xE0  # bits of a Mach-O symbol


@dataclass(frozen=True)
class Library:
    """`machines`: those it has code for; `undefined`: by symbol the library that should have it, where that is said."""

    machines: frozenset[str]
    exports: frozenset[str]
    needed: frozenset[str]
    undefined: dict[str, str | None]


def read_library(path: Path) -> Library:
    """The library at `path`; its suffix (.so, .dll, .dylib) says of which format it must be.

    Raises:
        ValueError: it is not of this format.
    """
    readers: dict[str, Callable[[Path], Library]] = {".so": _elf, ".dll": _pe, ".dylib": _macho}
    try:
        return readers[path.suffix](path)
    except ValueError:
        raise
    except Exception as error:  # of whatever kind: the readers follow a damaged file's numbers wherever they lead
        raise ValueError(f"a damaged file ({type(error).__name__}: {error})") from None


def _elf(path: Path) -> Library:
    with path.open("rb") as content:
        return _elf_of(content)


def _elf_of(content: BinaryIO) -> Library:
    try:
        file = ELFFile(content)
        table, dynamic = _section(file, ".dynsym"), _section(file, ".dynamic")
        if table is None or dynamic is None:
            raise ValueError("no shared library (it has no dynamic symbols)")
        providers = _elf_providers(file)
        exports: set[str] = set()
        undefined: dict[str, str | None] = {}
        for number, symbol in enumerate(table.iter_symbols()):
            if not symbol.name:
                continue
            if symbol["st_shndx"] != "SHN_UNDEF":
                if symbol["st_other"]["visibility"] in ("STV_DEFAULT", "STV_PROTECTED"):
                    exports.add(symbol.name)
            elif symbol["st_info"]["bind"] != "STB_WEAK":  # a weak symbol may stay undefined
                undefined[symbol.name] = providers(number)
        needed = frozenset(tag.needed for tag in dynamic.iter_tags("DT_NEEDED"))
        machine = _ELF_MACHINES.get(file["e_machine"], str(file["e_machine"]))
    except ELFError as error:
        raise ValueError(f"no ELF file ({error})") from None
    return Library(frozenset({machine}), frozenset(exports), needed, undefined)


def _section(file: ELFFile, name: str) -> Any:
    """The section, of the class that belongs to its kind; None if there is none."""
    return file.get_section_by_name(name)


def _elf_providers(file: ELFFile) -> Callable[[int], str | None]:
    """By the number of a dynamic symbol: the library that its version names."""
    versions, needs = _section(file, ".gnu.version"), _section(file, ".gnu.version_r")
    if versions is None or needs is None:
        return lambda number: None
    libraries = {
        auxiliary["vna_other"]: need.name for need, auxiliaries in needs.iter_versions() for auxiliary in auxiliaries
    }
    return lambda number: libraries.get(versions.get_symbol(number)["ndx"])


def _pe(path: Path) -> Library:
    try:
        file = pefile.PE(str(path), fast_load=True)
        file.parse_data_directories(
            [pefile.DIRECTORY_ENTRY[f"IMAGE_DIRECTORY_ENTRY_{name}"] for name in ("EXPORT", "IMPORT")]
        )
    except pefile.PEFormatError as error:
        raise ValueError(f"no PE file ({error})") from None
    exported = getattr(file, "DIRECTORY_ENTRY_EXPORT", None)
    imported = getattr(file, "DIRECTORY_ENTRY_IMPORT", [])
    return Library(
        machines=frozenset({_PE_MACHINES.get(file.FILE_HEADER.Machine, hex(file.FILE_HEADER.Machine))}),
        exports=frozenset(symbol.name.decode() for symbol in exported.symbols if symbol.name)
        if exported
        else frozenset(),
        needed=frozenset(entry.dll.decode() for entry in imported),
        undefined={},  # a PE file takes each symbol from a named library, so `needed` says it all
    )


def _macho(path: Path) -> Library:
    # A third of the time that a check takes to begin, for a kind of library that few FMUs have.
    from macholib.mach_o import LC_LOAD_DYLIB, LC_REEXPORT_DYLIB
    from macholib.MachO import MachO
    from macholib.SymbolTable import SymbolTable

    try:
        file = MachO(str(path), allow_unknown_load_commands=True)
    except (ValueError, struct.error) as error:
        raise ValueError(f"no Mach-O file ({error})") from None
    machines: set[str] = set()
    exports: set[str] = set()
    needed: set[str] = set()
    for header in file.headers:
        machines.add(_MACHO_MACHINES.get(header.header.cputype, str(header.header.cputype)))
        table = SymbolTable(file, header=header)
        for symbol, name in table.nlists:
            if symbol.n_type & _N_EXT and symbol.n_type & _N_TYPE and not symbol.n_type & _N_STAB:
                exports.add(name.decode().removeprefix("_"))
        for command, _, name in header.commands:
            if command.cmd in (LC_LOAD_DYLIB, LC_REEXPORT_DYLIB):
                needed.add(name.rstrip(b"\0").decode())
    # Two-level names: each undefined symbol belongs to a library in `needed`.
    return Library(frozenset(machines), frozenset(exports), frozenset(needed), {})
