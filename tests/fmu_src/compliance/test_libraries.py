"""Libraries of every platform are read without loading them: those that fmpy brings, whose symbols are known."""

from __future__ import annotations

from pathlib import Path

import fmpy
import pytest

from broken_fmus import Contents, edited, told
from fmu_src.compliance.files import binaries, fmi3
from fmu_src.compliance.files.binaries import check_binaries, functions, functions_of_fmi3
from fmu_src.compliance.files.description import read
from fmu_src.compliance.files.libraries import Library, read_library
from fmu_src.compliance.files.systems import is_named, is_part_of

FMPY = Path(fmpy.__file__).parent
CONTAINER = FMPY / "container_fmu" / "binaries"


@pytest.mark.parametrize(
    ("file", "machine", "system"),
    [
        ("linux64/logging.so", "x86_64", "libc.so.6"),
        ("win64/logging.dll", "x86_64", "KERNEL32.dll"),
        ("win32/logging.dll", "x86", "KERNEL32.dll"),
        ("darwin64/logging.dylib", "x86_64", "/usr/lib/libSystem.B.dylib"),
    ],
)
def test_fmpys_logger_is_read_on_every_platform(file: str, machine: str, system: str) -> None:
    library = read_library(FMPY / "logging" / file)
    assert machine in library.machines and "addLoggerProxy" in library.exports and system in library.needed
    # What it calls and what is its own is no export.
    assert not {"vsnprintf", "__vsnprintf_chk", "__stack_chk_fail", "logMessage", "s_logger"} & library.exports
    if file.endswith(".so"):
        assert library.undefined["vsnprintf"] == "libc.so.6"
        assert not {"__gmon_start__", "__cxa_finalize"} & set(library.undefined)  # weak


@pytest.mark.parametrize(
    ("file", "machine"),
    [
        ("aarch64-darwin/container_fmu.dylib", "aarch64"),
        ("x86_64-darwin/container_fmu.dylib", "x86_64"),
        ("x86_64-windows/container_fmu.dll", "x86_64"),
        ("x86_64-linux/container_fmu.so", "x86_64"),
    ],
)
def test_the_functions_of_fmpys_container_are_its_exports(file: str, machine: str) -> None:
    library = read_library(CONTAINER / file)
    assert library.machines == {machine}
    assert functions("CoSimulation") <= library.exports and functions_of_fmi3("CoSimulation") <= library.exports


def test_a_library_of_another_format_or_none_is_refused(tmp_path: Path) -> None:
    for suffix, words in ((".so", "no ELF file"), (".dll", "no PE file"), (".dylib", "no Mach-O file")):
        path = tmp_path / f"library{suffix}"
        path.write_bytes(b"no library at all, but long enough for a header of any kind" * 10)
        with pytest.raises(ValueError, match=words):
            read_library(path)


def test_the_functions_of_an_interface_are_the_headers() -> None:
    stepping, exchange = functions("CoSimulation"), functions("ModelExchange")
    assert {"fmi2DoStep", "fmi2GetStringStatus", "fmi2SetRealInputDerivatives"} <= stepping - exchange
    assert {"fmi2SetTime", "fmi2NewDiscreteStates", "fmi2GetNominalsOfContinuousStates"} <= exchange - stepping
    assert (len(stepping & exchange), len(stepping), len(exchange)) == (25, 34, 35)
    assert {"fmi2Instantiate", "fmi2GetTypesPlatform", "fmi2Reset"} <= stepping & exchange


@pytest.mark.parametrize(
    ("suffix", "its", "others"),
    [
        (
            ".so",
            [
                "libc.so.6",
                "libm.so.6",
                "libpthread.so.0",
                "libdl.so.2",
                "ld-linux-x86-64.so.2",
                "libc.musl-x86_64.so.1",
            ],
            ["libgcc_s.so.1", "libstdc++.so.6", "libc.so.60", "libcrypt.so.1", "liblibc.so.6", "libc.so.5"],
        ),
        (
            ".dylib",
            ["/usr/lib/libSystem.B.dylib", "/System/Library/Frameworks/A/A"],
            ["@rpath/a.dylib", "/usr/local/lib/a.dylib", "/opt/usr/lib/a"],
        ),
        (
            ".dll",
            ["KERNEL32.dll", "winspool.drv", "WINSPOOL.DRV", "api-ms-win-core-a-l1-1-0.dll", "ext-ms-win-a.dll"],
            ["vcruntime140.dll", "a.dll", "my-api-ms-win-a.dll"],
        ),
    ],
)
def test_what_belongs_to_a_system_does(suffix: str, its: list[str], others: list[str]) -> None:
    assert [name for name in its if not is_part_of(suffix, name)] == []
    assert [name for name in others if is_part_of(suffix, name)] == []


def test_a_name_is_declared_without_its_folder_suffix_and_version() -> None:
    assert is_named("/opt/x/libfoo.so.1.2", frozenset({"foo"})) and is_named("FOO.DLL", frozenset({"foo"}))
    assert not is_named("libfoobar.so", frozenset({"foo"}))


def fmu(folder: Path, *files: str) -> Path:
    for file in files:
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_bytes(b"")
    return folder


SOUND = Library(frozenset({"x86_64"}), functions("CoSimulation"), frozenset(), {})


