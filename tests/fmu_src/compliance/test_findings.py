"""One finding for each rule and cause."""

from __future__ import annotations

from pathlib import Path

from junitparser import JUnitXml

from fmu_src.compliance.finding import LONGEST, Report, by_cause, one_line
from fmu_src.compliance.junit import write_junit
from fmu_src.compliance.rules import RULES, finding


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
    assert one_line("x" * 10**6) == "x" * 300 + " ..." and LONGEST == 300
    assert one_line(" " + "x" * 300 + "\n") == "x" * 300


def test_three_subjects_are_named_and_of_more_the_number() -> None:
    for count, words in ((1, "k0"), (3, "k0, k1, k2"), (4, "k0, k1, k2 and 1 more")):
        (one,) = by_cause(finding("guid", f"k{i}", "a", "b") for i in range(count))
        assert str(one) == f"guid [2.2.1] {words}: expected a; found b"


def test_a_subject_that_comes_twice_is_named_once_and_rules_stay_apart() -> None:
    found = [finding(rule, subject, "a", "b") for rule, subject in (("guid", "k"), ("load", "k"), ("guid", "n"))]
    first, second = by_cause([*found, found[0], found[2]])
    assert first.subjects == ("k", "n") and second.subjects == ("k",)
    assert [one.rule for one in by_cause([*by_cause(found), finding("guid", "m", "a", "b")])] == ["guid", "load"]


def test_a_quoted_name_or_the_subject_itself_makes_no_cause_and_a_word_does() -> None:
    named = [finding("type-name", name, f"'{name}' once", f"{name}, {name}") for name in ("a", "bc")]
    assert len(by_cause(named)) == 1
    assert len(by_cause([*named, finding("type-name", "d", "'d' once", "never")])) == 2


def test_junit_has_a_case_for_each_rule_with_its_finding_and_says_why_others_were_not_applied(tmp_path: Path) -> None:
    found = by_cause([finding("guid", "guid", "one", "none"), *(finding("min-max", n, "less", "more") for n in "abcd")])
    old = Report(Path("old.fmu"), "2.0", ["guid", "min-max", "load"], found, ["not driven", "not even loaded"])
    new = Report(Path("new.fmu"), "3.0", ["guid"])
    write_junit([old, new], {Path("none.fmu"): "there is no such file"}, tmp_path / "out.xml")
    first, second, third = JUnitXml.fromfile(str(tmp_path / "out.xml"))
    assert [(s.name, s.tests, s.failures, s.errors) for s in (first, second, third)] == [
        ("old.fmu", 3, 2, 0),
        ("new.fmu", 1, 0, 0),
        ("none.fmu", 1, 0, 1),
    ]
    cases = list(first)
    assert [case.name for case in cases] == [f"{r} [{RULES[r].section}]: {RULES[r].demand}" for r in old.checked]
    assert {case.classname for case in cases} == {"old"}
    ((failure,), (several,), nothing) = (case.result for case in cases)
    assert (failure.type, failure.message, failure.text) == ("guid", str(found[0]), None)
    assert (several.type, several.message, several.text) == ("min-max", str(found[1]), "a\nb\nc\nd") and not nothing
    assert [(p.name, p.value) for p in first.properties()] == [("note 1", "not driven"), ("note 2", "not even loaded")]
    assert next(iter(second)).name.startswith("guid [2.4]")
    (error,) = next(iter(third)).result
    assert error.message == "there is no such file"
