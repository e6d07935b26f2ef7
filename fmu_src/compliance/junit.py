"""The reports as JUnit XML, which CI servers show: a suite for each FMU, a test case for each rule."""

from __future__ import annotations

from pathlib import Path

from junitparser import Failure, JUnitXml, TestCase, TestSuite

from fmu_src.compliance.finding import Report
from fmu_src.compliance.rules import RULES


def write_junit(reports: list[Report], path: Path) -> None:
    """Write the reports to `path`.

    Raises:
        OSError: it cannot be written.
    """
    document = JUnitXml("FMI 2.0 compliance")
    for report in reports:
        suite = TestSuite(report.fmu.name)
        for rule in report.checked:
            case = TestCase(f"{rule} [{RULES[rule].section}]: {RULES[rule].demand}", classname=report.fmu.stem)
            found = [str(finding) for finding in report.findings if finding.rule == rule]
            if found:
                case.result = [Failure(text, type_=rule) for text in found]
            suite.add_testcase(case)
        for number, note in enumerate(report.notes, start=1):
            suite.add_property(f"note {number}", note)
        document.add_testsuite(suite)
    document.write(str(path), pretty=True)
