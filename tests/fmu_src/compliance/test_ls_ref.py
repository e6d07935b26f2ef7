"""Reference results in an FMU are replayed by a legal sequence of calls, and its manifest is checked."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import pytest

from broken_fmus import EXCHANGE, Make, found
from fmu_src.compliance.check import check
from fmu_src.compliance.library.ls_ref import FOLDER, MANIFEST
from fmu_src.compliance.rules import RULES


def ls_ref(reference: str, changes: Mapping[str, str] | None = None, step: str = "0.1") -> dict[str, bytes | None]:
    """Files of the layered standard: one experiment, whose reference results are the rows of `reference`."""
    experiment = (
        '<Experiments name="smoke"><Experiment name="ramp" tolerance="1e-6"><TransientSimulation startTime="0" stopTime="0.2" '
        f'stepSize="{step}"/><Stimuli source="in.csv"/><References source="out.csv"/></Experiment></Experiments>'
    )
    files = {"smoke.exp": experiment, "in.csv": "time,u\n0,0\n0.2,1\n", "out.csv": reference}
    roles = {"smoke.exp": "experiment/smoke-test", "in.csv": "other", "out.csv": "result"}
    types = {"smoke.exp": "application/x-ma-hs-experiments", "in.csv": "text/csv", "out.csv": "text/csv"}
    related = "".join(
        f'<Related source="{name}" role="{roles[name]}" type="{types[name]}" '
        f'checksum="{hashlib.sha3_256(text.encode()).hexdigest()}"/>'
        for name, text in files.items()
    )
    manifest = (
        '<fmiReferences xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest" fmi-ls:fmi-ls-name='
        f'"org.fmi-standard.fmi-ls-ref" fmi-ls:fmi-ls-version="1.0.0-alpha.1" fmi-ls:fmi-ls-description="">{related}'
        "</fmiReferences>"
    )
    for old, new in (changes or {}).items():
        assert old in manifest
        manifest = manifest.replace(old, new)
    return {MANIFEST: manifest.encode()} | {f"{FOLDER}/{name}": text.encode() for name, text in files.items()}


# By hand: x(0) = 1, x(0.1) = 1 + 0.1 (3 * 0 - 1), x(0.2) = 0.9 + 0.1 (3 * 0.5 - 0.9).
RIGHT = "time,x\n0,1\n0.1,0.9\n0.2,0.96\n"


def test_reference_results_are_replayed(make: Make) -> None:
    report = check(make(ls_ref(RIGHT)))
    assert report.findings == []
    assert set(report.checked) == set(RULES) - EXCHANGE


DEFECTS_OF_THE_REFERENCES: dict[str, tuple[str, dict[str, str]]] = {
    "ls-ref-replay": (RIGHT.replace("0.96", "0.97"), {}),
    "ls-ref-checksum": (RIGHT, {hashlib.sha3_256(RIGHT.encode()).hexdigest(): "00"}),
    "ls-ref-manifest": (RIGHT, {'role="other"': 'role="stimulus"'}),
}


@pytest.mark.parametrize("rule", DEFECTS_OF_THE_REFERENCES)
def test_a_defect_of_the_references_is_found_by_its_rule_alone(make: Make, rule: str) -> None:
    assert found(make(ls_ref(*DEFECTS_OF_THE_REFERENCES[rule]))) == {rule}


def test_files_that_are_not_there_and_experiments_that_cannot_be_run_are_found(make: Make) -> None:
    assert found(make({**ls_ref(RIGHT), f"{FOLDER}/in.csv": None})) == {"ls-ref-manifest"}
    assert found(make(ls_ref("time,x\n0,one\n"))) == {"ls-ref-manifest"}
    assert found(make(ls_ref(RIGHT, step="0"))) == {"ls-ref-manifest"}


def test_a_table_outside_of_the_fmu_is_not_read(make: Make, tmp_path: Path) -> None:
    (tmp_path / "out.csv").write_text(RIGHT)
    files = ls_ref(RIGHT)
    experiment = files[f"{FOLDER}/smoke.exp"].replace(b'"out.csv"', f'"{tmp_path}/out.csv"'.encode())
    report = check(make({**ls_ref(RIGHT), f"{FOLDER}/smoke.exp": experiment}))
    assert any(f"{tmp_path}/out.csv is not in the FMU" in finding.found for finding in report.findings)


def test_an_output_that_follows_an_input_without_a_step_is_compared_where_the_order_of_calls_does_not_matter(
    make: Make,
) -> None:
    # y = 3 u: the table holds it for the inputs of t_k, a legal sequence reads that of t_{k-1}; but the first is to be read.
    assert found(make(ls_ref("time,y\n0,0\n0.1,1.5\n0.2,3\n"))) == set()
    assert found(make(ls_ref("time,y\n0,0.3\n0.1,1.5\n0.2,3\n"))) == {"ls-ref-replay"}
