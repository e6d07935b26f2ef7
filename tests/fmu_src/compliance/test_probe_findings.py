"""A finding of a probe names the thing, says what was expected and what came; of a sound FMU the probe has none."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from fmu_src.compliance.library import lifecycle, messages, states, steps, values
from fmu_src.compliance.library.fmu import Fmu

Load = Callable[..., Fmu]

LINES = {
    "step-size": (
        lambda f: steps.step_size(f, 0.0),
        "step-size [4.2.2] fmi2DoStep with h = 0: expected fmi2Error; found fmi2OK",
    ),
    "communication-point": (
        lambda f: steps.communication_point(f, -2),
        "communication-point [4.2.2] fmi2DoStep from t = 0.1 at t = 0.3: expected fmi2Error; found fmi2OK",
    ),
    "stop-time": (steps.stop_time, "stop-time [2.1.6] fmi2DoStep beyond 0.2: expected fmi2Error; found fmi2OK"),
    "step-variation": (
        steps.variation,
        "step-variation [4.3.1] fmi2DoStep from t = 0.1 with h = 0.05: expected fmi2OK; found fmi2Error",
    ),
    "types-platform": (
        lifecycle.load,
        "types-platform [2.1.4] fmi2GetTypesPlatform: expected 'default'; found 'special'",
    ),
    "version": (lifecycle.load, "version [2.1.4] fmi2GetVersion: expected '2.0'; found '2.1'"),
    "guid-mismatch": (
        lifecycle.guid_mismatch,
        "guid-mismatch [2.1.5] fmi2Instantiate: expected a null pointer for the GUID {00000000-0000-0000-0000-000000000000}; "
        "found an instance",
    ),
    "call-order": (
        lambda f: lifecycle.forbidden_call(f, "set up", "fmi2Terminate"),
        "call-order [4.2.4] fmi2Terminate when set up: expected fmi2Error; found fmi2OK",
    ),
    "memory": (
        lambda f: lifecycle.free(f, "set up"),
        "memory [2.1.5] fmi2FreeInstance when set up: expected all memory given back; found 1 blocks kept",
    ),
    "unknown-reference": (
        lambda f: values.unknown_reference(f, "fmi2GetReal"),
        "unknown-reference [2.1.7] fmi2GetReal of 4294967294: expected fmi2Error; found fmi2OK",
    ),
    "set-constant": (
        lambda f: values.refused_set(f, "set-constant", f.subject.variables[4], "instantiated"),
        "set-constant [2.2.7] limit: expected fmi2Error when it is set to 100.0 while instantiated; found fmi2OK",
    ),
    "set-get": (values.set_get, "set-get [2.1.7] gain: expected 3.375 after it was set; found 3.0"),
    "input-derivatives": (
        values.input_derivatives,
        "input-derivatives [4.2.1] u: expected fmi2OK for its first derivative; found fmi2Error",
    ),
    "output-derivatives": (
        values.output_derivatives,
        "output-derivatives [4.2.1] x: expected fmi2OK for its first derivative; found fmi2Error",
    ),
    "silent": (
        messages.silent,
        "silent [2.1.5] logger: expected no message while logging is off; found fmi2OK, category 'logEvents': initialized after 0 steps",
    ),
    "log-messages": (
        messages.logged,
        "log-messages [2.1.5] initialized after 0 steps: expected a category of logStatusError, logEvents; found 'undeclared'",
    ),
    "log-messages-name": (
        messages.logged,
        "log-messages [2.1.5] initialized after 0 steps: expected the instance name 'speaker'; found 'someone'",
    ),
    "debug-logging": (
        messages.debug_logging,
        "debug-logging [2.1.5] category logStatusError: expected fmi2OK; found fmi2Error",
    ),
    "state-free": (
        states.free_state,
        "state-free [2.1.8] fmi2FreeFMUstate: expected a null pointer afterwards; found another",
    ),
}


@pytest.mark.parametrize("defect", LINES)
def test_a_finding_names_the_thing_what_was_expected_and_what_came(load: Load, defect: str) -> None:
    probe, line = LINES[defect]
    assert [str(found) for found in probe(load(defect))] == [line]
    assert list(probe(load())) == []


def test_a_state_that_is_not_restored_is_told_with_both_values(load: Load) -> None:
    (found,) = states.restore(load("state-restore"))
    expected, end = 1.5 - 0.5 * 0.9**4, 1.5 - 0.5 * 0.9**8
    assert (found.rule, found.subject) == ("state-restore", "x")
    value, _, rest = found.expected.partition(" ")
    assert rest == "after 0 steps, as before the state was restored"
    assert float(value) == pytest.approx(expected, rel=0, abs=1e-14)
    assert float(found.found) == pytest.approx(end, rel=0, abs=1e-14)
    assert list(states.restore(load())) == []
