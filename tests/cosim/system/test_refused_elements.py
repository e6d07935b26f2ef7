"""What SSP 1.0 has and our master has not is refused by name; connections that cannot be are too (docs/masters.md, element by element)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from cosim.errors import SystemFileError
from cosim.master import run
from cosim.system import read_ssp, ssp_files, ssp_structure
from ssp_text import binding, component, connection, connector, pack, ssd, system

Strict = Callable[..., Path]
Y, U = connector("y", "output"), connector("u", "input")


@pytest.fixture
def fmus(strict: Strict) -> dict[str, Path]:
    return {"m.fmu": strict("m", unit_in="m", unit_out="m")}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (component("a", "m.fmu", connector("u", "output")), "connector 'u' is of the kind output, the FMU's variable of input"),
        (component("a", "m.fmu", connector("u", "input", "<ssc:Integer/>")), "of the type Integer, the FMU's variable of Real"),
        (component("a", "m.fmu", connector("v", "input")), "its FMU has no variable 'v' for the connector"),
        (component("a", "m.fmu", connector("u", "input", '<ssc:Real unit="ell"/>')), "the unit 'ell' is not defined in the file"),
        (component("a", "m.fmu", bindings='<ssd:ParameterBinding source="gone.ssv"/>'), "'gone.ssv' is not in it"),
        (component("a", "m.fmu", bindings='<ssd:ParameterBinding sourceBase="component" source="x.ssv"/>'), "inside a component are not"),
        (component("a", "m.fmu", bindings='<ssd:ParameterBinding type="text/x-cdf" source="x.cdf"/>'), "of type text/x-cdf are not"),
        (component("a", "m.fmu", connector("u", "input", "<ssc:Binary/>")), "of the type Binary, the FMU's variable of Real"),
        (component("a", "m.fmu", bindings=binding({"u": '<ssv:Binary value="00"/>'})), "binary parameters are not supported"),
        (component("a", "m.fmu", kind="application/x-other"), "element 'a' is no FMU and no system (application/x-other)"),
        ('<ssd:SignalDictionaryReference name="bus" dictionary="d"/>', "a SignalDictionaryReference is not supported"),
    ],
)  # fmt: skip
def test_what_is_not_supported_is_refused_by_name(
    fmus: dict[str, Path], tmp_path: Path, content: str, message: str
) -> None:
    with pytest.raises(SystemFileError) as caught:
        run(pack(tmp_path / "x.ssp", ssd(system(content)), fmus))
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("connections", "message"),
    [
        (connection("in", "out"), "connection in -> out: from the system's input straight to its output"),
        (connection("a.y", "a.y2"), "connection a.y -> a.y2: element 'a' has no variable 'y2'"),
        (connection("a.u", "in"), None),
        (connection("out", "in"), "connection in -> out: from the system's input straight"),
        (connection("in", "a.u") + connection("a.y", "a.u"), "input 'a.u' is driven by 'in' and by 'a.y'"),
        (connection("im", "a.u"), "the system has no connector 'im'; did you mean 'in'"),
        (connection("b.y", "a.u"), "there is no element 'b'"),
        (connection("made", "a.u"), "'made' is of the kind calculatedParameter, not supported"),
        (connection("both", "a.u"), "'both' is of the kind inout, not supported"),
        (
            connection("text", "a.u"),
            "connection text -> a.u: the connector 'text' is of the type String, the variable of Real",
        ),
    ],
)
def test_connections_between_connectors_that_do_not_fit_are_refused(
    fmus: dict[str, Path], tmp_path: Path, connections: str, message: str | None
) -> None:
    own = connector("in", "input") + connector("out", "output") + connector("made", "calculatedParameter")
    own += connector("both", "inout") + connector("text", "input", "<ssc:String/>")
    path = pack(tmp_path / "x.ssp", ssd(system(component("a", "m.fmu", U + Y), connections, own)), fmus)
    if message is None:
        run(path)  # the direction is that of the connectors
        return
    with pytest.raises(SystemFileError) as caught:
        run(path)
    assert message in str(caught.value)


def test_signal_dictionaries_are_refused(fmus: dict[str, Path], tmp_path: Path) -> None:
    dictionary = '<ssd:SignalDictionaries><ssd:SignalDictionary name="bus" source="bus.ssb"/></ssd:SignalDictionaries>'
    text = ssd(system(component("a", "m.fmu")) + dictionary)
    with pytest.raises(SystemFileError, match=r"line \d+: SignalDictionaries are not supported"):
        run(pack(tmp_path / "x.ssp", text, fmus))


def test_systems_that_multiply_are_refused_before_they_fill_the_memory(
    fmus: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten times the next one in each of ten systems: ten thousand million elements in a file of a few lines."""
    monkeypatch.setattr(ssp_structure, "MOST_ELEMENTS", 1000)
    levels = ""
    for level in range(10):
        inner = "".join(component(f"e{i}", "", kind="application/x-ssp-definition") for i in range(10))
        inner = inner.replace('source="resources/"', f'source="#s{level + 1}"')
        levels += f'<ssd:System name="s{level}" id="s{level}"><ssd:Elements>{inner}</ssd:Elements></ssd:System>'
    last = f'<ssd:System name="s10" id="s10"><ssd:Elements>{component("a", "m.fmu")}</ssd:Elements></ssd:System>'
    with pytest.raises(SystemFileError, match="more than 1000 elements, those of nested systems included"):
        run(pack(tmp_path / "x.ssp", ssd(f"<ssd:Elements>{levels}{last}</ssd:Elements>"), fmus))


def test_an_fmu_of_many_elements_is_unpacked_and_counted_once(
    fmus: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ssp_files, "LARGEST", fmus["m.fmu"].stat().st_size)
    content = "".join(component(f"e{i}", "m.fmu") for i in range(50))
    made = read_ssp(pack(tmp_path / "x.ssp", ssd(system(content)), fmus), tmp_path / "out")
    assert len(made.elements) == 50 and len({element.fmu for element in made.elements.values()}) == 1
