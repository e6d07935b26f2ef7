"""Each call that the state machine forbids in a state, let pass by an FMU of its own: only the probe of that call finds it."""

from __future__ import annotations

import pytest

from broken_fmus import Make
from fmu_src.compliance.check import check
from fmu_src.compliance.library import lifecycle

# FMI 2.0.4, section 4.2.4: what a co-simulation slave must refuse, by state.
TABLE = {
    "instantiated": ("I", ["ExitInitializationMode", "EnterInitializationMode", "DoStep", "Terminate"]),
    "set up": ("U", ["ExitInitializationMode", "DoStep", "Terminate"]),
    "in initialization mode": ("M", ["SetupExperiment", "EnterInitializationMode", "DoStep", "Terminate"]),
    "initialized": ("S", ["SetupExperiment", "EnterInitializationMode", "ExitInitializationMode"]),
    "terminated": (
        "T",
        ["SetupExperiment", "EnterInitializationMode", "ExitInitializationMode", "DoStep", "Terminate"],
    ),
}
PAIRS = [(state, f"fmi2{name}") for state, (_, names) in TABLE.items() for name in names]


def test_what_is_probed_is_the_standards_table() -> None:
    assert {state: list(names) for state, names in lifecycle.FORBIDDEN.items()} == {
        state: [f"fmi2{name}" for name in names] for state, (_, names) in TABLE.items()
    }


@pytest.mark.parametrize(("state", "function"), PAIRS, ids=[f"{f} in {s}" for s, f in PAIRS])
def test_a_forbidden_call_that_passes_is_found_where_it_passes(make: Make, state: str, function: str) -> None:
    (found,) = check(make(defect=f"{function} in {TABLE[state][0]}")).findings
    assert str(found).endswith(f"{function} when {state}: expected fmi2Error; found fmi2OK")
