"""FMUs of model exchange are driven too: their states, derivatives and events."""

from __future__ import annotations

import pytest

from broken_fmus import EXCHANGE, Make, found
from fmu_src.compliance.check import check
from fmu_src.compliance.rules import RULES


def test_a_sound_fmu_of_model_exchange_is_driven_without_a_finding(make_exchange: Make) -> None:
    report = check(make_exchange())
    assert report.findings == [] and report.notes == []
    assert set(report.checked) > EXCHANGE | {"state-serialize", "directional-derivative", "two-instances", "reset"}
    of_cosimulation = {"input-derivatives", "output-derivatives", "step-size", "communication-point", "stop-time"}
    assert not of_cosimulation & set(report.checked) and set(report.checked) < set(RULES)


DEFECTS_OF_MODEL_EXCHANGE = {rule: rule for rule in EXCHANGE} | {
    "continuous-states-nominal": "continuous-states",
    "directional-derivative": "directional-derivative",
    "call-order": "call-order",
}


@pytest.mark.parametrize("defect", DEFECTS_OF_MODEL_EXCHANGE)
def test_a_defect_of_model_exchange_is_found_by_its_rule_alone(make_exchange: Make, defect: str) -> None:
    assert found(make_exchange(defect=defect)) == {DEFECTS_OF_MODEL_EXCHANGE[defect]}


def test_the_ball_bounces_where_its_indicator_changes_sign(make_exchange: Make) -> None:
    # Derivatives become NaN at the first bounce: they are found only if event mode was entered there.
    (finding,) = check(make_exchange(defect="state-derivatives")).findings
    assert (finding.subject, finding.found) == ("der(v)", "nan")
