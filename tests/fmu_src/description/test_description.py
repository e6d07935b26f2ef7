"""modelDescription.xml: valid, complete, and true to the component."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import pytest
from fmpy.validation import validate_fmu
from lxml import etree

from components import COMPONENTS
from fmu_src import ExportError, export
from fmu_src.description.model_description import describe, type_name
from fmu_src.description.units import parse
from fmu_src.native.sources import fixed_sources
from observers.component import Component, Enumeration, Port
from reference_models.ramp import ramp
from toys import double_toy, feedthrough_toy, sampled_toy

Path_of = Callable[[str], Path]


def xml(component: Component) -> Any:
    return etree.fromstring(describe(component, "{0}", ["a.c"]))


def variable(root: Any, name: str) -> Any:
    return root.find(f".//ScalarVariable[@name='{name}']")


def unknowns(root: Any, kind: str) -> dict[str, set[str]]:
    """Dependencies by name."""
    names = [element.get("name") for element in root.iter("ScalarVariable")]
    return {
        names[int(element.get("index")) - 1]: {names[int(k) - 1] for k in element.get("dependencies").split()}
        for element in root.find(f"ModelStructure/{kind}")
    }


# Of the linear ones, those that other tests of the fast suite build too.
LONG = {f"linear_{n}_riccati" for n in (4, 5, 7, 8)}


@pytest.mark.parametrize("name", [pytest.param(c, marks=pytest.mark.long) if c in LONG else c for c in COMPONENTS])
def test_fmpy_finds_nothing_wrong(built: Path_of, name: str) -> None:
    assert validate_fmu(str(built(name))) == []
    fmpy.dump(str(built(name)))


def test_every_variable_says_what_it_is(built: Path_of) -> None:
    with zipfile.ZipFile(built("duffing")) as archive:
        root = etree.fromstring(archive.read("modelDescription.xml"))
    elements = list(root.iter("ScalarVariable"))
    assert [int(e.get("valueReference")) for e in elements] == list(range(len(elements)))
    for element in elements:
        for attribute in ("description", "causality", "variability"):
            assert element.get(attribute), element.get("name")
        assert (element.get("initial") is None) == (element.get("causality") == "input")
        if element[0].tag == "Real":
            assert element[0].get("nominal") and element[0].get("unit") and element[0].get("declaredType")


def test_attributes_follow_the_component() -> None:
    root = xml(sampled_toy())
    gain = variable(root, "tuning.gain")
    assert (gain.get("causality"), gain.get("variability"), gain.get("initial")) == ("parameter", "tunable", "exact")
    assert {k: gain[0].get(k) for k in ("min", "max", "start")} == {"min": "0.0", "max": "1.0", "start": "0.5"}
    assert variable(root, "start.level").get("variability") == "fixed"
    scale = variable(root, "tuning.scale")[0]
    assert (scale.tag, scale.get("min"), scale.get("max"), scale.get("start")) == ("Integer", "1", "5", "1")
    status = variable(root, "diagnostics.status")
    assert (status[0].tag, status[0].get("declaredType"), status.get("variability")) == (
        "Enumeration",
        "ToyStatus",
        "discrete",
    )
    doubled = variable(root, "diagnostics.doubled")
    assert (doubled.get("causality"), doubled.get("initial")) == ("local", "calculated")
    constant = variable(root, "certificate")
    assert (constant.get("causality"), constant.get("variability"), constant[0].get("start")) == (
        "local",
        "constant",
        "0.125",
    )
    assert variable(root, "rate").get("variability") == "continuous"
    assert variable(root, "rate")[0].get("start") == "0.25"
    items = root.findall(".//SimpleType[@name='ToyStatus']/Enumeration/Item")
    assert [(i.get("name"), i.get("value")) for i in items] == [("Good", "1"), ("Rejected", "2")]
    experiment = root.find("DefaultExperiment")
    assert {k: float(v) for k, v in experiment.items()} == {"startTime": 0, "stopTime": 2, "stepSize": 0.1}
    assert root.get("description") == "Sampled & integrated <toy>"


def test_capabilities_and_no_date() -> None:
    root = xml(sampled_toy())
    slave = root.find("CoSimulation")
    yes = {k for k, v in slave.items() if v == "true"}
    assert yes == {
        "canHandleVariableCommunicationStepSize",
        "canInterpolateInputs",
        "canGetAndSetFMUstate",
        "canSerializeFMUstate",
    }
    assert root.get("generationDateAndTime") is None
    assert root.get("variableNamingConvention") == "structured"


def test_outputs_depend_on_the_inputs_they_see_at_once() -> None:
    assert unknowns(xml(feedthrough_toy()), "Outputs") == {"force": {"position"}, "bias_now": set()}
    assert set(unknowns(xml(sampled_toy()), "Outputs")["estimate.level"]) == set()


def test_initial_unknowns_depend_on_parameters_and_inputs() -> None:
    feedthrough = unknowns(xml(feedthrough_toy()), "InitialUnknowns")
    assert feedthrough == {"force": {"position", "gain"}, "bias_now": {"bias"}}
    sampled = unknowns(xml(sampled_toy()), "InitialUnknowns")
    assert sampled["estimate.level"] == {"start.level"}
    assert sampled["diagnostics.status"] == set()
    assert "diagnostics.doubled" not in sampled  # local


def test_the_guid_follows_the_contents(tmp_path: Path) -> None:
    def guid(component: Component, folder: str) -> str:
        path = export(component, tmp_path / folder)
        return str(fmpy.read_model_description(str(path)).guid)

    toy = feedthrough_toy()
    first = guid(toy, "a")
    assert guid(feedthrough_toy(), "b") == first
    changed = dataclasses.replace(toy.parameters[0], start=2.5)
    assert guid(dataclasses.replace(toy, parameters=(changed, toy.parameters[1])), "c") != first


@pytest.mark.parametrize(
    ("expression", "exponents", "factor", "offset"),
    [
        ("1", {}, 1, 0),
        ("m/s2", {"m": 1, "s": -2}, 1, 0),
        ("1/s", {"s": -1}, 1, 0),
        ("rad/s", {"rad": 1, "s": -1}, 1, 0),
        ("Hz", {"s": -1}, 1, 0),
        ("N", {"kg": 1, "m": 1, "s": -2}, 1, 0),
        ("V", {"kg": 1, "m": 2, "s": -3, "A": -1}, 1, 0),
        ("1/(V2.s2)", {"kg": -2, "m": -4, "s": 4, "A": 2}, 1, 0),
        ("kN.m", {"kg": 1, "m": 2, "s": -2}, 1e3, 0),
        ("mm", {"m": 1}, 1e-3, 0),
        ("min", {"s": 1}, 60, 0),
        ("s-1", {"s": -1}, 1, 0),
        ("degC", {"K": 1}, 1, 273.15),
        ("J/(kg.K)", {"m": 2, "s": -2, "K": -1}, 1, 0),
    ],
)
def test_units_in_si(expression: str, exponents: dict[str, int], factor: float, offset: float) -> None:
    unit = parse(expression)
    assert (unit.exponents, unit.offset) == (exponents, offset)
    assert unit.factor == pytest.approx(factor, rel=1e-15, abs=0)


def test_unit_definitions_cover_every_unit() -> None:
    root = xml(sampled_toy())
    units = {e.get("name"): dict(e[0].items()) for e in root.iter("Unit")}
    assert units == {
        "1": {},
        "m": {"m": "1"},
        "s": {"s": "1"},
        "m/s": {"m": "1", "s": "-1"},
        "1/(V2.s2)": {"kg": "-2", "m": "-4", "s": "4", "A": "2"},
    }


def test_a_variable_without_a_unit_declares_none_and_none_is_defined() -> None:
    root = xml(ramp())
    reals = {v.get("name"): v[0] for v in root.iter("ScalarVariable")}
    assert {name: real.get("unit") for name, real in reals.items()} == {
        "height": None,
        "start": "s",
        "duration": "s",
        "y": None,
    }
    assert reals["y"].get("declaredType") is None
    assert [unit.get("name") for unit in root.iter("Unit")] == ["s"]


@pytest.mark.parametrize("unit", ["furlong", "m/s/s", "m s", "m/s.kg", "m^2", "m0.5"])
def test_a_unit_that_nobody_knows_is_refused_with_its_variable(unit: str) -> None:
    toy = feedthrough_toy()
    port = Port("force", "force", unit)
    with pytest.raises(ExportError) as caught:
        xml(dataclasses.replace(toy, outputs=(port, toy.outputs[1])))
    assert f"'{unit}'" in str(caught.value) and "'force'" in str(caught.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"name": "1st"}, "C identifier"),
        ({"inputs": (Port("u[1", "u"),)}, r"u\[1.*structured"),
        ({"inputs": (Port("u", "u", kind="Integer", variability="discrete"),)}, "'u'.*inputs must be Real"),
        ({"inputs": (Port("u", "u", variability="tunable"),)}, "'u'.*continuous or discrete"),
        ({"outputs": (Port("a", "a", kind="Integer"), Port("b", "b"))}, "'a'.*cannot be continuous"),
        ({"outputs": (Port("a", "a", kind="Enumeration", variability="discrete"), Port("b", "b"))}, "'a'.*enumeration"),
        ({"description": "a\x01b"}, r"'a\\x01b' holds control characters"),
        ({"inputs": (Port("u", "\x00"),)}, r"'\\x00' of 'u' holds control characters"),
        ({"constants": (Port("c", "c", start=0.5, kind="Integer", variability="constant"),)}, "0.5.*'c'"),
    ],
)
def test_ports_that_fmi_does_not_allow_are_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ExportError, match=words):
        xml(dataclasses.replace(feedthrough_toy(), **change))


def test_a_variable_without_description_is_described_by_its_name() -> None:
    root = xml(dataclasses.replace(feedthrough_toy(), inputs=(Port("u"),)))
    assert variable(root, "u").get("description") == "u"


def test_source_files_are_all_there_is_to_compile_but_for_the_example_without_fmi(built: Path_of) -> None:
    with zipfile.ZipFile(built("sampled_toy")) as archive:
        root = etree.fromstring(archive.read("modelDescription.xml"))
        listed = {element.get("name") for element in root.iter("File")}
        found = {name.removeprefix("sources/") for name in archive.namelist() if name.endswith(".c")}
    assert found - listed == {"embedded/example.c"} and listed < found
    assert {name for name in fixed_sources() if name.endswith(".c")} < listed


def test_the_version_is_the_distributions() -> None:
    root = etree.fromstring(describe(sampled_toy(), guid="", source_files=[]))
    assert root.get("version") == importlib.metadata.version("observer-fmus")
    assert root.get("license") == importlib.metadata.metadata("observer-fmus")["License"] == "BSD-2-Clause"


# Of double_toy, in the order of value references: name, type, causality, variability, initial, min, max, nominal, start.
EXPECTED = """
a Real input continuous - - - 1.0 0.5
flag Boolean input discrete - - - - true
b Real input continuous - - - 1.0 -1.0
start.s Real parameter fixed exact -10.0 10.0 1.0 0.25
late_kick Real parameter fixed exact - - 1.0 0.27
early_kick Real parameter fixed exact - - 1.0 0.13
sample_time Real parameter fixed exact 0.01 1.0 1.0 0.1
gain Real parameter tunable exact -3.0 4.0 1.0 2.0
bias Real parameter tunable exact -1.0 1.0 1.0 0.5
weight Integer parameter tunable exact -2 9 - 1
enabled Boolean parameter tunable exact - - - true
s Real output continuous calculated - - 1.0 -
w Real output continuous calculated - - 1.0 -
sampled_flag Boolean output discrete calculated - - - -
total Integer output discrete calculated - - - -
high_a Integer output discrete calculated - - - -
high_b Integer output discrete calculated - - - -
force Real output continuous calculated - - 1.0 -
inverse Real output continuous calculated - - 1.0 -
first Real local constant exact - - 1.0 0.125
second Integer local constant exact - - - -3
"""


def test_every_attribute_of_every_variable_is_the_ports() -> None:
    root = xml(double_toy())
    found = []
    for reference, element in enumerate(root.iter("ScalarVariable")):
        assert element.get("valueReference") == str(reference)
        own = [element.get(name) for name in ("causality", "variability", "initial")]
        typed = [element[0].get(name) for name in ("min", "max", "nominal", "start")]
        found.append(" ".join([element.get("name"), element[0].tag, *(value or "-" for value in own + typed)]))
    assert found == EXPECTED.strip().splitlines()
    units = {e.get("name"): (e[0].get("unit"), e[0].get("declaredType")) for e in root.iter("ScalarVariable")}
    assert units["b"] == ("m/s2", "Real_m_per_s2") and units["inverse"] == ("s2/m", "Real_s2_per_m")
    assert units["weight"] == (None, None) and units["gain"] == ("1", "Real_dimensionless")
    types = {e.get("name"): e[0].get("unit") for e in root.iter("SimpleType")}
    assert types["Real_m_per_s2"] == "m/s2" and types["Real_dimensionless"] == "1"


def test_the_model_structure_names_outputs_and_what_they_depend_on_by_their_places() -> None:
    root = xml(double_toy())
    outputs = {name: on for name, on in unknowns(root, "Outputs").items() if on}
    assert outputs == {"force": {"a"}, "inverse": {"b"}}
    initial = {name: on for name, on in unknowns(root, "InitialUnknowns").items() if on}
    assert initial == {"s": {"start.s"}, "force": {"a", "gain", "bias"}, "inverse": {"b"}}
    places = [int(e.get("index")) for e in root.find("ModelStructure/Outputs")]
    assert places == list(range(12, 20))
    assert [int(e.get("index")) for e in root.find("ModelStructure/InitialUnknowns")] == places
    for unknown in root.iter("Unknown"):
        assert unknown.get("dependenciesKind").split() == ["dependent"] * len(unknown.get("dependencies").split())


def test_enumerations_of_one_name_must_be_one_and_no_variables_or_types_name() -> None:
    toy = sampled_toy()
    kinds = {port.name: port for port in toy.parameters}
    twin = Port(
        "tuning.twin", kind="Enumeration", start=1, variability="tunable", enumeration=kinds["tuning.mode"].enumeration
    )
    gain = next(i for i, port in enumerate(toy.parameters) if port.name == "tuning.gain")

    def with_port(port: Port) -> Component:
        return dataclasses.replace(toy, parameters=(*toy.parameters[:gain], port, *toy.parameters[gain + 1 :]))

    assert len(xml(with_port(twin)).findall(".//SimpleType/Enumeration")) == 2
    other = Enumeration("ToyMode", (("Only", ""),))
    with pytest.raises(ExportError, match="two enumerations are called 'ToyMode'"):
        xml(with_port(dataclasses.replace(twin, enumeration=other)))
    for name in ("rate", "Real_m"):
        taken = dataclasses.replace(twin, enumeration=Enumeration(name, (("Only", ""),)))
        with pytest.raises(ExportError, match=f"the enumeration '{name}' has the name of a variable or type"):
            xml(with_port(taken))


@pytest.mark.parametrize(
    ("port", "words"),
    [
        (
            Port("w", start=0.5, min=0, max=2, kind="Integer", variability="tunable"),
            r"start value 0\.5 of 'w' is no Integer",
        ),
        (Port("w", kind="Enumeration", variability="tunable"), "'w' is of kind 'Enumeration'; known"),
        (Port("w", kind="Float", variability="tunable"), "'w' is of kind 'Float'; known"),
        (
            Port("w", variability="continuous"),
            "the parameter 'w' has the variability 'continuous', it must be fixed or tunable",
        ),
        (Port("a..b", variability="tunable"), r"'a\.\.b' is no structured variable name"),
        (Port("w", unit="furlong", variability="tunable"), "the unit 'furlong' of 'w' cannot be understood"),
        (Port("w", description="\x07", variability="tunable"), "of 'w' holds control characters"),
    ],
)
def test_a_parameter_that_fmi_does_not_allow_is_named(port: Port, words: str) -> None:
    toy = feedthrough_toy()
    with pytest.raises(ExportError, match=words):
        xml(dataclasses.replace(toy, parameters=(toy.parameters[0], port)))


def test_a_type_is_named_by_identifiers_only() -> None:
    for unit, name in (
        ("1", "Real_dimensionless"),
        ("m/s", "Real_m_per_s"),
        ("1/(V2.s2)", "Real_1_per__V2_s2"),
        ("%", "Real_percent"),
        ("s-1", "Real_sminus1"),
        ("m+2", "Real_m2"),
    ):
        assert type_name(unit) == name
