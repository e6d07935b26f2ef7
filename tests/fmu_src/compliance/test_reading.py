"""modelDescription.xml as the rules read it: the standard's defaults, what a type hands on, what depends on what."""

from __future__ import annotations

import math

import pytest
from fmpy import read_model_description

from broken_fmus import BROKEN, edited
from fmu_src.compliance.files.description import read

# FMI 2.0.4, section 2.2.7: the default of `initial`, and where a variable can be set: before, in and after initialization.
INITIAL = {
    ("parameter", "fixed"): ("exact", True, False),
    ("parameter", "tunable"): ("exact", True, True),
    ("calculatedParameter", "fixed"): ("calculated", False, False),
    ("calculatedParameter", "tunable"): ("calculated", False, False),
    ("input", "discrete"): (None, False, True),
    ("input", "continuous"): (None, False, True),
    ("output", "constant"): ("exact", False, False),
    ("output", "discrete"): ("calculated", False, False),
    ("output", "continuous"): ("calculated", False, False),
    ("local", "constant"): ("exact", False, False),
    ("local", "fixed"): ("calculated", False, False),
    ("local", "continuous"): ("calculated", False, False),
    ("independent", "continuous"): (None, False, False),
}


@pytest.mark.parametrize(("causality", "variability"), INITIAL)
def test_what_a_variable_does_not_say_is_the_standards_default(causality: str, variability: str) -> None:
    said = f'<ScalarVariable name="limit" valueReference="4" causality="{causality}" variability="{variability}">'
    root = edited(
        "modelDescription.xml", {'<ScalarVariable name="limit" valueReference="4" variability="constant">': said}
    )
    variable = read(root).variables[4]
    found = variable.initial, variable.settable_before_initialization, variable.settable_in_steps
    assert found == INITIAL[causality, variability]


def test_a_state_with_an_approximate_start_can_be_set_before() -> None:
    root = edited(
        "modelDescription.xml",
        {'variability="continuous" initial="calculated"': 'variability="continuous" initial="approx"'},
    )
    x = read(root).variables[3]
    assert (x.initial, x.settable_before_initialization, x.settable_in_steps) == ("approx", True, False)


@pytest.mark.parametrize("name", ["modelDescription.xml", "exchange.xml"])
def test_what_is_read_is_what_fmpy_reads(name: str) -> None:
    found = read(edited(name, {}))
    expected = read_model_description(str(BROKEN / name), validate=False)
    assert found.guid == expected.guid and found.version == expected.fmiVersion
    assert found.indicators == int(expected.numberOfEventIndicators or 0)
    assert found.categories == tuple(category.name for category in expected.logCategories)
    assert found.experiment["stepSize"] == float(expected.defaultExperiment.stepSize)
    indices = {variable.name: variable.index for variable in found.variables}
    assert found.derivatives == tuple(indices[unknown.variable.name] for unknown in expected.derivatives)
    assert found.initial_unknowns == tuple(indices[unknown.variable.name] for unknown in expected.initialUnknowns)
    for variable, other in zip(found.variables, expected.modelVariables, strict=True):
        assert (variable.name, variable.reference) == (other.name, other.valueReference)
        assert (variable.type, variable.causality, variable.variability) == (
            other.type,
            other.causality,
            other.variability,
        )
        start = None if other.start is None else {"Real": float, "Enumeration": int}.get(other.type, str)(other.start)
        assert variable.start == (other.start == "true" if other.type == "Boolean" else start)
        assert variable.derivative == (None if other.derivative is None else indices[other.derivative.name])


def test_limits_nominal_value_and_unit_are_the_variables_own_or_its_types() -> None:
    typed = '<SimpleType name="Length"><Real unit="m" min="-3" max="3" nominal="2"/></SimpleType>'
    root = edited(
        "modelDescription.xml",
        {'<SimpleType name="Length"><Real unit="m"/></SimpleType>': typed, ' min="-10" max="10"': ' max="10"'},
    )
    u, gain = read(root).variables[:2]
    assert (u.min, u.max, u.nominal, u.unit, u.declared_type) == (-3.0, 10.0, 2.0, "m", "Length")
    assert (gain.min, gain.max, gain.nominal, gain.unit, gain.declared_type) == (-math.inf, math.inf, 1.0, "", None)


@pytest.mark.parametrize(
    ("text", "value"), [("true", True), ("1", True), (" true ", True), ("false", False), ("0", False)]
)
def test_a_boolean_is_true_in_both_spellings(text: str, value: bool) -> None:
    description = read(edited("modelDescription.xml", {'start="true"': f'start="{text}"'}))
    assert description.variables[7].start is value


def test_outputs_depend_on_the_inputs_that_are_said_and_where_nothing_is_on_all() -> None:
    description = read(edited("modelDescription.xml", {'index="10" dependencies="1"': 'index="10" dependencies="1 2"'}))
    assert description.direct == {4: frozenset(), 10: frozenset({1}), 6: frozenset({1, 8})}  # a parameter is no input


def test_flags_are_those_of_their_interface() -> None:
    both = '<ModelExchange modelIdentifier="other" canGetAndSetFMUstate="1"/><CoSimulation '
    description = read(
        edited(
            "modelDescription.xml",
            {"<CoSimulation ": both, 'canInterpolateInputs="true"': 'canInterpolateInputs="false"'},
        )
    )
    assert description.identifiers == {"ModelExchange": "other", "CoSimulation": "broken"}
    assert description.says("canGetAndSetFMUstate", "ModelExchange")
    assert description.says("canSerializeFMUstate", "CoSimulation")
    for flag, interface in (
        ("canSerializeFMUstate", "ModelExchange"),
        ("canInterpolateInputs", "CoSimulation"),
        ("needsExecutionTool", "CoSimulation"),
        ("canGetAndSetFMUstate", "ScheduledExecution"),
    ):
        assert not description.says(flag, interface)
    assert description.source_files == ("broken.c",)
    kinds = [(variable.type, variable.kind) for variable in description.variables[5:9]]
    assert kinds == [("Integer", "Integer"), ("Enumeration", "Integer"), ("Boolean", "Boolean"), ("String", "String")]
