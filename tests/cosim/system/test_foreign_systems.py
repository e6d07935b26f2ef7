"""Systems of other tools: what SSP 1.0 has besides FMUs and connections, run with FMUs that pass on what they get.

Every FMU here gives out gain times its input a step later, so a value that has passed says what happened to it on the way.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cosim.errors import ExperimentError, SystemFileError
from cosim.master import run
from cosim.results import write_columns
from cosim.system import read_ssp
from ssp_text import ROOT, UNITS, binding, component, connection, connector, mapped, pack, parameter_set, ssd, system

Strict = Callable[..., Path]
M, KM, S = ('<ssc:Real unit="m"/>', '<ssc:Real unit="km"/>', '<ssc:Real unit="s"/>')
REAL = '<ssv:Real value="{}"/>'


@pytest.fixture
def fmus(strict: Strict) -> dict[str, Path]:
    """From metres to metres, to and from kilometres, seconds, and without units."""
    made = {
        "m.fmu": strict("m", unit_in="m", unit_out="m"),
        "km.fmu": strict("km", unit_in="km", unit_out="km"),
        "s.fmu": strict("s", unit_in="s", unit_out="s"),
        "degC.fmu": strict("degC", unit_in="degC", unit_out="degC"),
        "degF.fmu": strict("degF", unit_in="degF", unit_out="degF"),
        "plain.fmu": strict("plain"),
    }
    return made


def nested(name: str, content: str) -> str:
    return f'<ssd:System name="{name}">{content}</ssd:System>'


Y, U = connector("y", "output"), connector("u", "input")
FIVE = binding({"u": REAL.format(5)})


@pytest.mark.parametrize(
    ("source", "target", "value", "expected"),
    [
        ("m", "m", 5, 5),
        ("km", "m", 5, 5000),
        ("m", "km", 5, 0.005),
        ("degC", "degF", 20, 68),
        ("degF", "degC", 68, 20),
        ("plain", "km", 5, 5),
        ("km", "plain", 5, 5),
    ],
)
def test_units_of_connected_variables_are_converted(
    fmus: dict[str, Path], tmp_path: Path, source: str, target: str, value: float, expected: float
) -> None:
    given = binding({"u": REAL.format(value)})
    elements = component("a", f"{source}.fmu", Y, given) + component("b", f"{target}.fmu", U)
    result = run(pack(tmp_path / "x.ssp", ssd(system(elements, connection("a.y", "b.u"))), fmus))
    np.testing.assert_allclose(result["b.y"], expected, rtol=3e-15)


def test_suppressed_conversion_passes_the_number_and_incompatible_units_are_refused(
    fmus: dict[str, Path], tmp_path: Path
) -> None:
    for other, attributes, expected in (
        ("km", 'suppressUnitConversion="true"', 5),
        ("s", 'suppressUnitConversion="1"', 5),
    ):
        elements = component("a", f"{other}.fmu", Y, FIVE) + component("b", "m.fmu", U)
        made = system(elements, connection("a.y", "b.u", attributes=attributes))
        assert run(pack(tmp_path / "x.ssp", ssd(made), fmus))["b.y"][-1] == expected
    elements = component("a", "s.fmu", Y, FIVE) + component("b", "m.fmu", U)
    with pytest.raises(SystemFileError, match=r"connection a\.y -> b\.u: the units 's' and 'm' differ"):
        run(pack(tmp_path / "x.ssp", ssd(system(elements, connection("a.y", "b.u"))), fmus))


def test_a_connectors_unit_counts_where_the_fmu_has_none_and_is_converted_where_it_has_another(
    fmus: dict[str, Path], tmp_path: Path
) -> None:
    elements = component("a", "plain.fmu", connector("y", "output", KM), FIVE) + component(
        "b", "m.fmu", connector("u", "input", KM)
    )
    result = run(pack(tmp_path / "x.ssp", ssd(system(elements, connection("a.y", "b.u"))), fmus))
    assert result["b.y"][-1] == 5000


@pytest.mark.parametrize(
    ("start", "end", "inside", "attributes", "expected"),
    [
        ("a.y", "b.u", '<ssc:LinearTransformation factor="-2" offset="1"/>', "", -2 * 5000 + 1),
        ("a.y", "b.u", '<ssc:LinearTransformation factor="-2"/>', 'suppressUnitConversion="true"', -10),
        ("b.u", "a.y", '<ssc:LinearTransformation offset="1"/>', "", 5001),  # start and end say nothing of the direction
        ("a.m", "b.n", mapped("Integer", "3", "30"), "", 30),
        ("a.m", "b.n", mapped("Integer", "4", "30"), "", 3),
        ("a.c", "b.b", mapped("Boolean", "true", "false"), "", 0),
        ("a.f", "b.e", mapped("Enumeration", "open", "off"), "", 1),
        ("a.f", "b.e", mapped("Enumeration", "shut", "on"), "", 2),
    ],
)  # fmt: skip
def test_transformations_are_applied_after_the_conversion_of_units(
    fmus: dict[str, Path], tmp_path: Path, start: str, end: str, inside: str, attributes: str, expected: float
) -> None:
    values = {
        "u": REAL.format(5),
        "n": '<ssv:Integer value="3"/>',
        "b": '<ssv:Boolean value="true"/>',
        "e": '<ssv:Enumeration value="on"/>',
    }
    kinds = {"y": "Real", "m": "Integer", "c": "Boolean", "u": "Real", "n": "Integer", "b": "Boolean"}
    items = {"f": "Out", "e": "In"}

    def of(name: str, kind: str) -> str:
        return connector(
            name, kind, f"<ssc:{kinds[name]}/>" if name in kinds else f'<ssc:Enumeration name="{items[name]}"/>'
        )

    elements = component("a", "km.fmu", "".join(of(n, "output") for n in "ymcf"), binding(values))
    elements += component("b", "m.fmu", "".join(of(n, "input") for n in "unbe"))
    enumerations = (
        "<ssd:Enumerations>"
        + "".join(
            f'<ssc:Enumeration name="{n}"><ssc:Item name="{a}" value="1"/><ssc:Item name="{b}" value="2"/></ssc:Enumeration>'
            for n, a, b in (("In", "off", "on"), ("Out", "shut", "open"))
        )
        + "</ssd:Enumerations>"
    )
    made = ssd(system(elements, connection(start, end, inside, attributes)), enumerations + UNITS)
    shown = {"a.y": "b.y", "b.u": "b.y", "a.m": "b.m", "a.c": "b.c", "a.f": "b.f"}[start]
    assert run(pack(tmp_path / "x.ssp", made, fmus))[shown][-1] == expected


def test_a_transformation_that_does_not_fit_the_type_is_refused(fmus: dict[str, Path], tmp_path: Path) -> None:
    elements = component("a", "m.fmu", connector("m", "output", "<ssc:Integer/>"))
    elements += component("b", "m.fmu", connector("n", "input", "<ssc:Integer/>"))
    made = ssd(system(elements, connection("a.m", "b.n", '<ssc:LinearTransformation factor="2"/>')))
    with pytest.raises(SystemFileError, match="a transformation for Real meets the Integer 'n'"):
        run(pack(tmp_path / "x.ssp", made, fmus))


@pytest.fixture
def open_system(fmus: dict[str, Path], tmp_path: Path) -> Path:
    """An input in kilometres, through a component in metres, an output in kilometres; a parameter for two components."""
    connectors = connector("reach", "input", KM) + connector("way", "output", KM) + connector("amount", "parameter")
    elements = component("a", "m.fmu", U + Y + connector("gain", "parameter"))
    elements += component("b", "plain.fmu", U + Y + connector("gain", "parameter"))
    connections = (
        connection("reach", "a.u")
        + connection("a.y", "way", '<ssc:LinearTransformation factor="10"/>')
        + connection("amount", "a.gain")
        + connection("amount", "b.gain", '<ssc:LinearTransformation factor="2"/>')
    )
    return pack(tmp_path / "open.ssp", ssd(system(elements, connections, connectors)), fmus)


def test_connectors_of_the_system_take_values_and_are_recorded(open_system: Path) -> None:
    result = run(open_system, overrides={"reach": "3", "amount": 2.0, "b.u": 1.0})
    assert result["a.y"][-1] == 6000
    assert result["b.y"][-1] == 4
    assert result["way"][-1] == 60 and result.units["way"] == "km" and result.names[-1] == "way"
    with pytest.raises(ExperimentError, match=r"'a\.u' cannot be set: it is connected to 'reach'"):
        run(open_system, overrides={"a.u": 1.0})
    with pytest.raises(
        ExperimentError, match="'way' cannot be set: the connector, of the kind output, supplies nothing"
    ):
        run(open_system, overrides={"way": 1.0})


def test_an_input_file_drives_the_systems_inputs_and_unconnected_ones(open_system: Path, tmp_path: Path) -> None:
    times = np.array([0.0, 0.55, 1.0])
    write_columns({"time": times, "reach": times, "b.u": 2 * times, "other": times}, tmp_path / "drive.csv")
    result = run(open_system, inputs=tmp_path / "drive.csv")
    late = np.concatenate([[0.0], result.time[:-1]])
    np.testing.assert_allclose(result["a.y"], 1000 * late, rtol=1e-15)
    np.testing.assert_allclose(result["b.y"], 2 * late, rtol=1e-15)
    write_columns({"time": times / 2, "reach": times}, tmp_path / "short.csv")
    with pytest.raises(ExperimentError, match=r"short\.csv: holds times from 0 to 0\.5 s, the run goes from 0 to 1 s"):
        run(open_system, inputs=tmp_path / "short.csv")
    write_columns({"time": times, "other": times}, tmp_path / "none.csv")
    with pytest.raises(
        ExperimentError, match=r"none\.csv: no column feeds an input; there are reach, a\.n, a\.e, a\.b and 4 more"
    ):
        run(open_system, inputs=tmp_path / "none.csv")
    with pytest.raises(ExperimentError, match=r"nowhere\.csv: No such file"):
        run(open_system, inputs=tmp_path / "nowhere.csv")


def test_nested_systems_pass_values_through_their_connectors(fmus: dict[str, Path], tmp_path: Path) -> None:
    inner = nested(
        "inner",
        system(
            component("b", "m.fmu", U + Y),
            connection("in", "b.u", '<ssc:LinearTransformation offset="1"/>') + connection("b.y", "out"),
            connector("in", "input", M) + connector("out", "output"),
            binding({"in": REAL.format(7), "b.gain": REAL.format(3)}),
        ),
    )
    elements = component("a", "km.fmu", Y, FIVE) + inner + component("c", "km.fmu", U)
    made = system(elements, connection("a.y", "inner.in") + connection("inner.out", "c.u"))
    result = run(pack(tmp_path / "x.ssp", ssd(made), fmus))
    assert result["inner.b.y"][-1] == 3 * 5001 and result["c.y"][-1] == pytest.approx(15.003, rel=1e-15, abs=0)
    alone = run(pack(tmp_path / "y.ssp", ssd(system(inner)), fmus))
    assert alone["inner.b.y"][-1] == 3 * 8  # what is bound to a connector that nothing drives
    outer = system(inner, bindings=binding({"inner.in": REAL.format(9), "inner.b.gain": REAL.format(2)}))
    assert run(pack(tmp_path / "z.ssp", ssd(outer), fmus))["inner.b.y"][-1] == 20  # the outer binding counts


def test_systems_come_from_other_files_too(fmus: dict[str, Path], tmp_path: Path) -> None:
    inside = system(
        component("b", "m.fmu", U + Y),
        connection("in", "b.u") + connection("b.y", "out"),
        connector("in", "input", KM) + connector("out", "output"),
    )
    package = pack(tmp_path / "inner.ssp", ssd(inside), fmus).read_bytes()
    other = pack(tmp_path / "other.ssp", "<no/>", fmus, {"B.ssd": ssd(inside)}).read_bytes()
    definition = ssd(inside.replace("resources/", ""))
    more = {"resources/inner.ssp": package, "resources/other.ssp": other, "resources/inner.ssd": definition}
    for source, kind in (("inner.ssp", "package"), ("other.ssp#B.ssd", "package"), ("inner.ssd", "definition")):
        elements = component("part", source, bindings=binding({"in": REAL.format(2)}), kind=f"application/x-ssp-{kind}")
        result = run(pack(tmp_path / "x.ssp", ssd(system(elements)), fmus, more))
        assert result["part.b.y"][-1] == 2000, source
    twice = nested("first", inside).replace("<ssd:System ", '<ssd:System id="it" ', 1)
    twice += '<ssd:Component name="second" type="application/x-ssp-definition" source="#it"/>'
    both = run(pack(tmp_path / "x.ssp", ssd(system(twice, bindings=binding({"second.in": REAL.format(4)}))), fmus))
    assert (both["first.b.y"][-1], both["second.b.y"][-1]) == (0, 4000)


def test_a_package_that_holds_itself_is_refused(fmus: dict[str, Path], tmp_path: Path) -> None:
    content = ssd(system(component("part", "inner.ssp", kind="application/x-ssp-package")))
    package = b""
    for _ in range(18):
        package = pack(tmp_path / "inner.ssp", content, {}, {"resources/inner.ssp": package}).read_bytes()
    with pytest.raises(SystemFileError, match="element 'part' lies in more than 16 systems"):
        read_ssp(tmp_path / "inner.ssp", tmp_path / "out")
    own = '<ssd:Elements><ssd:Component name="a" type="application/x-ssp-definition" source="#top"/></ssd:Elements>'
    with pytest.raises(SystemFileError, match="the system 'top' holds itself"):
        read_ssp(pack(tmp_path / "x.ssp", ssd(own, attributes='id="top"'), fmus), tmp_path / "out")


@pytest.mark.parametrize(
    ("unit", "fmu", "expected"), [("km", "m", 2000), ("m", "m", 2), ("km", "plain", 2), ("s", "m", None)]
)
def test_values_of_parameters_are_converted(
    fmus: dict[str, Path], tmp_path: Path, unit: str, fmu: str, expected: float | None
) -> None:
    units = UNITS.replace("ssd:Units", "ssv:Units")
    elements = component("a", f"{fmu}.fmu", bindings=binding({"u": f'<ssv:Real value="2" unit="{unit}"/>'}, units))
    path = pack(tmp_path / "x.ssp", ssd(system(elements)), fmus)
    if expected is None:
        with pytest.raises(SystemFileError, match="parameters of 'a': the units 's' and 'm' differ"):
            run(path)
    else:
        assert run(path)["a.y"][-1] == expected


def test_names_that_a_component_does_not_have_are_left_out_with_a_note(fmus: dict[str, Path], tmp_path: Path) -> None:
    shared = parameter_set({"u": REAL.format(1.5), "wheel.radius": REAL.format(0.3)})
    by_component = system(component("a", "m.fmu", bindings='<ssd:ParameterBinding source="fleet.ssv"/>'))
    by_system = system(component("a", "m.fmu"), bindings='<ssd:ParameterBinding source="fleet.ssv" prefix="a."/>')
    elsewhere = system(
        component("a", "m.fmu"), bindings=binding({"a.u": REAL.format(1.5), "wheel.radius": REAL.format(1)})
    )
    for made in (by_component, by_system, elsewhere):
        result = run(pack(tmp_path / "x.ssp", ssd(made), fmus, {"fleet.ssv": shared}))
        assert result["a.y"][-1] == 1.5
        (note,) = result.notes
        assert "wheel.radius" in note and "left out" in note


def test_a_mapping_renames_and_transforms_and_leaves_out_the_rest(fmus: dict[str, Path], tmp_path: Path) -> None:
    entries = (
        '<ssm:MappingEntry source="p.length" target="u"><ssc:LinearTransformation factor="2"/></ssm:MappingEntry>'
        '<ssm:MappingEntry source="p.raw" target="gain" suppressUnitConversion="true"/>'
    )
    mapping = f'<ssm:ParameterMapping {ROOT} version="1.0">{entries}</ssm:ParameterMapping>'
    values = {
        "length": '<ssv:Real value="3" unit="km"/>',
        "raw": '<ssv:Real value="4" unit="km"/>',
        "n": '<ssv:Integer value="9"/>',
    }
    units = UNITS.replace("ssd:Units", "ssv:Units")
    for how in (f"<ssd:ParameterMapping>{mapping}</ssd:ParameterMapping>", '<ssd:ParameterMapping source="it.ssm"/>'):
        elements = component("a", "m.fmu", bindings=binding(values, units, how, 'prefix="p."'))
        result = run(pack(tmp_path / "x.ssp", ssd(system(elements)), fmus, {"it.ssm": mapping}))
        assert result["a.y"][-1] == 4 * 6000 and result["a.m"][-1] == 0


def test_files_of_ssp_2_run_with_what_ssp_1_has_and_are_refused_by_name_with_more(
    fmus: dict[str, Path], tmp_path: Path
) -> None:
    given = binding({"u": REAL.format(5)}).replace('version="1.0"', 'version="2.0"')
    made = system(component("a", "m.fmu", U, given))
    assert run(pack(tmp_path / "x.ssp", ssd(made, version="2.0"), fmus))["a.y"][-1] == 5
    later = system(component("a", "m.fmu", connector("u", "input", "<ssc:Float64/>")))
    with pytest.raises(SystemFileError, match=r"Float64.* \(the file is of SSP 2\.0"):
        run(pack(tmp_path / "x.ssp", ssd(later, version="2.0"), fmus))


def test_a_parameter_file_that_does_not_declare_ssps_prefix_is_read(fmus: dict[str, Path], tmp_path: Path) -> None:
    values = '<?xml version="1.0" encoding="UTF-8"?>\n<ssv:ParameterSet version="1.0" name="initialValues"><ssv:Parameters>{}'
    values += "</ssv:Parameters></ssv:ParameterSet>"
    bound = '<ssd:ParameterBinding source="ssv/a.ssv"/>'
    path, structure = tmp_path / "x.ssp", ssd(system(component("a", "plain.fmu", U + Y, bound)))
    parameter = '<ssv:Parameter name="u"><ssv:Real value="4"/></ssv:Parameter>'
    assert run(pack(path, structure, fmus, {"ssv/a.ssv": values.format(parameter)}))["a.y"][-1] == 4
    with pytest.raises(SystemFileError, match=r"a\.ssv, line 2: Namespace prefix x on Parameter is not defined"):
        run(pack(path, structure, fmus, {"ssv/a.ssv": values.format('<x:Parameter name="u"/>')}))
