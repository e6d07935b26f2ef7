"""Rules of the document around the variables at their borders: indices, dependencies, the default experiment, flags."""

from __future__ import annotations

import pytest

from broken_fmus import edited, told
from fmu_src.compliance.files import fmi3
from fmu_src.compliance.files.description import is_identifier, read
from fmu_src.compliance.files.structure import check_document, check_structure

X_OF_OUTPUTS = 'index="4" dependencies=""'
X_INITIALLY = 'index="4" dependencies="3"'
LAST = '<Unknown index="6"/></Outputs>'
REAL_X = '<Real unit="m"/></ScalarVariable>'


def of_x(dependencies: str) -> dict[str, str]:
    return {X_OF_OUTPUTS: f'index="4" dependencies="{dependencies}"'}


def initially(dependencies: str) -> dict[str, str]:
    return {X_INITIALLY: f'index="4" dependencies="{dependencies}"'}


def derivative(state: int) -> dict[str, str]:
    """x is said to be the derivative of the variable of that index."""
    return {REAL_X: f'<Real unit="m" derivative="{state}"/></ScalarVariable>'}


STRUCTURE = {
    "on inputs and a parameter": (of_x("1 2 8"), []),
    "on what does not exist, 0": (of_x("1 0"), [("structure-index", "Outputs: x", "0")]),
    "on what does not exist, one beyond the last": (of_x("11"), [("structure-index", "Outputs: x", "11")]),
    "on an output": (of_x("10"), [("dependency-known", "Outputs: x", "the output 'y'")]),
    "on a state": (of_x("10") | derivative(10), []),
    "initially on what starts exactly": (initially("1 2 3 5"), []),
    "initially on what is calculated": (
        initially("6"),
        [("dependency-known", "InitialUnknowns: x", "the output 'count'")],
    ),
    "initially on a state that is calculated": (
        initially("10") | derivative(10),
        [("dependency-known", "InitialUnknowns: x", "the output 'y'")],
    ),
    "an unknown of index 0": ({LAST: f'<Unknown index="0"/>{LAST}'}, [("structure-index", "Outputs", "0")]),
    "an unknown beyond the last": ({LAST: f'<Unknown index="11"/>{LAST}'}, [("structure-index", "Outputs", "11")]),
    "one beyond the last with a dependency beyond it": (
        {LAST: f'<Unknown index="11" dependencies="12"/>{LAST}'},
        [("structure-index", "Outputs", "11"), ("structure-index", "Outputs: index 11", "12")],
    ),
    "an unknown twice": ({LAST: f'<Unknown index="6"/>{LAST}'}, [("structure-duplicate", "count", "2 times")]),
    "a derivative of the first variable": (derivative(1), []),
    "a derivative of the last": (derivative(10), []),
    "a derivative of 0": (derivative(0), [("structure-index", "derivative of x", "0")]),
    "a derivative of one beyond the last": (derivative(11), [("structure-index", "derivative of x", "11")]),
}


@pytest.mark.parametrize("case", STRUCTURE)
def test_indices_and_dependencies(case: str) -> None:
    edits, expected = STRUCTURE[case]
    root = edited("modelDescription.xml", edits)
    assert told(check_structure(root, read(root))) == expected


def experiment(**attributes: str) -> dict[str, str]:
    said = " ".join(f'{name}="{value}"' for name, value in attributes.items())
    return {
        '<DefaultExperiment startTime="0" stopTime="1" tolerance="1e-4" stepSize="0.1"/>': f"<DefaultExperiment {said}/>"
    }


RULE = "default-experiment"
DOCUMENTS = {
    "no stop time": (experiment(startTime="2"), []),
    "a stop time at the start": (experiment(startTime="2", stopTime="2"), []),
    "a stop time before it": (experiment(startTime="2", stopTime="1.5"), [(RULE, "stopTime", "1.5")]),
    "a stop time before 0, where no start is said": (experiment(stopTime="-0.5"), [(RULE, "stopTime", "-0.5")]),
    "a stop time before 0 after the start": (experiment(startTime="-1", stopTime="-0.5"), []),
    "no step": (experiment(stepSize="0"), [(RULE, "stepSize", "0")]),
    "a negative tolerance": (experiment(tolerance="-1e-3"), [(RULE, "tolerance", "-0.001")]),
    "an infinite start": (experiment(startTime="INF", stopTime="1"), [(RULE, "startTime", "inf")]),
    "a step that is no number": (experiment(stepSize="NaN"), [(RULE, "stepSize", "nan")]),
    "an empty guid": ({'guid="{8c4e810f-3df3-4a00-8276-176fa3c9f000}"': 'guid=" "'}, [("guid", "guid", "none")]),
    "no identifier": (
        {'modelIdentifier="broken"': 'modelIdentifier="bro-ken"'},
        [("model-identifier", "CoSimulation", "'bro-ken'")],
    ),
    "no states to serialise": (
        {'canGetAndSetFMUstate="true"': 'canGetAndSetFMUstate="0"'},
        [("state-flags", "canSerializeFMUstate", "false")],
    ),
    "states, said by a number": ({'canGetAndSetFMUstate="true"': 'canGetAndSetFMUstate="1"'}, []),
    "states that are not serialised": ({'canSerializeFMUstate="true"': ""}, []),
    "neither": ({'canSerializeFMUstate="true"': "", 'canGetAndSetFMUstate="true"': ""}, []),
    "a category thrice": (
        {'<Category name="logEvents"/>': '<Category name="logEvents"/>' * 3},
        [("log-category", "logEvents", "3")],
    ),
}


