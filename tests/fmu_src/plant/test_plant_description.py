"""What a plant's modelDescription.xml says, as an observer takes it: units, limits, platforms, and what is in the way."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

import plant_fmu
from fmu_src.errors import PlantError
from fmu_src.plant.description import PlantDescription, obstacles, read, replaced
from fmu_src.plant.model import identifier
from strict_fmu import HOST

Described = Callable[..., PlantDescription]
UNITS = "</UnitDefinitions>"
MU = '<Real start="1.5" min="0"/>'


@pytest.fixture
def described(tmp_path: Path) -> Described:
    """described(edits, files) -> what is read of the van der Pol plant with other text in its description."""

    def make(edits: dict[str, str] | None = None, *files: str, kind: str = "van_der_pol") -> PlantDescription:
        document = plant_fmu.description(kind)
        for old, new in (edits or {}).items():
            assert old in document, old
            document = document.replace(old, new)
        path = tmp_path / f"{kind}.fmu"
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("modelDescription.xml", document)
            for file in files or (f"binaries/{HOST}/plants.so",):
                archive.writestr(file, "")
        return read(path)

    return make


@pytest.mark.parametrize(
    ("unit", "base", "ours"),
    [
        ("m/s", 'm="1" s="-1"', "m/s"),
        ("speed", 'm="1" s="-1"', "m/s"),
        ("force", 'kg="1" m="1" s="-2"', "kg.m/s2"),
        ("W/(m2.K)", 'kg="1" s="-3" K="-1"', "W/(m2.K)"),
        ("heat", 'kg="1" s="-3" K="-1"', "kg/(s3.K)"),
        ("per", 's="-1"', "1/s"),
        ("square", 'm="2"', "m2"),
        ("none", "", "1"),
        ("mm", 'm="1" factor="0.001"', "mm"),
        ("milli", 'm="1" factor="0.001"', "1"),
        ("mm", 'm="1"', "m"),
        ("degC", 'K="1" offset="273.15"', "degC"),
        ("celsius", 'K="1" offset="273.15"', "1"),
        ("K", 'K="1" offset="273.15"', "1"),
        ("rpm", f's="-1" factor="{math.pi / 30!r}"', "rpm"),
        ("rad/s", 's="-1"', "rad/s"),
        ("N", 'kg="1" m="1" s="-1"', "kg.m/s"),
    ],
)
def test_a_unit_is_what_its_definition_means(described: Described, unit: str, base: str, ours: str) -> None:
    table = f'<Unit name="{unit}"><BaseUnit {base}/></Unit>'
    edits = {UNITS: table + UNITS, MU: f'<Real start="1.5" min="0" unit="{unit}"/>'}
    if unit in ("m/s", "rad/s"):
        edits[f'<Unit name="{unit}"><BaseUnit {"m" if unit == "m/s" else "rad"}="1" s="-1"/></Unit>'] = ""
    assert described(edits).variables["mu"].unit == ours


def test_a_unit_without_a_definition_is_ours_by_its_name_or_none(described: Described) -> None:
    for unit, ours in (("kPa", "kPa"), ("furlong", "1"), ("", "1")):
        assert described({MU: f'<Real start="1.5" unit="{unit}"/>'}).variables["mu"].unit == ours


@pytest.mark.parametrize(
    ("said", "limits"),
    [
        ("", (-math.inf, math.inf)),
        (' min="-1" max="2"', (-1.0, 2.0)),
        (' min="-1.7976931348623157E+308" max="1.7976931348623157E+308"', (-math.inf, math.inf)),
        (' min="-1e300" max="1e300"', (-math.inf, math.inf)),
        (' min="-1e299" max="1e299"', (-1e299, 1e299)),
        (' min="-INF" max="INF"', (-math.inf, math.inf)),
    ],
)
def test_limits_that_are_as_far_as_a_number_goes_are_none(
    described: Described, said: str, limits: tuple[float, float]
) -> None:
    mu = described({MU: f"<Real{said}/>"}).variables["mu"]
    assert (mu.min, mu.max) == limits and mu.start is None


@pytest.mark.parametrize(
    ("said", "nominal"), [("", None), (' nominal="0"', None), (' nominal="-2"', 2.0), (' nominal="3"', 3.0)]
)
def test_a_nominal_value_is_a_size(described: Described, said: str, nominal: float | None) -> None:
    assert described({MU: f"<Real{said}/>"}).variables["mu"].nominal == nominal


def test_what_a_variable_does_not_say_its_type_does(described: Described) -> None:
    types = '<TypeDefinitions><SimpleType name="T"><Real unit="m" min="-1" max="1" nominal="4"/></SimpleType></TypeDefinitions>'
    mu = described({UNITS: UNITS + types, MU: '<Real declaredType="T" max="3" start="2"/>'}).variables["mu"]
    assert (mu.unit, mu.min, mu.max, mu.nominal, mu.start) == ("m", -1.0, 3.0, 4.0, 2.0)


def test_what_is_said_of_the_plant_is_read(described: Described) -> None:
    plain = described()
    assert (plain.name, plain.identifier, plain.guid, plain.tool, plain.license) == (
        "van_der_pol",
        "plants",
        "van_der_pol",
        "",
        "",
    )
    assert [v.name for v in plain.states] == ["x0", "x1"] and [v.name for v in plain.derivatives] == [
        "der(x0)",
        "der(x1)",
    ]
    assert [v.name for v in plain.outputs] == ["y", "middle", "power"]
    assert (plain.exchange, plain.indicators, plain.directional, plain.completes_steps) == (True, 0, False, True)
    assert (plain.step, plain.stop, plain.capabilities, plain.dependencies) == (0.05, 10.0, {}, {})
    rich = described(
        {
            "<ModelExchange ": '<ModelExchange completedIntegratorStepNotNeeded="true" needsExecutionTool="true" ',
            'modelName="van_der_pol"': 'modelName="P" generationTool="T" license="L" copyright="C"',
            '<DefaultExperiment startTime="0" stopTime="10" stepSize="0.05"/>': "",
            '<Unknown index="4"/></Derivatives>': '<Unknown index="4" dependencies="1 2"/></Derivatives>',
        }
    )
    assert (rich.name, rich.tool, rich.license, rich.completes_steps) == ("P", "T", "L; C", False)
    assert (rich.step, rich.stop, rich.capabilities) == (None, None, {"needsExecutionTool": "true"})
    assert rich.dependencies == {"der(x1)": frozenset({"x0", "x1"})}


def test_platforms_are_those_with_a_library_of_the_plants_name(described: Described) -> None:
    files = [
        "linux64/plants.so",
        "win64/plants.dll",
        "darwin64/plants.so",
        "aarch64-linux/other.so",
        "linux32/plants.so",
    ]
    assert described(None, *(f"binaries/{name}" for name in files)).platforms == ("linux64", "win64")


def test_what_is_in_the_way_is_said_in_a_sentence_each(described: Described) -> None:
    assert obstacles(described()) == []
    frozen = "its modes would stay frozen; export it without events (noEvent, smooth)"
    assert obstacles(described({'guid="van_der_pol"': 'guid="v" numberOfEventIndicators="1"'})) == [
        f"has 1 event indicator: {frozen}"
    ]
    several = described(
        {'guid="indicators"': 'guid="i"'},
        "binaries/win64/plants.dll",
        "binaries/darwin64/plants.dylib",
        kind="indicators",
    )
    assert obstacles(several) == [
        f"has 2 event indicators: {frozen}",
        f"has no binary for {HOST}, this machine, and so cannot be tried; it has win64, darwin64",
    ]
    none = obstacles(described(None, "binaries/linux32/plants.so"))
    assert none == [f"has no binary for {HOST}, this machine, and so cannot be tried; it has none that is known here"]


def test_a_derivative_of_no_state_is_refused(described: Described) -> None:
    with pytest.raises(PlantError, match="a derivative of its ModelStructure does not say which state it is"):
        described({' derivative="2"': ""})


def refused(choose: Callable[[], object]) -> str:
    with pytest.raises(PlantError) as caught:
        choose()
    return str(caught.value).removeprefix("plant 'van_der_pol.fmu': ")


def test_a_choice_that_is_none_is_refused_with_what_there_is(described: Described) -> None:
    plant = described()
    assert (
        refused(lambda: plant.input("mu"))
        == "'mu' is no continuous input but tunable, parameter; inputs: force, switch"
    )
    assert (
        refused(lambda: plant.input("y")) == "'y' is no continuous input but continuous, output; inputs: force, switch"
    )
    assert refused(lambda: plant.input("switch")).startswith("'switch' is no continuous input but discrete, input")
    for name, what in (("twice", "calculated"), ("x0", "calculated"), ("y", "calculated"), ("force", "input")):
        assert refused(lambda name=name: plant.parameter(name)) == f"'{name}' is {what}; take one of mu, m"  # type: ignore[misc]
    assert refused(lambda: plant.output("mu")) == (
        "'mu' is tunable, parameter, and no continuous output or local variable; such as y, middle, power, x0, x1"
    )
    assert refused(lambda: plant.input("count")) == "the input 'count' is of type Integer; an observer takes Real only"
    assert refused(lambda: plant.output("forc")) == "the output 'forc' is no variable of it; near: force"
    assert (
        refused(lambda: plant.output("§")) == "the output '§' is no variable of it; near: x0, x1, der(x0), der(x1), mu"
    )
    for choose, name in (
        (plant.input, "force"),
        (plant.parameter, "mu"),
        (plant.parameter, "m"),
        (plant.output, "y"),
        (plant.output, "x0"),
    ):
        assert choose(name).name == name


def test_of_many_names_eight_are_said_and_how_many_more(described: Described) -> None:
    plant = described(kind="rod9")
    text = refused(lambda: plant.output("k"))
    assert text.endswith("such as y, middle, power, T[1], T[2], T[3], T[4], T[5] and 4 more")
    assert refused(lambda: described(kind="rod5").output("k")).endswith(
        "such as y, middle, power, T[1], T[2], T[3], T[4], T[5]"
    )


def test_attributes_replace_what_the_description_says_everywhere(described: Described) -> None:
    plant = replaced(described(), {"x1": {"unit": "V", "wrap": 3.0}, "y": {"nominal": 7.0}, "mu": {"max": 9.0}})
    assert (plant.variables["x1"].unit, plant.states[1].unit, plant.states[0].unit) == ("V", "V", "1")
    assert (plant.variables["y"].nominal, plant.outputs[0].nominal, plant.variables["mu"].max) == (7.0, 7.0, 9.0)


@pytest.mark.parametrize(
    ("name", "ours"),
    [
        ("mass.s", "mass_s"),
        ("body[1].v", "body_1_v"),
        ("1a", "_1a"),
        ("lambda", "lambda_"),
        ("ä", "_"),
        ("der(x)", "der_x"),
        ("a", "a"),
    ],
)
def test_a_name_becomes_an_identifier(name: str, ours: str) -> None:
    assert identifier(name) == ours and ours.isidentifier()
