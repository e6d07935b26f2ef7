"""Systems in the structure of other tools' demonstrations: we agree with Ecos and libcosim where these know what SSP says.

Structures that they do not know are compared with the same system written out flat, which they run.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cosim.master import watched
from cosim.masters import process
from cosim.masters.experiment import MasterError, Recording
from ssp_text import ROOT, UNITS, binding, component, connection, connector, mapped, pack, parameter_set, ssd, system
from strict_fmu import FAILURES

Strict = Callable[..., Path]
PORTS = connector("u", "input") + connector("y", "output") + connector("gain", "parameter")
TOOLS = ("ecos", "libcosim")


def reals(**values: float) -> str:
    return binding({name: f'<ssv:Real value="{value}"/>' for name, value in values.items()})


@pytest.fixture
def fmus(strict: Strict, built: Callable[[str], Path]) -> dict[str, Path]:
    return {
        "silent.fmu": strict("silent", dependencies=False),
        "m.fmu": strict("m", unit_in="m", unit_out="m"),
        "km.fmu": strict("km", unit_in="km", unit_out="km"),
        "duffing.fmu": built("duffing"),
    }


def ours(path: Path) -> Recording:
    result = watched.run(path)
    return {name: result[name] for name in ("time", *result.names)}


def agree(one: Recording, other: Recording, first: int = 0, names: dict[str, str] | None = None) -> None:
    """The columns that both have, or `names` of `one` by those of `other`, are equal from row `first` on."""
    pairs = names or {name: name for name in other if name in one and name != "time"}
    assert pairs
    for theirs, name in pairs.items():
        np.testing.assert_array_equal(one[name][first:], other[theirs][first:], err_msg=name)


CHAIN = system(
    component("a", "silent.fmu", PORTS, reals(u=1.5, gain=0.5)) + component("b", "silent.fmu", PORTS, reals(gain=-2.0)),
    connection("a.y", "b.u"),
)
LOOP = system(
    component("plant", "duffing.fmu", connector("u", "input") + connector("y", "output"))
    + component("gain", "silent.fmu", PORTS, reals(gain=-0.5)),
    connection("plant.y", "gain.u") + connection("gain.y", "plant.u"),
)
SCALED = CHAIN.replace(
    connection("a.y", "b.u"), connection("a.y", "b.u", '<ssc:LinearTransformation factor="2" offset="1"/>')
)
FILE = system(component("a", "silent.fmu", PORTS, '<ssd:ParameterBinding source="resources/p.ssv"/>'))


@pytest.mark.usefixtures("other_masters")
@pytest.mark.parametrize("content", [CHAIN, LOOP, SCALED, FILE], ids=["chain", "loop", "scaled", "file"])
def test_feedthrough_without_dependencies_transformations_and_files_give_the_same_bits(
    content: str, fmus: dict[str, Path], tmp_path: Path
) -> None:
    values = parameter_set({"u": '<ssv:Real value="3"/>', "gain": '<ssv:Real value="0.25"/>'})
    path = pack(tmp_path / "x.ssp", ssd(content, more=""), fmus, {"resources/p.ssv": values})
    own = ours(path)
    agree(own, process.record("libcosim", path))
    theirs = process.record("ecos", path)
    # Ecos passes no values on in initialization mode: its first row may differ. What it shows of an output with direct
    # feedthrough is of the inputs that it has just set.
    agree(own, {name: column for name, column in theirs.items() if not name.startswith("gain.")}, first=1)


@pytest.mark.usefixtures("other_masters")
def test_nested_mapped_in_units_and_with_connectors_is_the_flat_system_with_factors(
    fmus: dict[str, Path], tmp_path: Path
) -> None:
    entry = '<ssm:MappingEntry source="length" target="u"/>'
    mapping = f'<ssd:ParameterMapping><ssm:ParameterMapping {ROOT} version="1.0">{entry}</ssm:ParameterMapping></ssd:ParameterMapping>'
    length = binding({"length": '<ssv:Real value="2500" unit="m"/>'}, UNITS.replace("ssd:Units", "ssv:Units"), mapping)
    inner = system(
        component("b", "m.fmu", PORTS, reals(gain=3.0)),
        connection("in", "b.u", '<ssc:LinearTransformation factor="-1"/>') + connection("b.y", "out"),
        connector("in", "input", '<ssc:Real unit="km"/>') + connector("out", "output"),
    )
    nested = system(
        component("a", "km.fmu", PORTS, length)
        + f'<ssd:System name="inner">{inner}</ssd:System>'
        + component("c", "km.fmu", PORTS),
        connection("a.y", "inner.in") + connection("inner.out", "c.u") + connection("c.y", "reach"),
        connector("reach", "output", '<ssc:Real unit="m"/>'),
    )
    flat = system(
        component("a", "km.fmu", PORTS, reals(u=2.5))
        + component("b", "m.fmu", PORTS, reals(gain=3.0))
        + component("c", "km.fmu", PORTS),
        connection("a.y", "b.u", '<ssc:LinearTransformation factor="-1000"/>')
        + connection("b.y", "c.u", '<ssc:LinearTransformation factor="0.001"/>'),
    )
    own = ours(pack(tmp_path / "nested.ssp", ssd(nested), fmus))
    path = pack(tmp_path / "flat.ssp", ssd(flat, more=""), fmus)
    names = {"a.y": "a.y", "b.y": "inner.b.y", "c.y": "c.y"}
    agree(own, process.record("libcosim", path), names=names)
    agree(own, process.record("ecos", path), first=2, names=names)
    np.testing.assert_array_equal(own["reach"], 1000 * own["c.y"])
    assert own["c.y"][-1] == -7.5


@pytest.mark.usefixtures("other_masters")
@pytest.mark.parametrize("tool", TOOLS)
def test_ecos_and_libcosim_convert_no_units_and_know_no_tables_and_mappings(
    tool: str, fmus: dict[str, Path], tmp_path: Path
) -> None:
    integers = connector("m", "output", "<ssc:Integer/>") + connector("n", "input", "<ssc:Integer/>")
    three = binding({"n": '<ssv:Integer value="3"/>'})
    entry = '<ssm:MappingEntry source="x" target="u"/>'
    mapping = f'<ssd:ParameterMapping><ssm:ParameterMapping {ROOT} version="1.0">{entry}</ssm:ParameterMapping></ssd:ParameterMapping>'
    cases = {
        "b.y": (
            system(
                component("a", "km.fmu", PORTS, reals(u=3.0)) + component("b", "m.fmu", PORTS), connection("a.y", "b.u")
            ),
            3000,
            3,
        ),
        "b.m": (
            system(
                component("a", "m.fmu", integers, three) + component("b", "m.fmu", integers),
                connection("a.m", "b.n", mapped("Integer", "3", "7")),
            ),
            7,
            3,
        ),
        "a.y": (
            system(component("a", "m.fmu", PORTS, binding({"x": '<ssv:Real value="3"/>'}, mapping=mapping))),
            3,
            0,
        ),
    }
    for column, (content, right, theirs) in cases.items():
        path = pack(tmp_path / "x.ssp", ssd(content), fmus)
        assert (ours(path)[column][-1], process.record(tool, path)[column][-1]) == (right, theirs), column


@pytest.mark.usefixtures("other_masters")
@pytest.mark.parametrize("tool", TOOLS)
def test_a_step_that_never_ends_ends_the_other_tool_too(tool: str, fmus: dict[str, Path], tmp_path: Path) -> None:
    failing = binding({"failure": f'<ssv:Integer value="{FAILURES.index("endless")}"/>'})
    path = pack(tmp_path / "x.ssp", ssd(system(component("a", "m.fmu", PORTS, failing)), more=""), fmus)
    with pytest.raises(MasterError, match=f"{tool}: a step, or what comes before the first, has not returned for 3 s"):
        process.record(tool, path, 3.0)


@pytest.mark.usefixtures("other_masters")
@pytest.mark.parametrize(
    ("tool", "connectors", "nested"),
    [("ecos", "No element named: a", "No element named: inner"), ("libcosim", "endElement", "source")],
)
def test_ecos_and_libcosim_refuse_connectors_of_the_system_and_systems_in_systems(
    tool: str, connectors: str, nested: str, fmus: dict[str, Path], tmp_path: Path
) -> None:
    content = system(component("a", "m.fmu", PORTS), connection("a.y", "out"), connector("out", "output"))
    inner = f'<ssd:System name="inner">{content}</ssd:System>' + component("b", "m.fmu", PORTS)
    for text, reason in ((content, connectors), (system(inner, connection("inner.out", "b.u")), nested)):
        path = pack(tmp_path / "x.ssp", ssd(text, more=""), fmus)
        ours(path)
        with pytest.raises(MasterError, match=reason):
            process.record(tool, path)
