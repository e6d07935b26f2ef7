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
from fmu_src.description.model_description import describe
from fmu_src.description.units import parse
from fmu_src.native.sources import fixed_sources
from observers.component import Component, Port
from reference_models.ramp import ramp
from toys import feedthrough_toy, sampled_toy

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


@pytest.mark.parametrize("name", COMPONENTS)
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
    assert unit.factor == pytest.approx(factor, rel=1e-15)


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
