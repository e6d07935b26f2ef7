"""observer-fmus check: FMUs against the FMI 2.0 standard."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from commands.console import err, fail, say
from cosim.whole import whole
from fmu_src.compliance.check import check as check_fmu
from fmu_src.compliance.finding import CannotCheck, Report, escaped, one_line
from fmu_src.compliance.junit import write_junit

_OUTPUT = Console(soft_wrap=True, highlight=False)


def check(
    fmus: Annotated[
        list[Path],
        typer.Argument(
            help="FMUs of FMI 2.0; of 3.0 the file alone is checked.", metavar="FILE.fmu ...", show_default=False
        ),
    ],
    junit: Annotated[Path | None, typer.Option(help="Also write the result to this file, as JUnit XML.")] = None,
) -> None:
    """Check FMUs against the FMI 2.0 standard: the file, and what its library does when it is driven.

    One line for each rule and cause. Exit code 0: no finding; 1: some; 2: a file could not be checked.

    \b
    Example:
      observer-fmus check fmus/*.fmu --junit compliance.xml
    """
    reports: list[Report] = []
    refused: dict[Path, str] = {}
    for path in fmus:
        try:
            with err.status(escape(str(path))) as status:
                report = check_fmu(path, lambda rule: status.update(escape(f"{path}: {rule}")))  # noqa: B023  # called here only
        except CannotCheck as error:
            reason = escaped(str(error))
            say(reason)
            refused[path] = reason
            continue
        except Exception as error:  # a fault of the check itself: the other FMUs are checked all the same
            reason = escaped(f"{path}: the check failed: {type(error).__name__}: {one_line(str(error))}")
            say(reason)
            refused[path] = reason
            continue
        reports.append(report)
        _show(report)
    if junit is not None:
        try:
            with whole(junit) as unfinished:
                write_junit(reports, refused, unfinished)
        except OSError as error:
            fail(f"{junit}: cannot be written: {error.strerror or error}", 2)
    if refused:
        raise typer.Exit(2)
    raise typer.Exit(1 if any(report.findings for report in reports) else 0)


def _show(report: Report) -> None:
    fmu = escaped(str(report.fmu))
    for found in report.findings:
        _OUTPUT.print(f"{fmu}: {found}", style="red", markup=False)
    for note in report.notes:
        _OUTPUT.print(f"{fmu}: note: {note}", style="yellow", markup=False)
    count = len(report.findings)
    verdict = "no finding" if count == 0 else "1 finding" if count == 1 else f"{count} findings"
    _OUTPUT.print(f"{fmu}: {len(report.checked)} rules, {verdict}", style="bold", markup=False)