@pytest.mark.parametrize("case", DOCUMENTS)
def test_the_document_around_the_variables(case: str) -> None:
    edits, expected = DOCUMENTS[case]
    assert told(check_document(read(edited("modelDescription.xml", edits)))) == expected


def test_a_c_identifier_is_one() -> None:
    assert all(map(is_identifier, ("a", "_", "_a1", "A_1", "z9")))
    assert not any(map(is_identifier, ("", "1a", "a-b", "a b", "ä", "a\n", "../a", "a.b")))


FMI3 = {
    "a token of blanks": (
        {'instantiationToken="{8c4e810f-3df3-4a00-8276-176fa3c9f000}"': 'instantiationToken=" "'},
        [("guid", "instantiationToken", "none")],
    ),
    "no states to serialise": ({'canGetAndSetFMUState="true"': ""}, [("state-flags", "canSerializeFMUState", "false")]),
    "a derivative of nothing": (
        {'derivative="4"': 'derivative="44"'},
        [("structure-index", "derivative of der(x)", "44")],
    ),
    "an output that is none": (
        {'<Output valueReference="6"/>': '<Output valueReference="66"/>'},
        [("structure-index", "Output", "66")],
    ),
    "an output twice": (
        {'<Output valueReference="6"/>': '<Output valueReference="6"/>' * 2},
        [("structure-duplicate", "count", "2 times")],
    ),
    "a dependency on nothing": (
        {'valueReference="4" dependencies="1"': 'valueReference="4" dependencies="1 77"'},
        [("structure-index", "Output: x", "77")],
    ),
    "a dependency of nothing on nothing": (
        {'<Output valueReference="6"/>': '<Output valueReference="66" dependencies="77"/>'},
        [("structure-index", "Output", "66"), ("structure-index", "Output: an unknown", "77")],
    ),
    "start values of an array at the limits": ({'start="1 2 3" min="0" max="5"': 'start="1 2 3" min="1" max="3"'}, []),
    "start values of an array beyond": (
        {'start="1 2 3" min="0" max="5"': 'start="1 2 3" min="1.5" max="2.5"'},
        [("start-range", "table", "1")],
    ),
    "a limit on one side": (
        {'start="1 2 3" min="0" max="5"': 'start="1 2 3" min="1.5"'},
        [("start-range", "table", "1")],
    ),
    "min above max": (
        {'start="3"/>\n    <Float64 name="table"': 'start="3" min="5" max="4"/>\n    <Float64 name="table"'},
        [("min-max", "gain", "5.0")],
    ),
    "min at max": (
        {'start="3"/>\n    <Float64 name="table"': 'start="3" min="3" max="3"/>\n    <Float64 name="table"'},
        [],
    ),
    "an integer of 64 bits that no double holds": (
        {
            'initial="calculated"/>\n    <Enum': 'initial="calculated" min="9007199254740993" max="9007199254740992"/>\n    <Enum'
        },
        [("min-max", "count", "9007199254740993")],
    ),
    "a type of another kind": (
        {'variability="tunable" start="3"': 'variability="tunable" start="3" declaredType="Mode"'},
        [("declared-type", "gain", "one of Enumeration")],
    ),
    "a value of two items": (
        {'name="Slow" value="2"': 'name="Slow" value="1"'},
        [("enumeration-items", "Mode", "'1' more than once")],
    ),
    "a name of two items": ({'name="Slow"': 'name="Fast"'}, [("enumeration-items", "Mode", "'Fast' more than once")]),
    "a start value of no item": (
        {'declaredType="Mode" start="1"': 'declaredType="Mode" start="3"'},
        [("enumeration-start", "mode", "3")],
    ),
    "a type twice": (
        {"</TypeDefinitions>": '<Int8Type name="Mode"/></TypeDefinitions>'},
        [("type-name", "Mode", "several"), ("declared-type", "mode", "one of Int8")],
    ),
    "a unit twice": ({"</UnitDefinitions>": '<Unit name="m"/></UnitDefinitions>'}, [("unit-name", "m", "several")]),
}


@pytest.mark.parametrize("case", FMI3)
def test_the_same_of_fmi_3(case: str) -> None:
    edits, expected = FMI3[case]
    root = edited("fmi3.xml", edits)
    description = fmi3.read(root)
    found = [
        *check_document(description),
        *fmi3.check_definitions(root),
        *fmi3.check_ranges(root, description),
        *fmi3.check_structure(root, description),
    ]
    assert told(found) == expected


def test_aliases_of_fmi_3_are_names_too() -> None:
    names = ["time", "u", "gain", "table", "x", "position.x", "der(x)", "count", "mode"]
    assert fmi3.names(edited("fmi3.xml", {})) == names
