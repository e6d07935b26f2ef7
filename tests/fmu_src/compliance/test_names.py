"""Names of variables: the verdicts on structured names are those of fmpy's grammar."""

from __future__ import annotations

from functools import cache

import pytest
from fmpy.model_description import ModelDescription, ScalarVariable
from fmpy.validation import _validate_variable_names
from hypothesis import given, settings
from hypothesis import strategies as st

from fmu_src.compliance.files.names import check_names, is_structured
from tools import examples

PIECES = [
    "a",
    "b1",
    "_",
    "'",
    "\\'",
    "\\",
    "[",
    "]",
    "[1,2]",
    "2",
    ",",
    ".",
    "der(",
    ")",
    " ",
    '"',
    "\n",
    "\v",
    "x y",
    "'q.r'",
    "é",
]


@cache
def is_structured_by_fmpy(name: str) -> bool:
    description = ModelDescription()
    description.variableNamingConvention = "structured"
    variable = ScalarVariable(name, 0)
    description.modelVariables = [variable]
    return not _validate_variable_names(description)


@given(st.lists(st.sampled_from(PIECES), max_size=7).map("".join))
@settings(deadline=None, derandomize=True, max_examples=examples(60, 300))
def test_the_verdict_on_a_name_is_that_of_fmpy(name: str) -> None:
    assert is_structured(name) == is_structured_by_fmpy(name)


@pytest.mark.parametrize(
    ("name", "verdict"),
    [
        ("body.flange[1,2].phi", True),
        ("der(body.'angular velocity'.x,2)", True),
        ("'a\\'b'", True),
        ("a..b", False),
        ("a[1][2]", False),
        ("der(der(x))", False),
        ("2a", False),
        ("", False),
    ],
)
def test_names_of_the_standard(name: str, verdict: bool) -> None:
    assert is_structured(name) == is_structured_by_fmpy(name) == verdict


def test_a_variable_that_is_a_branch_too_is_found_in_structured_names_only() -> None:
    names = ["x", "x.pos", "'a.b'", "'a.b'.c", "der(x.pos)", "xy.z"]
    assert [finding.subject for finding in check_names("structured", names)] == ["x", "'a.b'"]
    assert list(check_names("flat", names)) == []


def test_control_characters_are_found_in_any_convention() -> None:
    for convention in ("flat", "structured"):
        (finding,) = check_names(convention, ["'a\nb'"])
        assert (finding.rule, finding.found) == ("variable-name", "U+000A")