@pytest.fixture
def library(monkeypatch: pytest.MonkeyPatch) -> dict[str, Library]:
    """By suffix, as what each library is read."""
    by_suffix = {".so": SOUND, ".dll": SOUND, ".dylib": SOUND}
    monkeypatch.setattr(binaries, "read_library", lambda path: by_suffix[path.suffix])
    return by_suffix


def of(folder: Path, edits: dict[str, str] | None = None) -> list[tuple[str, str, str]]:
    return told(check_binaries(folder, read(edited("modelDescription.xml", edits or {}))))


SOURCE = "sources/broken.c"


def test_folders_and_files_are_where_importers_look(tmp_path: Path, library: dict[str, Library]) -> None:
    assert (
        of(fmu(tmp_path / "1", SOURCE, "binaries/linux64/broken.so", "binaries/win64/broken.dll", "binaries/README"))
        == []
    )
    assert of(fmu(tmp_path / "2", SOURCE, "binaries/README")) == []
    assert of(
        fmu(tmp_path / "3", SOURCE, "binaries/linux64/deep/broken.so", "binaries/linux64/b.so", "binaries/linux64/a.so")
    ) == [("binary-missing", "binaries/linux64", "a.so, b.so")]
    assert of(fmu(tmp_path / "4", SOURCE, "binaries/linux/broken.so")) == [
        ("platform-folder", "binaries/linux", "'linux'")
    ]
    assert of(fmu(tmp_path / "5", "binaries/linux64/broken.so")) == [("source-files", "sources/broken.c", "none")]
    assert of(fmu(tmp_path / "6", "sources/deep/broken.c")) == [("source-files", "sources/broken.c", "none")]
    none = {'<SourceFiles><File name="broken.c"/></SourceFiles>': ""}
    assert of(fmu(tmp_path / "7", "resources/a"), none) == [("implementation", "binaries/, sources/", "neither")]
    assert of(fmu(tmp_path / "8", SOURCE), none) == []
    assert of(fmu(tmp_path / "9", "binaries/linux64/broken.so"), none) == []


HERE = "binaries/linux64/broken.so"


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        ({"machines": frozenset({"aarch64"})}, [("binary-format", HERE, "code for aarch64")]),
        ({"machines": frozenset({"x86", "x86_64"})}, []),
        (
            {"exports": functions("CoSimulation") - {"fmi2DoStep", "fmi2Reset"}},
            [("exports", HERE, "fmi2DoStep, fmi2Reset missing")],
        ),
        (
            {"needed": frozenset({"libm.so.6", "libfoo.so.1", "libbar.so"})},
            [("needed-libraries", HERE, "libbar.so, libfoo.so.1")],
        ),
        ({"needed": frozenset({"beside.so", "broken.so"})}, []),
        (
            {"undefined": {"no_such_symbol": None, "cos": None, "printf": None}},
            [("undefined-symbols", HERE, "no_such_symbol")],
        ),
        ({"undefined": {"odd": "libc.so.6"}, "needed": frozenset({"libc.so.6"})}, []),
        ({"undefined": {"odd": "libm.so.6"}, "needed": frozenset({"libc.so.6"})}, [("undefined-symbols", HERE, "odd")]),
        ({"undefined": {"odd": None}, "needed": frozenset({"beside.so"})}, []),
        ({"undefined": {"odd": None}, "needed": frozenset({"libfoo.so"})}, [("needed-libraries", HERE, "libfoo.so")]),
    ],
)
def test_a_library_has_what_it_must_and_needs_what_there_is(
    tmp_path: Path, library: dict[str, Library], found: dict[str, object], expected: list[tuple[str, str, str]]
) -> None:
    library[".so"] = Library(**{**vars(SOUND), **found})  # type: ignore[arg-type]
    folder = fmu(tmp_path, SOURCE, HERE, "binaries/linux64/beside.so")
    assert of(folder) == expected


def test_what_a_tool_completes_or_the_documentation_names_is_no_finding(
    tmp_path: Path, library: dict[str, Library]
) -> None:
    library[".so"] = Library(**{**vars(SOUND), "needed": frozenset({"libfoo.so.1"})})
    folder = fmu(tmp_path, SOURCE, HERE)
    flag = {"<CoSimulation ": '<CoSimulation needsExecutionTool="true" '}
    assert [rule for rule, _, _ in of(folder)] == ["needed-libraries"] and of(folder, flag) == []
    for name in ("externalDependencies.txt", "externalDependencies.html"):
        (folder / "documentation").mkdir(exist_ok=True)
        (folder / "documentation" / name).write_text("It needs libfoo.so.1.")
        assert of(folder) == []
        (folder / "documentation" / name).unlink()


@pytest.mark.parametrize(
    ("folder", "is_one"),
    [
        ("x86_64-linux", True),
        ("aarch64-darwin", True),
        ("x86_64-windows-msvc141", True),
        ("riscv64-linux", True),
        ("linux64", False),
        ("x86_64", False),
        ("x86_64-beos", False),
        ("pdp11-linux", False),
    ],
)
def test_platforms_of_fmi_3_are_machine_and_system(folder: str, is_one: bool) -> None:
    described = fmi3.read(edited("fmi3.xml", {}))
    assert (binaries._platform(described, folder) is not None) == is_one


def test_the_library_for_this_machine_is_named_after_an_identifier_only(sound: Contents) -> None:
    (path,) = (name for name in sound if name.startswith("binaries/"))
    assert binaries.host_library("broken") == path
    assert binaries.host_library("../broken") is None and binaries.host_library("") is None
