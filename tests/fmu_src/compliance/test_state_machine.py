"""Each call that the state machine forbids in a state, let pass by an FMU of its own: only the probe of that call finds it."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

from fmu_src.compliance.check import _subject
from fmu_src.compliance.files.binaries import host_library
from fmu_src.compliance.files.description import read
from fmu_src.compliance.files.package import open_package
from fmu_src.compliance.library import lifecycle
from fmu_src.compliance.library.process import Case, run
from test_compliance import Make, make, sound  # noqa: F401  fixtures

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
def test_a_forbidden_call_that_passes_is_found_where_it_passes(
    request: pytest.FixtureRequest, tmp_path: Path, state: str, function: str
) -> None:
    write: Make = request.getfixturevalue("make")
    path = write(defect=f"{function} in {TABLE[state][0]}")
    package = open_package(path)
    description = read(package.root)
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path / "unpacked")
    library = host_library(description)
    assert library is not None
    subject = _subject(tmp_path / "unpacked", description, library)

    def findings(where: str, which: str) -> list[str]:
        case = Case("call-order", f"{which} when {where}", lifecycle.forbidden_call, (where, which), "fmi2Error")
        return [str(finding) for finding in run(case, subject).findings]

    (found,) = findings(state, function)
    assert found.endswith(f"{function} when {state}: expected fmi2Error; found fmi2OK")
    others = [(s, f) for s, f in PAIRS if (s == state) != (f == function)]
    assert [pair for pair in others if findings(*pair)] == []
