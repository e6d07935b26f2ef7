"""Rules of variables and types at their borders: what is just allowed, what is just not, and which variable a finding names."""

from __future__ import annotations

import pytest

from broken_fmus import edited, told
from fmu_src.compliance.files.description import read
from fmu_src.compliance.files.variables import check_variables

END = "  </ModelVariables>"
TYPES = "</TypeDefinitions>"


def more(name: str, reference: int, kind: str, element: str) -> dict[str, str]:
    """One more variable, the eleventh."""
    variable = f'<ScalarVariable name="{name}" valueReference="{reference}" {kind}>{element}</ScalarVariable>'
    return {END: f"{variable}{END}"}


RANGES = {
    "a start value at both limits": ({'min="-10" max="10"': 'min="0.5" max="0.5"'}, []),
    "above": ({'min="-10" max="10"': 'min="-10" max="0.4"'}, [("start-range", "u", "0.5")]),
    "below": ({'min="-10" max="10"': 'min="0.6"'}, [("start-range", "u", "0.5")]),
    "a limit of the type": (
        {'<Real unit="m"/></SimpleType>': '<Real unit="m" max="0.1"/></SimpleType>', ' max="10"': ""},
        [("start-range", "u", "0.5")],
    ),
    "its own limit before the type's": (
        {'<Real unit="m"/></SimpleType>': '<Real unit="m" max="0.1"/></SimpleType>'},
        [],
    ),
    "min above max": ({"<Integer/>": '<Integer min="3" max="2"/>'}, [("min-max", "count", "3")]),
    "min at max": ({"<Integer/>": '<Integer min="2" max="2"/>'}, []),
    "the start value of a Boolean": ({}, []),
}

ALIASES = {
    "two that can be set before": (
        more("other", 2, 'causality="parameter" variability="fixed"', '<Real start="1"/>'),
        [("alias-settable", "start, other", "value reference 2 for 'start', 'other'")],
    ),
    "two inputs": (
        more("other", 20, 'causality="input" variability="discrete"', '<Boolean start="true"/>'),
        [("alias-settable", "active, other", "value reference 20 for 'active', 'other'")],
    ),
    "one that can be set and one that is calculated": (
        more("other", 1, 'causality="local" variability="continuous"', "<Real/>"),
        [],
    ),
    "an enumeration and an Integer": (
        more("other", 11, 'causality="parameter" variability="tunable"', '<Integer start="1"/>'),
        [("alias-settable", "mode, other", "value reference 11 for 'mode', 'other'")],
    ),
    "the same number of another type": (more("other", 3, 'variability="discrete"', "<Integer/>"), []),
    "equal constants": (more("other", 4, 'variability="constant"', '<Real start="100"/>'), []),
    "constants that differ": (
        more("other", 4, 'variability="constant"', '<Real start="99"/>'),
        [("alias-constant", "limit, other", "100.0, 99.0")],
    ),
    "a constant and another": (
        more("other", 4, 'variability="tunable"', "<Real/>"),
        [("alias-constant", "limit, other", "value reference 4 for a constant and another")],
    ),
    "two units": (more("other", 3, "", '<Real unit="mm"/>'), [("alias-unit", "x, other", "'m' and 'mm'")]),
    "a unit and none": (more("other", 3, "", "<Real/>"), [("alias-unit", "x, other", "none and 'm'")]),
    "one unit": (more("other", 3, "", '<Real unit="m"/>'), []),
}

TIME = 'causality="independent" variability="continuous"'
OTHERS = {
    "one independent variable": (more("time", 40, TIME, "<Real/>"), []),
    "an independent one that is no Real": (
        more("time", 40, 'causality="independent"', "<Integer/>"),
        [("independent", "time", "Integer")],
    ),
    "two": (
        {END: more("time", 40, TIME, "<Real/>")[END].removesuffix(END) + more("clock", 41, TIME, "<Real/>")[END]},
        [("independent", "clock", "another")],
    ),
    "a unit twice": ({'<Unit name="mm">': '<Unit name="m"/><Unit name="mm">'}, [("unit-name", "m", "several")]),
    "a type twice": (
        {TYPES: f'<SimpleType name="Length"><Real unit="m"/></SimpleType>{TYPES}'},
        [("type-name", "Length", "several")],
    ),
    "a type of a variable's name": (
        {TYPES: f'<SimpleType name="gain"><Real/></SimpleType>{TYPES}'},
        [("type-name", "gain", "a type and a variable")],
    ),
    "a declared type of another kind": (
        {'declaredType="Length"': 'declaredType="Mode"'},
        [("declared-type", "u", "one of Enumeration")],
    ),
    "a value of two items": (
        {'name="Slow" value="2"': 'name="Slow" value="1"'},
        [("enumeration-items", "Mode", "1 more than once")],
    ),
    "a name of two items": ({'name="Slow"': 'name="Fast"'}, [("enumeration-items", "Mode", "'Fast' more than once")]),
    "a start value of no item": (
        {'declaredType="Mode" start="1"': 'declaredType="Mode" start="3"'},
        [("enumeration-start", "mode", "3")],
    ),
    "no start value": ({'declaredType="Mode" start="1"': 'declaredType="Mode"'}, []),
}


@pytest.mark.parametrize("case", [*RANGES, *ALIASES, *OTHERS])
def test_a_rule_finds_what_breaks_it_and_nothing_beside_it(case: str) -> None:
    edits, expected = (RANGES | ALIASES | OTHERS)[case]
    root = edited("modelDescription.xml", edits)
    assert told(check_variables(root, read(root))) == expected


def test_a_finding_says_what_would_be_right() -> None:
    root = edited("modelDescription.xml", {'declaredType="Mode" start="1"': 'declaredType="Mode" start="3"'})
    (found,) = check_variables(root, read(root))
    assert str(found) == "enumeration-start [2.2.7] mode: expected a start value of 1, 2; found 3"
    root = edited("modelDescription.xml", {'min="-10" max="10"': 'max="0.25"'})
    (found,) = check_variables(root, read(root))
    assert found.expected == "a start value in [-inf, 0.25]"
