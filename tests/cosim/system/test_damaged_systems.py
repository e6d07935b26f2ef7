"""Damaged .ssp files and FMUs: read, or refused in one line; never another exception, never a file outside of the folder."""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import strict_fmu
from cosim import archive
from cosim.errors import ExperimentError, SystemFileError
from cosim.master.run import prepare
from cosim.system import read_ssp
from cosim.system.ssp_files import STRUCTURE
from ssp_text import UNITS, binding, component, connection, connector, mapped, pack, parameter_set, ssd

Strict = Callable[..., Path]
FMU, VALUES = "resources/a.fmu", "resources/p.ssv"


def contents() -> dict[str, bytes]:
    """A system with a bit of everything; its FMU has a binary that is none."""
    ports = (
        connector("u", "input", '<ssc:Real unit="km"/>')
        + connector("y", "output")
        + connector("m", "output", "<ssc:Integer/>")
    )
    ports += connector("n", "input", "<ssc:Integer/>")
    values = binding({"u": '<ssv:Real value="2" unit="km"/>'}, UNITS.replace("ssd:Units", "ssv:Units"))
    doubled = connection("in", "b.u", '<ssc:LinearTransformation factor="2"/>')
    inner = (
        f"<ssd:Connectors>{connector('in', 'input')}</ssd:Connectors><ssd:Elements>{component('b', 'a.fmu', ports)}</ssd:Elements>"
        f"<ssd:Connections>{doubled}</ssd:Connections>"
    )
    structure = ssd(
        f"<ssd:Connectors>{connector('way', 'output')}</ssd:Connectors><ssd:Elements>"
        + component("a", "a.fmu", ports, values + '<ssd:ParameterBinding source="resources/p.ssv" prefix=""/>')
        + f'<ssd:System name="inner">{inner}</ssd:System></ssd:Elements><ssd:Connections>'
        + connection("a.y", "inner.in")
        + connection("a.m", "a.n", mapped("Integer", "1", "2"))
        + connection("a.y", "way")
        + "</ssd:Connections>"
    )
    fmu = io.BytesIO()
    with zipfile.ZipFile(fmu, "w") as written:
        written.writestr("modelDescription.xml", strict_fmu.description("m", "m", dependencies=False))
        written.writestr(f"binaries/{strict_fmu.HOST}/strict.so", b"none")
    return {
        STRUCTURE: structure.encode(),
        FMU: fmu.getvalue(),
        VALUES: parameter_set({"gain": '<ssv:Real value="3"/>', "n": '<ssv:Integer value="1"/>'}).encode(),
    }


def packed(members: dict[str, bytes], compression: int) -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", compression) as written:
        for name, content in members.items():
            written.writestr(name, content)
    return made.getvalue()


def mutated(content: bytes, places: list[tuple[float, int, bytes]]) -> bytes:
    """`content` with, at each place (a fraction of its length), some bytes left out and others put in."""
    for where, gone, new in places:
        at = int(where * len(content))
        content = content[:at] + new + content[at + gone :]
    return content


def read_or_refuse(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as outer:
        path, inside = Path(outer) / "x.ssp", Path(outer) / "inside"
        path.write_bytes(content)
        try:
            prepare(read_ssp(path, inside), inside)
        except (SystemFileError, ExperimentError) as error:
            assert len(str(error).splitlines()) == 1, error
        assert {found.name for found in Path(outer).iterdir()} <= {"x.ssp", "inside"}


# New bytes are what does harm: markup, numbers, names that lead elsewhere, or anything.
NEW = st.one_of(
    st.binary(max_size=4),
    st.sampled_from(
        [b"<", b'"', b"&x;", b"-1", b"1e999", b"NaN", b"../", b"\0", b"99999999999", b"a", b".", b'="', b"/>"]
    ),
)
PLACES = st.lists(st.tuples(st.floats(0, 1), st.integers(0, 12), NEW), min_size=1, max_size=4)
SETTINGS = settings(max_examples=150, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])


@SETTINGS
@given(PLACES, st.sampled_from([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA]))
def test_bytes_of_the_file(places: list[tuple[float, int, bytes]], compression: int) -> None:
    read_or_refuse(mutated(packed(contents(), compression), places))


@SETTINGS
@given(PLACES, st.sampled_from([STRUCTURE, VALUES]))
@example([(0.5, 0, b"\0")], STRUCTURE)
def test_bytes_of_a_member(places: list[tuple[float, int, bytes]], member: str) -> None:
    members = contents()
    members[member] = mutated(members[member], places)
    read_or_refuse(packed(members, zipfile.ZIP_STORED))


