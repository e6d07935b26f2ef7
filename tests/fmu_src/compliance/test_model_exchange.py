"""FMUs of model exchange are driven too: their states, derivatives and events."""

from __future__ import annotations

from pathlib import Path

import pytest

from broken_fmus import BINARY, BROKEN, EXCHANGE, Make, compiled, found
from fmu_src.compliance.check import check
from fmu_src.compliance.files.binaries import functions
from fmu_src.compliance.rules import RULES


def test_a_sound_fmu_of_model_exchange_is_driven_without_a_finding(make_exchange: Make) -> None:
    report = check(make_exchange())
    assert report.findings == [] and report.notes == []
    assert set(report.checked) > EXCHANGE | {"state-serialize", "directional-derivative", "two-instances", "reset"}
    of_cosimulation = {"input-derivatives", "output-derivatives", "step-size", "communication-point", "stop-time"}
    assert not of_cosimulation & set(report.checked) and set(report.checked) < set(RULES)


DEFECTS_OF_MODEL_EXCHANGE = {rule: rule for rule in sorted(EXCHANGE)} | {
    "continuous-states-nominal": "continuous-states",
    "directional-derivative": "directional-derivative",
    "call-order": "call-order",
}


@pytest.mark.parametrize("defect", DEFECTS_OF_MODEL_EXCHANGE)
def test_a_defect_of_model_exchange_is_found_by_its_rule_alone(make_exchange: Make, defect: str) -> None:
    assert found(make_exchange(defect=defect)) == {DEFECTS_OF_MODEL_EXCHANGE[defect]}


def test_without_known_states_it_is_not_driven(make_exchange: Make) -> None:
    report = check(make_exchange(edits={'<Derivatives><Unknown index="3"': '<Derivatives><Unknown index="33"'}))
    assert {finding.rule for finding in report.findings} == {"structure-index"}
    assert report.notes == ["ModelStructure does not say what the states are: model exchange was not driven"]


def test_of_two_interfaces_a_finding_and_a_note_say_which(make_exchange: Make, tmp_path: Path) -> None:
    source = (BROKEN / "exchange.c").read_text()
    missing = sorted(functions("CoSimulation") - functions("ModelExchange"))
    assert len(missing) == 9
    stubs = "".join(f'__attribute__((visibility("default"))) int {name}(void);\n' for name in missing)
    stubs += "".join(f"int {name}(void) {{ return 3; }}\n" for name in missing)
    # The header declares them otherwise; what is never called may be a stub.
    (tmp_path / "code").mkdir()
    (tmp_path / "code" / "stubs.c").write_text(stubs)
    library = compiled(tmp_path / "code", source=source)
    both = {"<LogCategories>": '<CoSimulation modelIdentifier="broken"/><LogCategories>'}
    report = check(make_exchange({BINARY: library}, both))
    assert [str(finding) for finding in report.findings] == [
        "instantiate [2.1.5] fmi2Instantiate in co-simulation: expected an instance; found a null pointer"
    ]
    assert report.notes == ["in co-simulation: the FMU cannot be run, so no further rule was applied"]
    assert "event-mode" in report.checked


def test_the_ball_bounces_where_its_indicator_changes_sign(make_exchange: Make) -> None:
    # Derivatives become NaN at the first bounce: they are found only if event mode was entered there.
    (finding,) = check(make_exchange(defect="state-derivatives")).findings
    assert (finding.subject, finding.found) == ("der(v)", "nan")
