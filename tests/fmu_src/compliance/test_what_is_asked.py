"""Which probes an FMU is given: those of the standard's table, and of its capabilities only those that it claims."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

import pytest

from broken_fmus import edited
from fmu_src.compliance.files.description import read
from fmu_src.compliance.library.calls import Subject
from fmu_src.compliance.library.dynamic import _cases, _comparisons
from fmu_src.compliance.library.process import Case

FRESH = Path("fresh")


def asked(name: str, edits: dict[str, str] | None = None) -> list[Case]:
    """What the FMU that this document describes is asked, between its first life and the serialisation of its state."""
    description = read(edited(name, edits or {}))
    (interface,) = description.interfaces
    subject = Subject(description, interface, "", "", 0.0, 1.0, 0.1, (), Path())
    return [*_cases(subject, []), *_comparisons(subject, FRESH)]


def arguments(cases: list[Case], rule: str) -> list[tuple[object, ...]]:
    return [case.arguments for case in cases if case.rule == rule]


STATES = [("instantiated",), ("set up",), ("in initialization mode",), ("initialized",), ("terminated",)]


def test_a_co_simulation_fmu_is_asked_all_that_it_claims() -> None:
    cases = asked("modelDescription.xml")
    assert Counter(case.rule for case in cases) == {
        "guid-mismatch": 1,
        "call-order": 19,
        "unknown-reference": 8,
        "set-constant": 2,  # one, in two states
        "set-fixed": 2,  # two
        "set-calculated": 6,  # three, in two states
        "start-value": 1,
        "set-get": 1,
        "nan-input": 2,
        "directional-derivative": 1,
        "input-derivatives": 1,
        "output-derivatives": 1,
        "step-size": 3,
        "communication-point": 2,
        "stop-time": 1,
        "step-variation": 1,
        "free": 6,
        "silent": 1,
        "prints": 1,
        "log-messages": 1,
        "debug-logging": 1,
        "state-free": 1,
        "reset": 5,
        "two-instances": 1,
        "state-restore": 1,
    }
    assert arguments(cases, "step-size")[:2] == [(0.0,), (-1.0,)] and math.isnan(arguments(cases, "step-size")[2][0])  # type: ignore[arg-type]
    assert arguments(cases, "communication-point") == [(-2,), (10,)]
    (first,), (second,) = arguments(cases, "nan-input")
    assert math.isnan(first) and second == math.inf  # type: ignore[arg-type]
    assert arguments(cases, "free") == [*STATES, ()]
    assert arguments(cases, "reset") == [(*state, FRESH) for state in STATES]
    assert [case.rule for case in cases if case.captures] == ["prints"] and all(case.drives for case in cases)


def test_what_must_not_be_set_is_tried_before_and_after_where_it_must_not() -> None:
    cases = [case for case in asked("modelDescription.xml") if case.rule.startswith("set-") and case.rule != "set-get"]
    both = ("instantiated", "initialized")
    assert [(case.rule, case.subject, case.arguments[2]) for case in cases] == [
        *(("set-constant", "limit", state) for state in both),
        *(("set-fixed", name, "initialized") for name in ("start", "label")),
        *(("set-calculated", name, state) for name in ("x", "count", "y") for state in both),
    ]


REFUSED = {
    "call-order",
    "unknown-reference",
    "set-constant",
    "set-fixed",
    "set-calculated",
    "step-size",
    "stop-time",
    "communication-point",
}


def test_of_a_call_that_must_be_refused_an_error_is_expected() -> None:
    cases = asked("modelDescription.xml")
    assert {case.rule for case in cases if case.expected == "fmi2Error"} == REFUSED
    assert {case.rule for case in cases if case.expected == "an answer"} == {case.rule for case in cases} - REFUSED - {
        "guid-mismatch",
        "free",
    }


@pytest.mark.parametrize(
    ("edits", "left_out"),
    [
        ({'canInterpolateInputs="true"': 'canInterpolateInputs="false"'}, {"input-derivatives"}),
        ({'maxOutputDerivativeOrder="1"': 'maxOutputDerivativeOrder="0"'}, {"output-derivatives"}),
        ({'maxOutputDerivativeOrder="1"': ""}, {"output-derivatives"}),
        ({'maxOutputDerivativeOrder="1"': 'maxOutputDerivativeOrder="2"'}, set()),
        ({'providesDirectionalDerivative="true"': ""}, {"directional-derivative"}),
        ({'canHandleVariableCommunicationStepSize="true"': ""}, {"step-variation"}),
        ({'canGetAndSetFMUstate="true"': ""}, {"state-free", "state-restore"}),
        ({"<CoSimulation ": '<CoSimulation canBeInstantiatedOnlyOncePerProcess="true" '}, {"two-instances"}),
        (
            {'<LogCategories><Category name="logStatusError"/><Category name="logEvents"/></LogCategories>': ""},
            {"debug-logging"},
        ),
        ({'variability="constant"': 'causality="parameter" variability="tunable"'}, {"set-constant"}),
    ],
)
def test_what_an_fmu_does_not_claim_is_not_asked_of_it(edits: dict[str, str], left_out: set[str]) -> None:
    everything = {case.rule for case in asked("modelDescription.xml")}
    assert everything - {case.rule for case in asked("modelDescription.xml", edits)} == left_out


def test_model_exchange_is_asked_what_belongs_to_it() -> None:
    cases = asked("exchange.xml")
    rules = Counter(case.rule for case in cases)
    assert rules["call-order"] == 7 + 6 + 7 + 5 + 5 + 8
    assert {"continuous-states", "state-derivatives", "event-mode", "directional-derivative", "state-restore"} <= set(
        rules
    )
    assert not {"input-derivatives", "output-derivatives", "step-size", "communication-point", "stop-time"} & set(rules)
    assert arguments(cases, "free") == [*STATES, ("in event mode",), ()] and rules["reset"] == 6
