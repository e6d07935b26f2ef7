"""The reports as JUnit XML, which CI servers show: a suite for each FMU, a test case for each rule."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from junitparser import Error, Failure, JUnitXml, TestCase, TestSuite

from fmu_src.compliance.finding import Finding, Report, escaped
from fmu_src.compliance.rules import RULES


def _failure(finding: Finding) -> Failure:
    """All subjects of the cause are in its text; the message names the first ones."""
    failure = Failure(str(finding), type_=finding.rule)
    if finding.more:
        failure.text = "\n".join(finding.subjects)
    return failure


def write_junit(reports: list[Report], refused: Mapping[Path, str], path: Path) -> None:
    """Write the reports to `path`, and why the files in `refused` could not be checked, each as an error.

    Raises:
        OSError: it cannot be written.
    """
    document = JUnitXml("FMI compliance")
    for report in reports:
        suite = TestSuite(escaped(report.fmu.name))
        for rule in report.checked:
            section = RULES[rule].section if report.version == "2.0" else RULES[rule].section3
            case = TestCase(f"{rule} [{section}]: {RULES[rule].demand}", classname=escaped(report.fmu.stem))
            found = [finding for finding in report.findings if finding.rule == rule]
            if found:
                case.result = [_failure(finding) for finding in found]
            suite.add_testcase(case)
        for number, note in enumerate(report.notes, start=1):
            suite.add_property(f"note {number}", note)
        document.add_testsuite(suite)
    for file, reason in refused.items():
        case = TestCase("is an FMU that can be checked", classname=escaped(file.stem))
        case.result = [Error(reason)]
        suite = TestSuite(escaped(file.name))
        suite.add_testcase(case)
        document.add_testsuite(suite)
    document.write(str(path), pretty=True)
