"""The binaries and the archive: what they hold, export and need; the same component gives the same bytes."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import fmpy
import pytest
from elftools.elf.elffile import ELFFile
from lxml import etree
from macholib.mach_o import LC_BUILD_VERSION, LC_CODE_SIGNATURE, LC_VERSION_MIN_MACOSX
from macholib.MachO import MachO

from fmu_src import PLATFORMS, ExportError, export
from fmu_src.compliance.files.binaries import functions
from fmu_src.native import compiler as native
from fmu_src.native.sources import FMI_HEADERS
from observers.component import Component, Port
from tools import ROOT
from toys import feedthrough_toy, growing_toy, sampled_toy

Path_of = Callable[[str], Path]


def library(folder: Path) -> Path:
    return next((folder / "binaries").glob("*/*"))


def elf(path: str) -> tuple[set[str], set[str], set[tuple[int, ...]]]:
    """Of a shared library: the symbols it exports, the libraries it needs, the glibc versions of what it imports."""
    with open(path, "rb") as file:
        content = ELFFile(file)
        symbols = list(content.get_section_by_name(".dynsym").iter_symbols())
        assert not [s.name for s in symbols if "ubsan" in s.name]  # zig's default for debug builds
        exported = {s.name for s in symbols if s.name and s["st_shndx"] != "SHN_UNDEF"}
        needed = {tag.needed for tag in content.get_section_by_name(".dynamic").iter_tags("DT_NEEDED")}
        versions = content.get_section_by_name(".gnu.version_r")
        names = {auxiliary.name for _, entries in versions.iter_versions() for auxiliary in entries}
    found = {tuple(map(int, name.removeprefix("GLIBC_").split("."))) for name in names if name.startswith("GLIBC_")}
    return exported, needed, found


@pytest.mark.skipif(sys.platform != "linux", reason="reads an ELF file")
def test_every_cosimulation_function_is_exported_and_nothing_else(unpacked: Path_of) -> None:
    wanted = functions("CoSimulation")
    assert len(wanted) == 34
    for name in ("duffing", "growing_toy"):
        assert elf(library(unpacked(name)))[0] == wanted


@pytest.mark.skipif(sys.platform != "linux", reason="reads an ELF file")
def test_only_libc_and_libm_are_needed(unpacked: Path_of) -> None:
    _, needed, versions = elf(library(unpacked("duffing")))
    assert needed and needed <= {"libc.so.6", "libm.so.6", "ld-linux-x86-64.so.2"}
    assert versions and max(versions) <= (2, 17)


def test_nothing_of_the_machine_that_built_it_is_inside(built: Path_of) -> None:
    with zipfile.ZipFile(built("duffing")) as archive:
        content = b"".join(archive.read(name) for name in archive.namelist())
    for trace in (str(ROOT), str(Path.home()), os.uname().nodename, sys.prefix, "/tmp/"):
        if len(trace) > 3:
            assert trace.encode() not in content, trace


def test_same_component_same_bytes_from_any_folder(tmp_path: Path) -> None:
    script = "import sys; sys.path[:0] = {!r}; from toys import sampled_toy; from fmu_src import export; "
    script += "export(sampled_toy(), {!r})"
    made = []
    for name, locale in (("one", "C"), ("another folder", "C.UTF-8")):
        folder = tmp_path / name
        folder.mkdir()
        subprocess.run(
            [sys.executable, "-c", script.format([str(ROOT / "tests"), str(ROOT)], str(folder / "out"))],
            cwd=folder,
            env=os.environ | {"LC_ALL": locale, "PYTHONHASHSEED": str(len(name))},
            check=True,
        )
        made.append((folder / "out" / "sampled_toy.fmu").read_bytes())
    assert made[0] == made[1]


@pytest.mark.long
def test_a_cold_compiler_cache_gives_the_same_library(
    tmp_path: Path, unpacked: Path_of, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(native, "cache_folder", lambda: tmp_path / "cache")
    export(feedthrough_toy(), tmp_path)
    folder = Path(fmpy.extract(str(tmp_path / "feedthrough_toy.fmu"), str(tmp_path / "unpacked")))
    assert library(folder).read_bytes() == library(unpacked("feedthrough_toy")).read_bytes()


def test_the_archive_holds_what_an_fmu_should(built: Path_of) -> None:
    with zipfile.ZipFile(built("duffing")) as archive:
        names = archive.namelist()
        assert names == sorted(names)
        assert {info.date_time for info in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        assert {"modelDescription.xml", "model.png", "documentation/index.html", "sources/functions.c"} < set(names)
        assert {f"sources/{name}" for name in FMI_HEADERS} < set(names)
        assert archive.read("documentation/licenses/observer-fmus.txt") == (ROOT / "LICENSE").read_bytes()
        assert archive.read("model.png").startswith(b"\x89PNG")
        page = archive.read("documentation/index.html").decode()
    assert "<svg" in page and "src=" not in page and "http://www.w3.org" in page
    assert all(port in page for port in ("parameter.theta_jump_time[1]", "sensor.noise_bound", "x.theta"))
    assert "[0, 1048576]" in page  # of the seed


def test_the_page_shows_truth_values_as_such(tmp_path: Path) -> None:
    toy = sampled_toy()
    flag = Port("valid", "counts y?", kind="Boolean", start=1.0, variability="discrete")
    with zipfile.ZipFile(export(dataclasses.replace(toy, inputs=(toy.inputs[0], flag)), tmp_path)) as archive:
        page = archive.read("documentation/index.html").decode()
    assert "<td>Boolean</td><td class=n>true</td><td class=n></td><td>counts y?</td>" in page


def test_the_page_of_a_driven_component_shows_plant_and_estimate(tmp_path: Path) -> None:
    toy = sampled_toy()
    z, u, p, t, h = ca.SX.sym("z", 1), ca.SX(0, 1), ca.SX(0, 1), ca.SX.sym("t"), ca.SX.sym("h")
    source = Component(
        name="source",
        description="A level that rises",
        start=ca.Function("start", [p, t], [t]),
        flow=ca.Function("flow", [z, u, p, t, h], [z + h]),
        output=ca.Function("output", [z, u, p, t], [ca.vertcat(z, z)]),
        outputs=tuple(dataclasses.replace(toy.outputs[0], name=name) for name in ("y", "x.level")),
    )
    with zipfile.ZipFile(export(toy, tmp_path, driven_by=source)) as archive:
        page = archive.read("documentation/index.html").decode()
    assert "driven by the plant source" in page
    assert ">plant<" in page and ">estimate<" in page


def test_the_sources_compile_by_themselves_to_the_same_results(built: Path_of, tmp_path: Path) -> None:
    folder = Path(fmpy.extract(str(built("duffing")), str(tmp_path)))
    binary = library(folder)
    description = etree.parse(folder / "modelDescription.xml")
    files = [element.get("name") for element in description.iter("File")]
    assert files == sorted(path.name for path in (folder / "sources").glob("*.c"))
    expected = fmpy.simulate_fmu(str(built("duffing")), stop_time=5.0, output_interval=0.1)
    command = [
        sys.executable,
        "-m",
        "ziglang",
        "cc",
        "-std=c99",
        "-O1",
        "-ffp-contract=off",
        "-fPIC",
        "-shared",
        *files,
    ]
    cache = str(native.cache_folder())
    environment = os.environ | {"ZIG_GLOBAL_CACHE_DIR": cache, "ZIG_LOCAL_CACHE_DIR": cache}
    subprocess.run([*command, "-o", binary, "-lm"], cwd=folder / "sources", env=environment, check=True)
    assert (fmpy.simulate_fmu(str(folder), stop_time=5.0, output_interval=0.1) == expected).all()


def test_c_that_casadi_cannot_write_is_refused_by_name(tmp_path: Path) -> None:
    toy = feedthrough_toy()
    z, u, p, t = ca.MX.sym("z", 0), ca.MX.sym("u", 1), ca.MX.sym("p", 2), ca.MX.sym("t")
    x, a = ca.MX.sym("x"), ca.MX.sym("a")
    root = ca.rootfinder("root", "newton", ca.Function("residual", [x, a], [x**3 + x - a]))
    bad = dataclasses.replace(toy, output=ca.Function("output", [z, u, p, t], [ca.vertcat(root(0, u[0]), p[1])]))
    with pytest.raises(ExportError, match=r"'feedthrough_toy'.*'output'.*[Nn]ewton"):
        export(bad, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_compiler_error_is_an_export_error_with_its_words(tmp_path: Path) -> None:
    (tmp_path / "broken.c").write_text("int f(void) { return nothing; }\n")
    with pytest.raises(ExportError, match=r"(?s)'broken'.*linux64.*nothing"):
        native.compile_library("broken", tmp_path, "linux64")


@pytest.mark.parametrize(
    ("platforms", "words"), [(["beos"], "'beos' is unknown; known: host, all"), ([], "no platform")]
)
def test_unknown_platforms_are_named(tmp_path: Path, platforms: list[str], words: str) -> None:
    with pytest.raises(ExportError, match=words):
        export(feedthrough_toy(), tmp_path, platforms=platforms)


def test_an_interrupted_write_leaves_the_old_fmu_and_no_half_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = export(growing_toy(), tmp_path)
    before = path.read_bytes()

    def full(*_: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(zipfile.ZipFile, "writestr", full)
    with pytest.raises(OSError, match="no space"):
        export(growing_toy(), tmp_path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["growing_toy.fmu"]
    assert path.read_bytes() == before


# What a library's header says of its processor: ELF's e_machine, PE's Machine, Mach-O's cputype.
PROCESSORS = {
    "linux64": b"\x3e\x00",
    "win64": b"\x64\x86",
    "darwin64": b"\x07\x00\x00\x01",
    "aarch64-linux": b"\xb7\x00",
    "aarch64-darwin": b"\x0c\x00\x00\x01",
}


def processor(content: bytes) -> bytes:
    """The field of PROCESSORS in a shared library of one of the three formats."""
    if content.startswith(b"\x7fELF"):
        return content[18:20]
    if content.startswith(b"MZ"):
        header = int.from_bytes(content[0x3C:0x40], "little")
        assert content[header : header + 4] == b"PE\0\0"
        return content[header + 4 : header + 6]
    assert content.startswith(b"\xcf\xfa\xed\xfe")
    return content[4:8]


# The oldest macOS that each library says it runs on.
MACOS = {"darwin64": "10.13.0", "aarch64-darwin": "11.0.0"}


def mach_o(path: Path) -> tuple[str, bool]:
    """Of a Mach-O library: the macOS that it was built for, and whether it is signed, as Apple silicon demands."""
    commands = {load.cmd: command for load, command, _ in MachO(str(path)).headers[0].commands}
    built = commands.get(LC_BUILD_VERSION) or commands[LC_VERSION_MIN_MACOSX]
    version = int(built.minos if LC_BUILD_VERSION in commands else built.version)
    return f"{version >> 16}.{version >> 8 & 255}.{version & 255}", LC_CODE_SIGNATURE in commands


@pytest.mark.long
def test_one_fmu_holds_every_platform_and_the_sources_and_compiles_reproducibly(tmp_path: Path) -> None:
    paths = [export(growing_toy(), tmp_path / name, platforms=("all",)) for name in ("one", "two")]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    with zipfile.ZipFile(paths[0]) as archive:
        binaries = {name.split("/")[1]: name for name in archive.namelist() if name.startswith("binaries/")}
        folder = Path(archive.extract("modelDescription.xml", tmp_path)).parent
        archive.extractall(folder)
    assert set(binaries) == set(PLATFORMS) == set(PROCESSORS)
    wanted = functions("CoSimulation")
    for platform, name in binaries.items():
        assert Path(name).stem == "growing_toy"
        content = (folder / name).read_bytes()
        assert Path(name).suffix == PLATFORMS[platform].suffix
        assert processor(content) == PROCESSORS[platform], platform
        assert all(function.encode() + b"\0" in content for function in wanted), platform
        if platform in MACOS:
            version, signed = mach_o(folder / name)
            assert version == MACOS[platform] and (signed or platform == "darwin64")
    exported, needed, versions = elf(str(folder / binaries["aarch64-linux"]))
    assert exported == wanted and max(versions) <= (2, 17)
    assert needed <= {"libc.so.6", "libm.so.6", "ld-linux-aarch64.so.1"}
    assert {path.name for path in (folder / "sources").glob("*.c")} >= {"functions.c", "component.c", "stepping.c"}