@SETTINGS
@given(PLACES)
def test_bytes_of_an_fmus_description(places: list[tuple[float, int, bytes]]) -> None:
    members, fmu = contents(), io.BytesIO()
    with zipfile.ZipFile(fmu, "w") as written:
        written.writestr("modelDescription.xml", mutated(strict_fmu.description().encode(), places))
    members[FMU] = fmu.getvalue()
    read_or_refuse(packed(members, zipfile.ZIP_STORED))


def test_the_undamaged_file_is_read() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.ssp"
        path.write_bytes(packed(contents(), zipfile.ZIP_DEFLATED))
        resolved = prepare(path, Path(folder)).resolved
    assert resolved.parameters["a"] == {"u": 2000.0, "gain": 3.0, "n": 1}
    assert len(resolved.connections) == 2 and resolved.exposures[0].connector == "way"


def test_a_file_that_inflates_beyond_the_limit_is_refused_before_it_does(
    strict: Strict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = ssd(f"<ssd:Elements>{component('a', 'a.fmu')}</ssd:Elements>")
    fmu = strict()
    with zipfile.ZipFile(fmu, "a", zipfile.ZIP_DEFLATED) as written:
        written.writestr("resources/zeros", bytes(10**7))
    assert fmu.stat().st_size < 10**6
    monkeypatch.setattr(archive, "LARGEST", 5 * 10**6)
    path = pack(tmp_path / "x.ssp", content, {"a.fmu": fmu})
    with pytest.raises(SystemFileError, match=r"x\.ssp: resources/a\.fmu: 0\.0093\d GiB when inflated, more than"):
        prepare(path, tmp_path / "out")
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as written:
        written.writestr("zeros", bytes(10**7))
    with pytest.raises(SystemFileError, match=r"x\.ssp: 0\.0\d+ GiB when inflated"):
        read_ssp(path, tmp_path / "out")
    monkeypatch.setattr(archive, "LARGEST", 10**9)
    monkeypatch.setattr(archive, "LARGEST_XML", 1000)
    with pytest.raises(SystemFileError, match=r"SystemStructure\.ssd has 0 MiB, more than 0 MiB"):
        read_ssp(path, tmp_path / "out")


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="Linux tells there how much memory was taken")
@pytest.mark.parametrize("unit", ["<a/>", '<a b="c" d="e" f="" g="" h="" i=""/>'])
@pytest.mark.parametrize("count", [2.9e6, 4e7])
def test_an_xml_file_of_very_many_tags_takes_less_than_a_gigabyte(unit: str, count: float, tmp_path: Path) -> None:
    marks = unit.count("<") + unit.count("=")
    path = tmp_path / "x.ssp"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as written, written.open(STRUCTURE, "w") as file:
        file.write(b"<x>")
        for _ in range(int(count / marks / 10_000)):
            file.write(unit.encode() * 10_000)
        file.write(b"</x>")
    script = (
        "import sys\nfrom pathlib import Path\nfrom cosim.errors import SystemFileError\n"
        "from cosim.system import read_ssp\ntry:\n    read_ssp(Path(sys.argv[1]), Path(sys.argv[2]))\n"
        "except SystemFileError as error:\n    print(error)\n"
        # Not getrusage's: that of a process which forks counts for its child, too.
        "print(Path('/proc/self/status').read_text().split('VmHWM:')[1].split()[0])"
    )
    command = [sys.executable, "-c", script, str(path), str(tmp_path / "out")]
    message, peak = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert message.startswith(f"{path}: SystemStructure.ssd") and int(peak) * 1024 < 2**30


def test_entities_and_paths_in_a_models_name_are_refused(strict: Strict, tmp_path: Path) -> None:
    bomb = '<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]>' + "<x>&b;</x>"
    with pytest.raises(SystemFileError, match="has a document type"):
        read_ssp(pack(tmp_path / "x.ssp", bomb, {}), tmp_path / "out")
    fmu = tmp_path / "path.fmu"
    with zipfile.ZipFile(fmu, "w") as written:
        text = strict_fmu.description().replace('modelIdentifier="strict"', 'modelIdentifier="../../strict"')
        written.writestr("modelDescription.xml", text)
    content = ssd(f"<ssd:Elements>{component('a', 'path.fmu')}</ssd:Elements>")
    with pytest.raises(SystemFileError, match=r"the modelIdentifier '\.\./\.\./strict' is no C identifier"):
        prepare(pack(tmp_path / "y.ssp", content, {"path.fmu": fmu}), tmp_path / "out")
