"""One finding for each rule and cause."""

from __future__ import annotations

from fmu_src.compliance.finding import LONGEST, by_cause, one_line
from fmu_src.compliance.rules import finding


def test_findings_that_differ_in_names_and_numbers_only_are_one() -> None:
    findings = [finding("start-value", f"k{i}", f"{i}.5 as start value", f"{-i}e-3") for i in range(915)]
    findings.insert(3, finding("start-value", "n", "3 as start value", "a crash"))
    first, other = by_cause(findings)
    assert len(first.subjects) == 915 and other.subjects == ("n",)
    assert str(first) == "start-value [2.2.7] k0, k1, k2 and 912 more: expected 0.5 as start value; found 0e-3"


def test_another_status_is_another_cause() -> None:
    found = [finding("call-order", f"fmi2F{i}", "fmi2Error", ("fmi2OK", "fmi2Fatal")[i % 2]) for i in range(6)]
    assert [len(group.subjects) for group in by_cause(found)] == [3, 3]


def test_what_an_fmu_brings_stays_on_its_line() -> None:
    assert one_line("a\nb\x1b[2J\u202ec") == "a\\nb\\x1b[2J\\u202ec"
    assert len(one_line("x" * 10**6)) == LONGEST + len(" ...")
